"""Public functions and classes, arguments that they take, and what each argument may be: for ``calls``."""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from bench.faults.values import HUGE, Array, Given, Numbers, TimeStep, Vector
from dc_kernels.model.checks import FIELDS, MATERIAL, Finite, NotNegative
from dc_kernels.model.settings import Count, Limits, Positive, Whole

Backend = Literal["warp", "numpy"]
Dtype = Literal["float32", "float64"]


class Target(NamedTuple):
    """A function with arguments that it takes, and what each of them may be."""

    name: str
    """Of the function."""
    make: Callable[[], Callable[..., Any]]
    """Makes the function anew for each call."""
    good: Callable[[], dict[str, Any]]
    """Makes arguments that are right."""
    hints: dict[str, Any]
    """Annotations, or ``Array``, of the arguments that are tried."""
    called: dict[str, tuple[str, ...]] = {}
    """What errors may call an argument, beside its name."""


def always(value: Any) -> Callable[[], Any]:
    """What gives a value when it is called."""
    return lambda: value


# ---------------------------------------------------------------------- what is called


def builder() -> Any:
    """A builder with a world, a dynamic body and a static one."""
    import dc_kernels as dc

    made = dc.ModelBuilder()
    made.add_world()
    made.add_disc(made.add_body((0.0, 0.49)), 0.5)
    made.add_box(made.add_body((0.0, -0.5), type=dc.BodyType.STATIC), 5.0, 0.5)
    return made


def simulation(phase: str = "advance", backend: str = "numpy") -> Any:
    """A simulation of one contact in a phase of its step."""
    import dc_kernels as dc

    sim = dc.Simulation(*builder().finalize(backend=backend))
    sim.collide(0.01)
    if phase != "collide":
        sim.solve()
    if phase == "advance":
        sim.advance()
    return sim


def builder_targets() -> Iterator[Target]:
    """The methods of ``ModelBuilder``."""

    def method(name: str, good: dict[str, Any], hints: dict[str, Any], **called: tuple[str, ...]) -> Target:
        return Target(f"add_{name}", lambda: getattr(builder(), f"add_{name}"), lambda: dict(good), hints, called)

    disc = {"body": 0, "radius": 0.5}
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    angles = {"angle": Finite, "angular_velocity": Finite}
    yield method("world", {}, {"gravity": Vector, "origin": Vector, "length_scale": FIELDS["length_scale"] | None})
    yield method(
        "body",
        {},
        {"position": Vector, "velocity": Vector, **angles, "mass": FIELDS["mass"] | None}
        | {"inertia": FIELDS["inertia"] | None, "type": Given("12", None, True, 2.0, math.nan, 7, -1, *HUGE)},
    )
    yield method("disc", disc, {"body": Whole, "radius": FIELDS["radius"], "center": Vector, **MATERIAL})
    box = {"body": 0, "half_width": 0.5, "half_height": 0.5}
    sides = {name: FIELDS[name] for name in ("half_width", "half_height")}
    yield method(
        "box", box, {"body": Whole, **sides, "center": Vector, "angle": Finite, "radius": NotNegative, **MATERIAL}
    )
    polygon = {"body": 0, "vertices": square}
    corners = Array(3, 2, strict=False)
    yield method("polygon", polygon, {"body": Whole, "vertices": corners, "radius": NotNegative, **MATERIAL})
    capsule = {"body": 0, "p1": (0.0, 0.0), "p2": (1.0, 0.0), "radius": 0.1}
    yield method(
        "capsule", capsule, {"body": Whole, "p1": Vector, "p2": Vector, "radius": FIELDS["radius"], **MATERIAL}
    )
    chain = {"body": 1, "vertices": square}
    yield method("chain", chain, {"body": Whole, "vertices": corners, "closed": bool, **MATERIAL})
    joint = {"body_a": 0, "body_b": 1}
    yield method(
        "distance_joint",
        joint,
        {"body_a": Whole, "body_b": Whole, "anchor_a": Vector, "anchor_b": Vector, "length": FIELDS["length"] | None},
    )
    discs = {"positions": [(5.0, 5.0), (7.0, 5.0)], "radius": 0.5}
    column = {name: Array(2, strict=False) for name in ("radius", *angles, *MATERIAL)}
    yield method(
        "discs",
        discs,
        {"positions": Array(2, 2, strict=False), "velocity": Array(2, 2, strict=False, optional=True)}
        | {name: Numbers() for name in column},
    )
    places = {"dtype": Dtype, "device": Literal["cpu"], "backend": Backend}
    yield Target("finalize", lambda: builder().finalize, dict, places)


def simulation_targets() -> Iterator[Target]:
    """``Simulation`` and its methods, energies and overlap."""
    import dc_kernels as dc
    from dc_kernels import measure

    def arrays() -> dict[str, Any]:
        return dict(zip(("model", "state", "joints"), builder().finalize(backend="numpy")))

    options = {
        "config": dc.SolverConfig | None,
        "threads": Count,
        "schedule": Literal["world", "color"],
        "on_overflow": Literal["grow", "raise"],
        "specialize": bool,
        "pairs_per_shape": NotNegative,
        "contacts_per_body": NotNegative,
    }
    groups = {"model": dc.Model, "state": dc.State, "joints": dc.Joints | None}
    yield Target("Simulation", lambda: dc.Simulation, arrays, {**groups, **options})
    start = {"start": Callable[..., Any] | None}
    sim = simulation
    yield Target("step", lambda: sim().step, lambda: {"dt": 0.01}, {"dt": TimeStep, **start})
    run = {"steps": Whole, "dt": TimeStep, **start, "callback": Callable[..., Any] | None}
    yield Target("run", lambda: sim().run, lambda: {"steps": 0, "dt": 0.01}, run)
    yield Target("collide", lambda: sim().collide, lambda: {"dt": 0.01}, {"dt": TimeStep})
    solve = {"config": dc.SolverConfig | None, "pause": Whole | None}
    yield Target("solve", lambda: sim("collide").solve, dict, solve)

    def paused() -> Callable[..., Any]:
        made = sim("collide")
        made.solve(pause=1)
        return made.resume

    yield Target("resume", paused, dict, solve)
    stage = {"name": Given("nosuch", None, True, 2.0, 7), "changed": Given({"nosuch": 1}, {1: 1}, 7, "a", [1])}
    some = {"name": "predict", "first": 0, "count": 1}
    yield Target("bind", lambda: sim().bind, lambda: dict(some), {**stage, "first": Whole, "count": Whole})

    def setter() -> Callable[..., Any]:
        made = sim()
        return lambda config: setattr(made, "config", config)

    yield Target("Simulation.config", setter, lambda: {"config": dc.SolverConfig()}, {"config": dc.SolverConfig})
    for function in (dc.kinetic_energy, dc.potential_energy, measure.momentum, dc.overlap):
        yield Target(function.__name__, always(function), lambda: {"sim": sim()}, {"sim": dc.Simulation})
    yield Target(
        "overlap", lambda: dc.overlap, lambda: {"sim": sim()}, {"recollide": Positive | None}, {"recollide": ("dt",)}
    )
    yield Target("save", lambda: sim().save, lambda: {"path": folder() / "a.h5"}, {"path": Path})
    yield Target("load", lambda: dc.Simulation.load, snapshot, {"path": Path, "threads": Count | None})


@functools.cache
def folder() -> Path:
    """A folder for the files of this process."""
    return Path(tempfile.mkdtemp(prefix="bad-calls-"))


def snapshot() -> dict[str, Any]:
    """The path of a snapshot."""
    path = folder() / "snapshot.h5"
    if not path.exists():
        simulation().save(path)
    return {"path": path}


def grid_targets() -> Iterator[Target]:
    """Grids, images, splats and gathers."""
    import dc_kernels as dc

    grid = dc.Grid(rows=8, columns=8, spacing=1.0)
    points, values = np.full((3, 2), 2.5, np.float32), np.ones((3, 1), np.float32)
    image = np.ones((1, 1, 8, 8), np.float32)
    places = {"grid": dc.Grid, "stencil": dc.Stencil}
    options = {"bins": Count, "threads": Count, "backend": Backend}
    offsets = {"start": Array(2, whole=True, optional=True), "point_bin": Array(3, whole=True, optional=True)}
    shape = {"points": Array(3, 2), "out": Array(1, 1, 8, 8, optional=True, finite=False)}
    cloud = {"points": points, "values": values, "grid": grid, "bins": 2, "point_bin": np.zeros(3, np.int32)}

    def splat() -> dict[str, Any]:
        return {name: value.copy() if isinstance(value, np.ndarray) else value for name, value in cloud.items()}

    shape2 = {**shape, "out": Array(1, 2, 8, 8, optional=True, finite=False)}
    yield Target("splat", lambda: dc.splat, splat, {**shape2, "values": Array(3, 1), **places, **options, **offsets})
    back = {"image": image, "points": points, "grid": grid}
    yield Target(
        "gather",
        lambda: dc.gather,
        lambda: dict(back),
        {
            "points": Array(3, 2),
            "image": Array(1, 1, 8, 8),
            "out": Array(3, 1, optional=True, finite=False),
            **places,
            **options,
        }
        | {"reverse": bool, **offsets},
    )
    yield Target("Transfer", lambda: dc.Transfer, lambda: {"grid": grid}, {**places, **options})
    corners = {"lower": Vector, "upper": Vector}
    box = {"lower": (0.0, 0.0), "upper": (2.0, 2.0)}
    yield Target(
        "from_box", lambda: dc.Grid.from_box, lambda: {**box, "spacing": 0.5}, {**corners, "spacing": Positive}
    )
    where = {"points": Array(3, 2, strict=False), "start": offsets["start"]}
    choice = {**where, **corners, "max_nodes": Count, "max_spacing": Positive | None}
    yield Target("choose_grid", lambda: dc.choose_grid, lambda: {"points": points, **box}, choice)
    yield Target(
        "shared_cells", lambda: dc.shared_cells, lambda: {"points": points, "grid": grid}, {**where, "grid": dc.Grid}
    )
    spec = dc.ImageSpec(grid)
    described = Given("12", 3, None, [1], {}, {1: 2}, {**spec.to_dict(), "grid": 3}, {**spec.to_dict(), "nothing": 1})
    yield Target("from_dict", lambda: dc.ImageSpec.from_dict, lambda: {"values": spec.to_dict()}, {"values": described})
    threads = {"threads": Count | None}
    yield Target(
        "Images",
        lambda: dc.Images,
        lambda: {"sim": simulation(), "spec": spec},
        {"sim": dc.Simulation, "spec": dc.ImageSpec, **threads},
    )

    def images() -> Any:
        return dc.Images(simulation(), spec)

    way = {"stencil": dc.Stencil | None, "reverse": bool}
    one = {"image": np.zeros((1, 2, 8, 8), np.float32)}
    yield Target(
        "Images.gather",
        lambda: images().gather,
        lambda: dict(one),
        {"image": Array(1, 2, 8, 8, finite=False), **way, "at": Literal["contacts", "bodies"]},
    )
    yield Target(
        "start_from", lambda: images().start_from, lambda: dict(one), {"image": Array(1, 2, 8, 8, finite=False), **way}
    )
    yield Target("starter", lambda: images().starter, lambda: {"predict": len}, {"predict": Callable[..., Any]})


def point_targets() -> Iterator[Target]:
    """Searches and sums over neighbours, smoothing kernels."""
    import dc_kernels as dc
    from dc_kernels.neighbors.search import METHODS
    from dc_kernels.sph import smoothing
    from dc_kernels.sph.quantities import PUBLIC

    points = np.random.default_rng(0).random((4, 2)).astype(np.float32)
    ones = np.ones(4, np.float32)
    ways = {"method": Literal[METHODS], "threads": Count, "backend": Backend}
    cloud, start = Array(4, 2), Array(2, whole=True, optional=True)
    radius = {"radius": Positive}
    pairs = {"points": cloud, **radius, "start": start, **ways}
    yield Target("neighbor_pairs", lambda: dc.neighbor_pairs, lambda: {"points": points, "radius": 0.1}, pairs)
    lists = {"queries": cloud, "points": cloud, **radius, "query_start": start, "point_start": start, **ways}
    both = {"queries": points, "points": points, "radius": 0.1}
    yield Target("neighbor_lists", lambda: dc.neighbor_lists, lambda: dict(both), lists)
    searched = {"points": points, "radius": 0.1}
    yield Target(
        "NeighborSearch", lambda: dc.NeighborSearch, lambda: dict(searched), {"points": cloud, **radius, **ways}
    )
    kernel = {"h": Positive, "kernel": Literal[tuple(smoothing.KERNELS)]}
    fields = {"mass": Array(4), "density": Array(4)}
    starts = {"query_start": start, "point_start": start}
    particles = {"queries": points, "points": points, "values": ones[:, None], "mass": ones, "density": ones, "h": 0.1}
    quantity = {"quantity": Literal[tuple(PUBLIC)]}
    known = {"queries": cloud, "points": cloud, "values": Array(4, 1), **fields, **kernel, **starts, **ways, **quantity}
    yield Target("sph_sum", lambda: dc.sph_sum, lambda: dict(particles), known)
    density = {"points": cloud, "mass": Array(4), **kernel, "start": start, **ways}
    yield Target("sph_density", lambda: dc.sph_density, lambda: {"points": points, "mass": ones, "h": 0.1}, density)
    dim = {"dim": Literal[2, 3]}
    any_r = {"r": Array(2, strict=False, fixed=False)}
    for name in ("smoothing", "smoothing_laplacian"):
        function = getattr(smoothing, name)
        yield Target(
            name, always(function), lambda: {"kernel": "poly6", "r": 0.1, "h": 1.0}, {**kernel, **dim, **any_r}
        )
    for name in ("smoothing_gradient", "smoothing_hessian", "smoothing_laplacian_gradient"):
        function = getattr(smoothing, name)
        yield Target(
            name,
            always(function),
            lambda: {"kernel": "poly6", "offset": (0.1, 0.0), "h": 1.0},
            {**kernel, "offset": Array(2, strict=False, fixed=False)},
        )


def delassus_targets() -> Iterator[Target]:
    """Problems in Delassus form and their solvers."""
    import dc_kernels as dc
    from dc_kernels import delassus

    arrays = {"row_start": [0, 1], "column": [0], "block": np.eye(2)[None], "q": [[-1.0, 0.5]], "mu": [0.3]}

    def problem() -> Any:
        return delassus.DelassusProblem(**arrays)  # type: ignore[arg-type]

    shapes = {
        "row_start": Array(2, whole=True, strict=False),
        "column": Array(1, whole=True, strict=False),
        "block": Array(1, 2, 2, strict=False),
        "q": Array(1, 2, strict=False),
        "mu": Array(1, strict=False),
    }
    yield Target(
        "DelassusProblem",
        lambda: delassus.DelassusProblem,
        lambda: dict(arrays),
        shapes,
        {"mu": ("q",), "column": ("block",)},
    )
    options = {
        "problem": delassus.DelassusProblem,
        "method": delassus.Method,
        "tolerance": Positive,
        "max_sweeps": Whole,
        "start": Array(1, 2, strict=False, optional=True),
        "scaled": bool,
        "every": Count,
        "omega": Annotated[float, Limits(above=0.0, below=2.0)],
        "dtype": Dtype,
        "backend": Backend,
    }
    yield Target("delassus.solve", lambda: delassus.solve, lambda: {"problem": problem(), "backend": "numpy"}, options)
    world = {"sim": dc.Simulation, "world": Whole}
    at = simulation
    yield Target("from_world", lambda: delassus.from_world, lambda: {"sim": at("collide")}, world)
    refine = {"sim": dc.Simulation, "tolerance": Positive, "max_sweeps": Whole}
    yield Target("refine", lambda: delassus.refine, lambda: {"sim": at("solve"), "tolerance": 1.0}, refine)

    def given() -> dict[str, Any]:
        sim = at("solve")
        return {"sim": sim, "given": delassus.from_world(sim)}

    yield Target(
        "read_impulses",
        lambda: delassus.read_impulses,
        given,
        {"sim": dc.Simulation, "given": delassus.DelassusProblem},
    )
    solution = {"world": Whole, "given": delassus.DelassusProblem, "solution": delassus.DelassusSolution}

    def solved() -> dict[str, Any]:
        found = given()
        return {**found, "world": 0, "solution": delassus.solve(found["given"], "pgs", backend="numpy")}

    yield Target("write_impulses", lambda: delassus.write_impulses, solved, {"sim": dc.Simulation, **solution})
