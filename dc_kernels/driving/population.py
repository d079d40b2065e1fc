"""Bodies, shapes and joints that come and go between steps.

Each world has slots of bodies and shapes, more than it uses where some were reserved or have become free. What is in a
slot keeps its place in the arrays for as long as it is there. An empty slot has a static body without shapes, or a disc
that collides with nothing, so that no kernel needs to know of it. The vertices of shapes lie packed, as nothing refers
to them by index, and so do joints, whose coming and going lays the arrays out anew (``relayout``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.choice import Planned, check_kernels
from dc_kernels.driving.additions import Added, Additions, Fragment
from dc_kernels.driving.changes import recolor
from dc_kernels.driving.ids import ATTIC, EMPTY
from dc_kernels.driving.relayout import NEUTRAL, Layout, NewJoints, park, relayout, relink
from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.enums import BodyType, Rest
from dc_kernels.model.fields import JOINTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS, MODEL, PER_CONTACT, STATE, TRAITS
from dc_kernels.model.room import GROWTH, rows_of
from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.threads import uninterrupted
from dc_kernels.sleep.sleepers import mark

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

BODY = tuple(name for name, field in MODEL.items() if TRAITS.get(field.per, field.per) == "body")
SHAPE = tuple(name for name, field in MODEL.items() if TRAITS.get(field.per, field.per) == "shape")
POSE = tuple(name for name, field in STATE.items() if field.per == "body")
LINKS = tuple(name for name, field in JOINTS.items() if field.per == "joint")
ENDS = ("joint_body_a", "joint_body_b")
RESERVE = 'reserve more before, or make the simulation with on_overflow="grow"'
SEEN = ("position", "angle", "force", "torque")
FEW = 64  # changed shapes up to which what lies between them is moved run by run


class Arrays:
    """Arrays of groups to write into: the memory itself on a CPU; copies on a GPU, which ``flush`` takes back."""

    def __init__(self) -> None:
        self._open: dict[tuple[int, str], tuple[ArrayGroup, np.ndarray]] = {}

    def __call__(self, group: ArrayGroup, name: str) -> np.ndarray:
        """The array of a field."""
        key = (id(group), name)
        if key not in self._open:
            self._open[key] = (group, group.memory(name))
        return self._open[key][1]

    def flush(self) -> None:
        """Let all that was written arrive."""
        for (_, name), (group, array) in self._open.items():
            if group.device != "cpu":
                group.fill(name, array)


def add(sim: Simulation, additions: Additions) -> Added:
    """See ``Simulation.add``."""
    if not isinstance(additions, Additions):
        raise WrongType(f"additions is {shown(additions)}; it must be what sim.additions() makes")
    if additions.sim is not sim:
        raise ValueError("the additions were made for another simulation")
    fragment = additions.collect()
    given, known, world = fragment.fields, fragment.known, fragment.world
    planned = Planned(given, lambda name: np.zeros(len(world["joint"]) if name in LINKS else 0))
    check_kernels(planned, planned, sim.config, sim.specialize, sim.backend)
    now = sim.model.numpy("body_type")[sim.ids.find("body", fragment.known_ids)]
    if (now != given["body_type"][known]).any():
        i = int((now != given["body_type"][known]).argmax())
        raise ValueError(
            f"body {fragment.known_ids[i]} has become {BodyType(int(now[i])).name}: begin the additions anew"
        )
    new = np.ones(len(world["body"]), bool)
    new[known] = False
    with uninterrupted():
        _make_room(sim, fragment, world["body"][new])
        bodies = np.empty(len(new), np.int64)
        bodies[known] = sim.ids.find("body", fragment.known_ids)
        come = bodies[new] = _free_slots(sim, "body", world["body"][new])
        shapes = _free_slots(sim, "shape", world["shape"])
        arrays = Arrays()
        for name in BODY:
            _write(arrays, sim.model, name, come, given, new)
        for group in (sim.state, sim.built):
            for name in POSE:
                arrays(group, name)[come] = given[name][new] if name in given else 0
        corners = [given[name] for name in ("vertices", "vertex_normals")]
        _splice(sim, arrays, shapes, np.diff(given["vertex_start"]), corners)
        for name in SHAPE:
            _write(arrays, sim.model, name, shapes, given, slice(None))
        arrays(sim.model, "shape_body")[shapes] = bodies[given["shape_body"]]
        arrays.flush()
        for kind, slots in (("body", come), ("shape", shapes)):
            sim.ids.array(f"{kind}_id")[slots] = sim.ids.take(kind, len(slots))
        sim.storage.fill_slots({"body": come, "shape": shapes})
        body_ids, shape_ids = sim.ids.numpy("body_id")[bodies], np.empty(len(shapes), np.int64)
        shape_ids[fragment.order] = sim.ids.numpy("shape_id")[shapes]
        joint_ids = sim.ids.take("joint", len(world["joint"]))
        _see(sim, come)
        if len(joint_ids):
            fields = {name: given[name] for name in LINKS if name in given}
            fields |= {name: bodies[fields[name]] for name in ENDS}
            relink(sim, None, NewJoints(fields, world["joint"], joint_ids))
            recolor(sim, np.unique(world["joint"]), np.zeros(0, np.int64))
        if len(come) or len(shapes):
            _take_up(sim, shapes, bool((given["body_type"][new] == BodyType.DYNAMIC).any()), _are_plain(sim, shapes))
        if sim.storage.sleep.allowed:
            touched = np.zeros(len(new), bool)
            for name in ("shape_body", *ENDS):
                touched[given[name]] = True
            roused = sim.ids.find("body", body_ids[touched & ~new])
            _rouse(sim, roused, np.unique(np.concatenate(list(world.values()))))
    return Added(body_ids, shape_ids, joint_ids, body_ids[new])


def remove(sim: Simulation, bodies: Any, shapes: Any, joints: Any) -> None:
    """See ``Simulation.remove``."""
    chosen = {"body": bodies, "shape": shapes, "joint": joints}
    at = {kind: sim.ids.find(kind, ids, once=True) for kind, ids in chosen.items()}
    model, links = sim.model, sim.joints
    gone = np.zeros(model.body_count, bool)
    gone[at["body"]] = True
    ends = [links.numpy(name) for name in ENDS]
    cut = gone[ends[0]] | gone[ends[1]]
    cut[at["joint"]] = True
    neighbors = np.zeros(model.body_count, bool)
    for end in ends:
        neighbors[end[cut]] = True
    named = sim.ids.numpy("body_id")
    lost = np.zeros(model.shape_count, bool)
    lost[at["shape"]] = True
    lost |= gone[model.numpy("shape_body")]
    neighbors[model.numpy("shape_body")[lost]] = True
    ids = {"body": named[gone], "shape": sim.ids.numpy("shape_id")[lost], "roused": named[neighbors & ~gone]}
    first = {axis: model.numpy(f"{axis}_start") for axis in ("body", "shape", "joint")}
    worlds = [
        np.searchsorted(first[axis], np.flatnonzero(which), "right") - 1
        for axis, which in (("body", gone), ("shape", lost), ("joint", cut))
    ]
    with uninterrupted():
        if cut.any():
            relink(sim, np.flatnonzero(cut), None)
            recolor(sim, np.unique(worlds[2]), np.zeros(0, np.int64))
        if lost.any() and not (named == ATTIC).any():
            relayout(sim, Layout.of(model))
        slots, bodies = (sim.ids.find(kind, ids[kind]) for kind in ("shape", "body"))
        roused = np.concatenate([sim.ids.find("body", ids["roused"]), _forget_contacts(sim, slots)])
        weigh, plain = bool((sim.model.numpy("body_type")[bodies] == BodyType.DYNAMIC).any()), _are_plain(sim, slots)
        _leave(sim, bodies)
        arrays = Arrays()
        for name in BODY:
            if len(sim.model.numpy(name)):
                arrays(sim.model, name)[bodies] = NEUTRAL.get(name, 0)
        for group in (sim.state, sim.built):
            for name in POSE:
                arrays(group, name)[bodies] = 0
        nothing = np.zeros((len(slots), 2), sim.model.dtype)
        _splice(sim, arrays, slots, np.ones(len(slots), np.int64), [nothing, nothing])
        fields = {name: arrays(sim.model, name) for name in (*SHAPE, "vertices", "vertex_normals", "vertex_start")}
        fields |= {name: sim.model.numpy(name) for name in ("shape_start", "length_scale")}
        park(fields, slots, np.flatnonzero(sim.ids.numpy("body_id") == ATTIC))
        arrays.flush()
        sim.ids.array("body_id")[bodies] = EMPTY
        sim.ids.array("shape_id")[slots] = EMPTY
        _see(sim, bodies)
        _take_up(sim, slots, weigh, plain)
        _rouse(sim, roused, np.unique(np.concatenate(worlds)))


def reserve(sim: Simulation, bodies: int, shapes: int, vertices: int) -> None:
    """See ``Simulation.reserve``."""
    model = sim.model
    layout = Layout.of(model)
    missing = {}
    for axis, wanted in (("body", bodies), ("shape", shapes)):
        missing[axis] = np.maximum(wanted - _free(sim, axis), 0)
    layout.bodies = layout.bodies + missing["body"]
    layout.shapes = layout.shapes + missing["shape"]
    used = int(model.numpy("vertex_start")[-1]) + int(missing["shape"].sum())
    layout.vertices = max(layout.vertices, used + max(vertices - shapes, 0) * model.world_count)
    if any(values.any() for values in missing.values()) or layout.vertices > model.sizes["vertex"]:
        with uninterrupted():
            relayout(sim, layout)


def _free(sim: Simulation, kind: str) -> np.ndarray:
    """Empty slots of each world, (W,)."""
    empty = np.flatnonzero(sim.ids.numpy(f"{kind}_id") == EMPTY)
    world = np.searchsorted(sim.model.numpy(f"{kind}_start"), empty, "right") - 1
    return np.bincount(world, minlength=sim.model.world_count)


def _free_slots(sim: Simulation, kind: str, world: np.ndarray) -> np.ndarray:
    """The first empty slots of worlds, one for each of ``world``, (n,); those of a world ascend."""
    empty = np.flatnonzero(sim.ids.numpy(f"{kind}_id") == EMPTY)
    first = np.searchsorted(empty, sim.model.numpy(f"{kind}_start"))  # of the empty slots of each world
    order = np.argsort(world, kind="stable")
    asked = world[order]
    found = np.empty(len(world), np.int64)
    found[order] = empty[first[asked] + np.arange(len(asked)) - np.searchsorted(asked, asked)]
    return found


def _make_room(sim: Simulation, fragment: Fragment, body_world: np.ndarray) -> None:
    """Give worlds the slots that they lack, and some more; worlds of as many slots as each other stay so.

    Raises:
        OverflowError: instead, where a simulation does not grow.
    """
    model, given = sim.model, fragment.fields
    layout, grows = Layout.of(model), sim.on_overflow == "grow"
    slots = {"body": layout.bodies, "shape": layout.shapes}
    come = {"body": body_world, "shape": fragment.world["shape"]}
    for axis, there in slots.items():
        needed = there - _free(sim, axis) + np.bincount(come[axis], minlength=model.world_count)
        short = needed > there
        if short.any() and not grows:
            w = int(short.argmax())
            raise OverflowError(f"world {w} needs {needed[w]} {axis} slots, {there[w]} are there; {RESERVE}")
        if short.any():
            wanted = np.where(short, np.ceil(GROWTH * needed).astype(np.int64), there)
            slots[axis] = np.full_like(there, wanted.max()) if (there == there[0]).all() else wanted
    more = int((slots["shape"] - layout.shapes).sum())
    empty = int(model.numpy("vertex_start")[-1]) + more  # with those of empty slots, one each
    vertices = empty - len(come["shape"]) + int(given["vertex_start"][-1])
    if vertices > layout.vertices and not grows:
        raise OverflowError(f"{vertices} vertices are needed, there is room for {layout.vertices}; {RESERVE}")
    changed = slots["body"] is not layout.bodies or slots["shape"] is not layout.shapes
    layout.traits = {trait for trait in fragment.traits if not model.sizes[trait]}
    if changed or layout.traits or vertices > layout.vertices:
        layout.bodies, layout.shapes = slots["body"], slots["shape"]
        if max(vertices, empty) > layout.vertices:
            layout.vertices = max(int(np.ceil(GROWTH * vertices)), empty)
        relayout(sim, layout)


def _write(arrays: Arrays, model: Any, name: str, slots: np.ndarray, given: dict[str, np.ndarray], chosen: Any) -> None:
    """Write a field of the model at some slots; where nothing was given of a trait it is neutral."""
    if model.sizes[MODEL[name].per]:
        arrays(model, name)[slots] = given[name][chosen] if name in given else NEUTRAL.get(name, 0)


def _splice(sim: Simulation, arrays: Arrays, shapes: np.ndarray, count: np.ndarray, corners: list[np.ndarray]) -> None:
    """Give shapes other numbers of vertices, and write these; what lies behind is moved."""
    model = sim.model
    start = arrays(model, "vertex_start")
    before = start.astype(np.int64)
    order = np.argsort(shapes, kind="stable")
    changed, number = shapes[order], count[order].astype(np.int64)
    source = rows_of(np.concatenate([[0], np.cumsum(count)]), order)
    more = np.zeros(len(before), np.int64)
    more[changed + 1] = number - (before[changed + 1] - before[changed])
    moves = bool(more.any())
    after = before + np.cumsum(more) if moves else before
    for name, values in zip(("vertices", "vertex_normals"), corners, strict=True):
        array = arrays(model, name)
        if moves and len(changed) <= FEW:
            old = array.copy()
            for shape, following in zip(changed.tolist(), [*changed[1:].tolist(), len(before) - 1], strict=True):
                low, high, to = before[shape + 1], before[following], after[shape + 1]
                array[to : to + high - low] = old[low:high]
        elif moves:
            kept = np.ones(len(before) - 1, bool)
            kept[changed] = False
            rest = np.flatnonzero(kept)
            array[rows_of(after, rest)] = array[rows_of(before, rest)]
        array[rows_of(after, changed)] = values[source]
    if moves:
        start[:] = after
        sim.take_vertices(after[model.numpy("shape_start")])


def _forget_contacts(sim: Simulation, shapes: np.ndarray) -> np.ndarray:
    """Forget the contacts of some shapes, and the events of them; the bodies of the others that took part."""
    model, storage = sim.model, sim.storage
    gone = np.zeros(model.shape_count, bool)
    gone[shapes] = True
    found = storage.narrowphase
    start, first = found.contacts.numpy("contact_start"), model.numpy("shape_start")
    worlds = np.unique(np.searchsorted(first, shapes, "right") - 1)
    mask = 2**KEY_SHAPE_BITS - 1
    bodies = [np.zeros(0, np.int64)]
    arrays = Arrays()
    for group, counted in [*found.groups(), *storage.sleep.groups(), *storage.switches.groups()]:
        count = arrays(group, counted)
        slots, world = rows_of(start, worlds, count), np.repeat(worlds, count[worlds])
        key = group.numpy("key")[slots]
        sides = [
            (key >> shift & mask) + first[world] for shift in (KEY_FEATURE_BITS + KEY_SHAPE_BITS, KEY_FEATURE_BITS)
        ]
        hit = gone[sides[0]] | gone[sides[1]]
        if not hit.any():
            continue
        bodies += [model.numpy("shape_body")[side[hit & ~gone[side]]].astype(np.int64) for side in sides]
        lists = [
            (group, name)
            for name, field in group.table.items()
            if group.sizes.get(field.per) and field.per in PER_CONTACT
        ]
        if group is found.contacts:
            lists += [(storage.solver.rows, name) for name in ("slot", "square")]
        count -= np.bincount(world[hit], minlength=model.world_count).astype(count.dtype)
        left, stays = rows_of(start, worlds, count), slots[~hit]
        for owner, name in lists:
            array = arrays(owner, name)
            array[left] = array[stays]
    arrays.flush()
    storage.events.touches.forget(gone, start)
    storage.events.overlaps.forget(gone, sim.pairs.numpy("start"))
    return np.unique(np.concatenate(bodies))


def _leave(sim: Simulation, bodies: np.ndarray) -> None:
    """Count bodies that go no more among those that sleep."""
    sleepers = sim.storage.sleep.sleepers
    if sim.storage.sleep.allowed:
        arrays = Arrays()
        world = np.searchsorted(sim.model.numpy("body_start"), bodies, "right") - 1
        asleep = arrays(sleepers, "asleep")[bodies] != Rest.AWAKE
        asleep &= sim.model.numpy("body_type")[bodies] == BodyType.DYNAMIC
        np.subtract.at(arrays(sleepers, "sleeping"), world[asleep], 1)
        arrays.flush()


def _see(sim: Simulation, bodies: np.ndarray) -> None:
    """Let bodies be awake, and be seen where they are: they have not been moved."""
    sleepers = sim.storage.sleep.sleepers
    if sim.storage.sleep.allowed:
        arrays = Arrays()
        for name in ("asleep", "rest_time"):
            arrays(sleepers, name)[bodies] = 0
        for name in SEEN:
            arrays(sleepers, name)[bodies] = sim.state.numpy(name)[bodies]
        arrays.flush()


def _rouse(sim: Simulation, bodies: np.ndarray, worlds: np.ndarray) -> None:
    """Wake bodies in the next step, with all that sleeps and touches them, and look at worlds that slept as a whole."""
    if sim.storage.sleep.allowed:
        sleepers = sim.storage.sleep.sleepers
        mark(sim.model, sleepers, bodies, Rest.ROUSED)
        arrays = Arrays()
        arrays(sleepers, "dormant")[worlds] = 0
        arrays.flush()


def _are_plain(sim: Simulation, shapes: np.ndarray) -> bool:
    """Whether shapes are centred discs in a scene without traits, for which every simulation has kernels."""
    model = sim.model
    discs = not (model.numpy("shape_type")[shapes].any() or model.numpy("shape_center")[shapes].any())
    return discs and not any(model.sizes[trait] for trait in TRAITS)


def _take_up(sim: Simulation, shapes: np.ndarray, weigh: bool, plain: bool) -> None:
    """Let the next step find the pairs of shapes anew, and take the kernels that the model now needs.

    Args:
        sim: whose model has changed.
        shapes: that have come or gone.
        weigh: whether dynamic bodies have.
        plain: whether the kernels of before do for them.
    """
    arrays = Arrays()
    arrays(sim.pairs, "box")[shapes] = (np.inf, np.inf, -np.inf, -np.inf)  # which every shape has left
    if sim.pairs.sizes["kept pair"]:
        changed = np.zeros(sim.pairs.sizes["shape"], bool)
        changed[shapes] = True
        theirs = changed[sim.pairs.numpy("kept_a")] | changed[sim.pairs.numpy("kept_b")]
        arrays(sim.pairs, "kept_bound")[theirs] = -1  # nothing is kept of other shapes
    arrays.flush()
    if weigh:
        sim.storage.integrator.weigh(sim.model)
    sim.take_change(plain)
