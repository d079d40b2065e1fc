"""Launches over the same worlds as one kernel: a thread takes a shard of worlds through all of them, again and again.

In a shard world follows world, and in a world stage follows stage, so that what a world needs stays in the processor's
cache; a launch of a hundred arrays, which costs 50 us, is made once for many rounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dc_kernels._taichi.runtime.access import Array
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import Fields, Kernel, KernelLaunch, merged, named, shared
from dc_kernels._taichi.runtime.launches import Argument, Bound
from dc_kernels._taichi.runtime.sources import define

_made: dict[tuple[Any, ...], Any] = {}


def repeated(
    launches: Sequence[Any],
    shard_start: np.ndarray,
    *,
    parallel: bool,
    todo: np.ndarray,
    taken: np.ndarray,
    halt: np.ndarray,
    flags: np.ndarray,
    stop_at: int,
    used: Sequence[np.ndarray],
    peak: np.ndarray,
) -> Bound:
    """A launch that takes each shard of worlds through rounds of launches until a flag of a world ends them.

    Args:
        launches: one round; each over the same worlds, one thread a world.
        shard_start: first world of each shard, counted from that of the launches, and their number, (S + 1,) int32.
        parallel: whether threads share the shards.
        todo: rounds that each shard has to take, (S,) int32.
        taken: raised by the rounds that each shard took, with the one in which a world stopped, (S,) int32.
        halt: set to the bits that ended the rounds of a shard, (S,) int32.
        flags: bits of each world, int32.
        stop_at: bits of ``flags`` that end the rounds of a shard; the others go on.
        used: how much of each kind of room a world uses, int32.
        peak: raised to the most of each kind that a world used after any round, (S, kinds) int32.

    Raises:
        ValueError: where a launch is no kernel's, or the launches do not agree in their worlds or in an argument.
    """
    shards = len(shard_start) - 1
    given: dict[Array, Argument] = {}
    constants: dict[Array, Any] = {}
    for launch in launches:
        if not isinstance(launch, KernelLaunch) or launch.extent != launches[0].extent or launch.source.axes != 1:
            raise ValueError(f"{launch} is no kernel over the worlds of the other launches")
        for array, argument in launch.given.items():
            before = given.get(array)
            if before is not None and not _agree(before.value, argument.value):
                raise ValueError(f"{argument.name} is not the same in all launches")
            written = argument.written or (before is not None and before.written)
            given[array] = argument._replace(written=written)
        constants |= launch.constants
    other = shared(given)
    given = merged(given, other)
    vector = ti.types.ndarray(dtype=ti.i32, ndim=1)
    # memory that the stages have too must not be seen by another name
    seen = {
        one.value.ctypes.data: array
        for array, one in given.items()
        if isinstance(one.value, np.ndarray) and one.value.size
    }
    places = [seen.get(one.ctypes.data) for one in (flags, *used)]
    own = [
        Argument("shards", ti.i32, shards, False),
        Argument("stop_at", ti.i32, stop_at, False),
        Argument("shard_start", vector, shard_start, False),
        Argument("todo", vector, todo, False),
        Argument("taken", vector, taken, True),
        Argument("halt", vector, halt, True),
        Argument("peak", ti.types.ndarray(dtype=ti.i32, ndim=2), peak, True),
    ]
    own += [Argument(f"watch{k}", vector, one, False) for k, one in enumerate((flags, *used)) if places[k] is None]
    arguments = [*own, *given.values()]
    kernels = tuple(launch.source for launch in launches)

    def make(parallel: bool) -> Any:
        key = (kernels, tuple(places), parallel, *constants.values(), *other)
        if key not in _made:
            types = [argument.annotation for argument in arguments]
            scope = {"ti": ti, "types": types, "Fields": Fields}
            scope |= {f"stage{i}": kernel.func for i, kernel in enumerate(kernels)}
            names = named(given, {}, {})
            inside = named(given, constants, other)
            source = _source(kernels, [a.name for a in own], names, inside, places, parallel)
            _made[key] = define(source, "repeated", scope)
        return _made[key]

    real = kernels[0].real
    return Bound("a step", make, arguments, real=real, parallel=parallel, large=True)


def _agree(one: Any, other: Any) -> bool:
    """Whether two arguments are one."""
    if isinstance(one, np.ndarray):
        return one.ctypes.data == other.ctypes.data and one.shape == other.shape
    return one == other


def _source(
    kernels: Sequence[Kernel],
    own: Sequence[str],
    names: Mapping[Array, str],
    inside: Mapping[Array, str],
    places: Sequence[Array | None],
    parallel: bool,
) -> str:
    """Source of the kernel."""
    watched = [f"watch{k}" if place is None else names[place] for k, place in enumerate(places)]
    annotations = [f"{name}: types[{i}]" for i, name in enumerate([*own, *names.values()])]
    offset = names.get(Array("launch", "world_offset"), "0")
    lines = ["@ti.kernel", f"def repeated({', '.join(annotations)}):"]
    lines += ["    ti.loop_config(block_dim=1)" if parallel else "    ti.loop_config(serialize=True)"]
    lines += [
        "    for shard in range(shards):",
        "        done = 0",
        "        full = 0",
        "        while done < todo[shard] and full == 0:",
        "            for tid in range(shard_start[shard], shard_start[shard + 1]):",
    ]
    lines += [
        f"                stage{i}(tid, {', '.join(kernel.call(inside, parallel))})" for i, kernel in enumerate(kernels)
    ]
    lines += [
        "            done += 1",
        f"            for w in range(shard_start[shard] + {offset}, shard_start[shard + 1] + {offset}):",
        f"                full = full | ({watched[0]}[w] & stop_at)",
    ]
    for k, name in enumerate(watched[1:]):
        lines.append(f"                peak[shard, {k}] = ti.max(peak[shard, {k}], {name}[w])")
    lines += ["        taken[shard] = taken[shard] + done", "        halt[shard] = halt[shard] | full", ""]
    return "\n".join(lines)
