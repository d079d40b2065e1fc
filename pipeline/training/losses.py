"""Losses of networks that answer impulse images: on grids, at contacts, by energy, and after sweeps of the solver.

A loss returns ``(total, weight)``, and its value is total / weight: where several processes share a batch, each with
other contacts, totals and weights are averaged before they are divided. Errors are measured in units of a scale for
each channel, which makes them relative where it is that of the labels.

- ``grid_mse``, ``grid_mae``: squared error and magnitude, mean over nodes and channels, as in the theses.
- ``contact_mse``: mean over the contacts of the answer, gathered where they lie.
- ``energy``: kinetic energy of the velocities that the error makes, e^T J M^-1 J^T e, over that of the labels: an
  error that moves no body costs nothing, as the impulses of a pile are not unique.
- ``sweeps``: squared error that k sweeps of the solver leave of the gathered answer, over the square of the labels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.stencil import BILINEAR
from dc_kernels.learn.differentiable import ContactProblem, sweeps_torch
from dc_kernels.runtime.imports import require
from dc_kernels.solve.rows import COLORS
from dc_kernels.torch_ops.transfer import gather_torch
from pipeline.training.options import LossName

torch = require("torch", "pipeline")


@dataclass(frozen=True, kw_only=True)
class Decoder:
    """Reads an impulse image at the contacts."""

    images: ImageSpec
    """What the images that the network answers show."""
    reverse: bool = True
    """Reverse SPH (Engedal): what a node holds is shared among the contacts that reach it; False: bilinear (Wu)."""
    threads: int = 1
    """Number of threads that share the worlds [1]."""

    def __call__(self, image: Any, batch: Any) -> Any:
        """Read the impulse of each contact, (M, 2) [N s], from an image (B, 2 bins, rows, columns)."""
        images = self.images
        return gather_torch(
            image,
            batch.point,
            images.grid,
            images.stencil if self.reverse else BILINEAR,
            reverse=self.reverse,
            start=batch.contact_start,
            bins=images.bins,
            point_bin=direction_bins(batch.normal, images.bins) if images.bins > 1 else None,
            threads=self.threads,
        )


def direction_bins(normal: Any, bins: int) -> Any:
    """Return the bin of each normal (M, 2), of its direction modulo pi, as ``dc.Images`` does, (M,) int32."""
    x, y = normal.unbind(dim=1)
    flip = (y < 0) | ((y == 0) & (x < 0))
    turn = torch.atan2(torch.where(flip, -y, y), torch.where(flip, -x, x)) * (1.0 / torch.pi)
    return (turn * bins + 0.5).to(torch.int32) % bins


def squared(output: Any, target: Any, scale: Any) -> tuple[Any, Any]:
    """Sum of the squared errors in units of the scale, and the number of values."""
    return ((output - target) / scale).square().sum(), output.new_tensor(float(output.numel()))


def absolute(output: Any, target: Any, scale: Any) -> tuple[Any, Any]:
    """Sum of the errors' magnitudes in units of the scale, and the number of values."""
    return ((output - target) / scale).abs().sum(), output.new_tensor(float(output.numel()))


def energy(impulse: Any, label: Any, problem: ContactProblem, threads: int = 1) -> tuple[Any, Any]:
    """Return the energy of the error and that of the labels, of all worlds [J]; impulses in the problem's order."""
    error = problem.energy((impulse - label).contiguous(), threads=threads).sum()
    return error, problem.energy(label, threads=threads).sum()


def after_sweeps(
    impulse: Any, label: Any, problem: ContactProblem, sweeps: int, leak: float = 0.0, threads: int = 1
) -> tuple[Any, Any]:
    """Return the squared error of the impulses after sweeps, and the square of the labels [N^2 s^2]."""
    swept = sweeps_torch(impulse, problem, sweeps, leak=leak, threads=threads)[0]
    return (swept - label).square().sum(), label.square().sum()


@dataclass(frozen=True, kw_only=True)
class Loss:
    """Measures an answer, given the image of the labels and the batch."""

    name: LossName
    """Which loss; the module lists them."""
    decode: Decoder
    """How the answer is read at the contacts."""
    grid_scale: Any
    """Scale of each channel of the image, (outputs,) [N s]."""
    contact_scale: Any
    """Scales of normal and tangential impulses, (2,) [N s]."""
    sweeps: int = 20
    """Sweeps of the loss "sweeps" [1]."""
    leak: float = 0.1
    """Share of the gradient that "sweeps" passes where the friction cone stops a row."""

    def __post_init__(self) -> None:
        if self.name not in get_args(LossName):
            raise ValueError(f"loss is {self.name!r}; it must be one of {get_args(LossName)}")

    @property
    def on_grid(self) -> bool:
        """Whether it is measured at the nodes."""
        return self.name.startswith("grid")

    def __call__(self, output: Any, target: Any, batch: Any) -> tuple[Any, Any]:
        """Return total and weight of an answer (B, outputs, rows, columns) [N s]."""
        if self.on_grid:
            measure = squared if self.name == "grid_mse" else absolute
            return measure(output, target, self.grid_scale[:, None, None])
        return self.of_impulses(self.decode(output, batch), batch)

    def of_impulses(self, impulse: Any, batch: Any) -> tuple[Any, Any]:
        """Return total and weight of impulses at the contacts, (M, 2) [N s]; a loss on grids has none."""
        if self.name == "contact_mse":
            return squared(impulse, batch.label, self.contact_scale)
        problem, order = contact_problem(batch)
        impulse, label = impulse[order], batch.label[order]
        if self.name == "energy":
            return energy(impulse, label, problem, self.decode.threads)
        return after_sweeps(impulse, label, problem, self.sweeps, self.leak, self.decode.threads)


def contact_problem(batch: Any) -> tuple[ContactProblem, Any]:
    """Make the problem of each state as the solver packs it, its contacts in the solver's order, by colour.

    Args:
        batch: of the data set.

    Returns:
        The problem, and the order of its contacts: ``impulse[order]`` are those of the batch's ``impulse``.
    """
    states = torch.arange(len(batch.dt))
    of_body = states.repeat_interleave(batch.body_start.diff())
    of_contact = states.repeat_interleave(batch.contact_start.diff())
    order = torch.argsort(of_contact * COLORS + batch.color, stable=True)
    dynamic = batch.mass > 0
    moved = batch.velocity + torch.where(dynamic[:, None], batch.dt[of_body, None] * batch.gravity[of_body], 0.0)
    values = {name: getattr(batch, name)[order] for name in ("body_a", "body_b", "normal", "friction", "bias")}
    point = batch.point[order]
    values.update({f"arm_{side}": point - batch.position[values[f"body_{side}"]] for side in "ab"})
    problem = ContactProblem(
        contact_start=batch.contact_start,
        body_start=batch.body_start,
        inv_mass=torch.where(dynamic, 1.0 / batch.mass, 0.0),
        inv_inertia=torch.where(batch.inertia > 0, 1.0 / batch.inertia, 0.0),
        velocity=torch.cat([moved, batch.angular_velocity[:, None]], dim=1),
        **values,
    )
    return problem, order
