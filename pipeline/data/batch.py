"""States of a data set in memory: whole worlds as read from files, and batches for networks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dc_kernels.model.enums import BodyType
from dc_kernels.model.rules import Number
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.hdf5 import dataset
from pipeline.data.layout import MOTION, STAGES, described


@dataclass(frozen=True)
class Batch:
    """Holds B states one after the other, N bodies and M contacts in all, as tensors in SI units.

    Bodies are in the state before the step. ``start`` has the solver's start impulses, ``impulse`` its solution at the
    run's tolerance, ``label`` that at the label's tolerance: normal and tangential [N s].
    """

    body_start: Any  # (B + 1,) int64, first body of each state
    contact_start: Any  # (B + 1,) int64, first contact of each state
    position: Any  # (N, 2), as all that is not said to be of another dtype float32
    angle: Any  # (N,)
    velocity: Any  # (N, 2)
    angular_velocity: Any  # (N,)
    mass: Any  # (N,), 0 where infinite
    inertia: Any  # (N,), 0 where infinite
    body_type: Any  # (N,) int32, dc.BodyType
    body_a: Any  # (M,) int64, into the N bodies
    body_b: Any  # (M,) int64
    point: Any  # (M, 2)
    normal: Any  # (M, 2), from A to B
    gap: Any  # (M,)
    friction: Any  # (M,)
    restitution: Any  # (M,)
    age: Any  # (M,) int32, 0 where the contact is new
    color: Any  # (M,) int32
    bias: Any  # (M,), added to the normal velocity in the law that impulses satisfy (``layout.LAW``)
    start: Any  # (M, 2)
    impulse: Any  # (M, 2)
    label: Any  # (M, 2)
    dt: Any  # (B,)
    gravity: Any  # (B, 2)
    seed: Any  # (B,) int64, of the world
    step: Any  # (B,) int64, steps before this one
    # static shapes, which the images show as walls
    shape_start: Any  # (B + 1,) int64, first static shape of each state
    shape_body: Any  # (S,) int64, into the N bodies
    shape_type: Any  # (S,) int32, dc.ShapeType
    shape_radius: Any  # (S,)
    vertex_start: Any  # (S + 1,) int64
    vertices: Any  # (V, 2), in the body's frame

    def __len__(self) -> int:
        """Return B, the number of states."""
        return len(self.seed)

    def to(self, *target: Any, **options: Any) -> Batch:
        """Move the tensors as ``Tensor.to`` does."""
        return replace(self, **{f.name: getattr(self, f.name).to(*target, **options) for f in fields(self)})

    def pin_memory(self) -> Batch:
        """Put the tensors into page-locked memory, as torch's loaders ask for."""
        return replace(self, **{f.name: getattr(self, f.name).pin_memory() for f in fields(self)})


# fields of a batch by the axis along which states are put together
BODY = ("mass", "inertia", "body_type")
CONTACT = ("point", "normal", "gap", "friction", "restitution", "age", "color", "bias", *STAGES)
SHAPE = ("shape_type", "shape_radius")
SPECS = described()
_DTYPES = {"color": np.int32}


class World:
    """Holds all states of a world in memory."""

    def __init__(self, file: Any, row: int) -> None:
        """Read a world of an open shard that ``shards.check_shapes`` has passed; ``row`` is its place there.

        Raises:
            ValueError: naming dataset, place and limit: bodies of another world, values of a valid state out of range.
        """

        def part(name: str, first: int, last: int) -> np.ndarray:
            return dataset(file, name)[(slice(None),) * len(SPECS[name].lead) + (slice(first, last),)]

        def rows(name: str, first: int, last: int, valid: np.ndarray | None = None) -> np.ndarray:
            values, spec = part(name, first, last), SPECS[name]
            if spec.rule is not None:
                held = values if valid is None else values[(slice(None),) * len(spec.lead) + (valid,)]
                check_rule(name, held, spec.rule)
            return values

        def span(name: str) -> tuple[int, int]:
            first, last = (int(n) for n in part(name, row, row + 2))
            return first, last

        self.seed, self.dt = int(part("world/seed", row, row + 1)[0]), rows("world/dt", row, row + 1)[0]
        self.gravity = rows("world/gravity", row, row + 1)[0]
        bodies, shapes, steps = (span(f"world/{name}_start") for name in ("body", "shape", "step"))
        motion = part("step/motion_start", steps[0], steps[1] + 1)
        contact = part("step/contact_start", steps[0], steps[1] + 1)
        count = bodies[1] - bodies[0]
        if (np.diff(motion) != count).any():
            raise ValueError(
                f"step/motion_start must rise by the {count} bodies of world {row} with each of its states"
            )
        self.motion_start, self.contact_start = motion - motion[0], contact - contact[0]
        live = part("step/flags", *steps) == 0
        # a state that did not advance may hold anything
        moves, touches = (None, None) if live.all() else (np.repeat(live, count), np.repeat(live, np.diff(contact)))
        self.arrays: dict[str, np.ndarray] = {}
        for name in MOTION:
            self.arrays[name] = rows(f"motion/{name}", motion[0], motion[-1], moves)
        for name in BODY:
            self.arrays[name] = rows(f"body/{name}", *bodies)
        for name in ("body_a", "body_b", *CONTACT[: -len(STAGES)]):
            values = rows(f"contact/{name}", contact[0], contact[-1], touches)
            self.arrays[name] = values.astype(_DTYPES.get(name, values.dtype), copy=False)
        stages = rows("contact/impulse", contact[0], contact[-1], touches)
        self.arrays.update(zip(STAGES, stages))
        body = part("shape/shape_body", *shapes)
        for name, indices in (
            *((f"contact/{name}", self.arrays[name]) for name in ("body_a", "body_b")),
            ("shape/shape_body", body),
        ):
            check_rule(name, indices, Number(0, count - 1))
        self._read_static(rows, part, shapes, body)

    def _read_static(self, rows: Any, part: Any, shapes: tuple[int, int], body: np.ndarray) -> None:
        """Read those of the shapes first, ..., last - 1 that are static."""
        first, last = shapes
        static = self.arrays["body_type"][body] == BodyType.STATIC
        vertex = part("shape/vertex_start", first, last + 1)
        vertices = rows("vertex/vertices", vertex[0], vertex[-1])
        kept = [vertices[a - vertex[0] : b - vertex[0]] for a, b in itertools.pairwise(vertex)]
        kept = [corners for corners, keep in zip(kept, static) if keep]
        self.arrays["shape_body"] = body[static]
        for name in SHAPE:
            self.arrays[name] = rows(f"shape/{name}", first, last)[static]
        self.arrays["vertices"] = np.concatenate([np.zeros((0, 2), np.float32), *kept])
        self.vertex_count = np.array([len(part) for part in kept], np.int64)
