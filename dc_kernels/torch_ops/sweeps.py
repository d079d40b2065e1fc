"""Projected Gauss-Seidel sweeps over contact problems as torch operators, with their adjoints.

Importing this module registers ``deep_contact::push_impulses``, ``pull_velocities``, ``sweep_problem`` and
``pull_problem`` with torch, so that autograd and ``torch.compile`` see one opaque operator each; they need the extra
``pipeline``. ``dc_kernels.learn.differentiable`` calls them on problems that it has checked and packed.
"""

from __future__ import annotations

import functools
from typing import Any

from dc_kernels.runtime.backends import make_kernels
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.launches import Calls

torch = require("torch", "pipeline")


def sweep_kernels(backend: str, dtype: str) -> dict[str, Any]:
    """Look up the kernels that fill in rows, multiply by J, sweep, and step backwards."""
    return make_kernels(backend, "learn.differentiable", dtype)


# ------------------------------------------------------------------ calls


@functools.cache
def _calls(name: str, dtype: str) -> Calls:
    return Calls(sweep_kernels("warp", dtype)[name])


def launch(name: str, threads: int, values: dict[str, Any]) -> None:
    """Launch a kernel on tensors by name, each thread on its share of the worlds."""
    dtype = str(values["row"].dtype).removeprefix("torch.")
    _calls(name, dtype)(values, len(values["contact_start"]) - 1, threads)


# ------------------------------------------------------------------ operators

_PROBLEM = "Tensor inverse, Tensor row, Tensor row_body, Tensor contact_start, int threads"


@torch.library.custom_op(
    "deep_contact::push_impulses", mutates_args=(), schema=f"(Tensor impulse, Tensor velocity, {_PROBLEM}) -> Tensor"
)
def _push(impulse: Any, velocity: Any, inverse: Any, row: Any, row_body: Any, contact_start: Any, threads: int) -> Any:
    pushed = velocity.clone()
    arrays = {"contact_start": contact_start, "row": row, "row_body": row_body}
    launch("push_impulses", threads, {**arrays, "impulse": impulse, "velocity": pushed})
    return pushed


@torch.library.custom_op(
    "deep_contact::pull_velocities", mutates_args=(), schema=f"(Tensor velocity, {_PROBLEM}) -> Tensor"
)
def _pull(velocity: Any, inverse: Any, row: Any, row_body: Any, contact_start: Any, threads: int) -> Any:
    """Compute J M^-1 velocity, (M, 2): the adjoint of ``push_impulses``."""
    speed = row.new_empty((len(row), 2))
    arrays = {"contact_start": contact_start, "row": row, "row_body": row_body}
    launch("pull_velocities", threads, {**arrays, "velocity": inverse * velocity, "speed": speed})
    return speed


@torch.library.custom_op(
    "deep_contact::sweep_problem",
    mutates_args=(),
    schema=f"(Tensor impulse, Tensor velocity, {_PROBLEM}, int sweeps, float leak) -> (Tensor, Tensor, Tensor, Tensor)",
)
def _sweep(
    impulse: Any,
    velocity: Any,
    inverse: Any,
    row: Any,
    row_body: Any,
    contact_start: Any,
    threads: int,
    sweeps: int,
    leak: float,
) -> tuple[Any, ...]:
    impulse, velocity, change = impulse.clone(), velocity.clone(), torch.zeros_like(impulse)
    active = torch.empty((sweeps, len(row)), dtype=torch.int8)
    arrays = {"contact_start": contact_start, "row": row, "row_body": row_body}
    results = {"impulse": impulse, "velocity": velocity, "change": change, "active": active}
    launch("sweep_problem", threads, {**arrays, **results})
    return impulse, velocity, change, active


@torch.library.custom_op(
    "deep_contact::pull_problem",
    mutates_args=(),
    schema="(Tensor by_impulse, Tensor by_velocity, Tensor by_change, Tensor active, "
    f"{_PROBLEM}, float leak) -> Tensor",
)
def _pull_problem(
    by_impulse: Any,
    by_velocity: Any,
    by_change: Any,
    active: Any,
    inverse: Any,
    row: Any,
    row_body: Any,
    contact_start: Any,
    threads: int,
    leak: float,
) -> Any:
    """Compute the cotangent of the impulses that ``sweep_problem`` began with, (M, 2)."""
    result = by_impulse.clone(memory_format=torch.contiguous_format)
    arrays = {"contact_start": contact_start, "row": row, "row_body": row_body, "leak": leak}
    given = {"active": active, "by_change": by_change, "by_velocity": inverse * by_velocity}
    launch("pull_problem", threads, {**arrays, **given, "by_impulse": result})
    return result


@_push.register_fake
def _(impulse: Any, velocity: Any, *rest: Any) -> Any:
    return torch.empty_like(velocity)


@_pull.register_fake
def _(velocity: Any, inverse: Any, row: Any, *rest: Any) -> Any:
    return row.new_empty((row.shape[0], 2))


@_sweep.register_fake
def _(impulse: Any, velocity: Any, inverse: Any, row: Any, *rest: Any) -> tuple[Any, ...]:
    active = row.new_empty((rest[-2], row.shape[0]), dtype=torch.int8)
    return torch.empty_like(impulse), torch.empty_like(velocity), torch.empty_like(impulse), active


@_pull_problem.register_fake
def _(by_impulse: Any, *rest: Any) -> Any:
    return torch.empty_like(by_impulse, memory_format=torch.contiguous_format)


# Only the impulse has a derivative; the problem's own tensors are constants.


def _push_setup(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    ctx.save_for_backward(*inputs[2:6])
    ctx.threads = inputs[6]


def _push_backward(ctx: Any, by_velocity: Any) -> tuple[Any, ...]:
    by_impulse = torch.ops.deep_contact.pull_velocities(by_velocity.contiguous(), *ctx.saved_tensors, ctx.threads)
    return by_impulse, *(None,) * 6


def _sweep_setup(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    ctx.save_for_backward(output[3], *inputs[2:6])
    ctx.threads, _, ctx.leak = inputs[6:]


def _sweep_backward(ctx: Any, by_impulse: Any, by_velocity: Any, by_change: Any, _: Any) -> tuple[Any, ...]:
    cotangents = (by.contiguous() for by in (by_impulse, by_velocity, by_change))
    result = torch.ops.deep_contact.pull_problem(*cotangents, *ctx.saved_tensors, ctx.threads, ctx.leak)
    return result, *(None,) * 8


_push.register_autograd(_push_backward, setup_context=_push_setup)
_sweep.register_autograd(_sweep_backward, setup_context=_sweep_setup)
