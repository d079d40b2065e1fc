"""Description of what runs for a scene, what is skipped, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dc_kernels.events.lists import roles_of
from dc_kernels.measure import are_off, contact_slots
from dc_kernels.model.enums import BodyType, ShapeRole, ShapeType, flag_names
from dc_kernels.model.room import world_of
from dc_kernels.model.settings import counted
from dc_kernels.solve.rows import LANES, SERIAL_COLOR, has_traits
from dc_kernels.stages import PHASES, of_phase

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

SHOWN = 8  # stopped worlds that one line names


def explain(sim: Simulation) -> str:
    """Return lines of "stage: what runs or is skipped (why)" for the present simulation."""
    model, config = sim.model, sim.config
    body_type, shape_type = (_filled(sim, name) for name in ("body_type", "shape_type"))
    friction = bool(model.numpy("shape_friction").any())
    bounce = bool(model.numpy("shape_restitution").any())
    kinds = ", ".join(
        counted(int((body_type == kind).sum()), f"{kind.name.lower()} body")
        for kind in BodyType
        if (body_type == kind).any()
    )
    capsule = (shape_type == ShapeType.POLYGON) & (np.diff(model.numpy("vertex_start")) == 2)
    found = {kind.name.lower(): (shape_type == kind) & ~capsule for kind in ShapeType} | {"capsule": capsule}
    shapes = ", ".join(counted(int(of_kind.sum()), name) for name, of_kind in found.items() if of_kind.any())
    lines = [
        f"scene: {counted(model.world_count, 'world')}, {kinds or 'no bodies'}; {shapes or 'no shapes'}; "
        f"{counted(model.joint_count, 'joint')}",
        f"backend: {sim.backend} on {sim.device}, {sim.dtype.name}, {counted(sim.threads, 'thread')} over worlds"
        f"{' and within them' if sim.threads > model.world_count else ''}, schedule {sim.schedule!r}",
        f"broadphase: pairs are kept while no shape leaves a margin of {config.margin:g} length scales "
        f"(rebuilt {int(sim.pairs.numpy('rebuilds').sum())} times so far)",
    ]
    if sim.only_discs and sim.specialize:
        lines.append(
            "narrowphase: discs only; hulls, clipping and rotations skipped (all moving shapes are centred discs)"
        )
    else:
        lines.append("narrowphase: all shapes")
    if sim.variant == "discs":
        lines.append("rows: discs; the normal arm is skipped (it is zero)")
    elif sim.variant == "general":
        why = "requested by specialize=False" if sim.only_discs else "not all moving shapes are centred discs"
        lines.append(f"rows: general ({why}); joint rows skipped (no joints)")
    elif sim.variant == "surfaces":
        lines.append("rows: contacts, joints and rolling resistance together (moving surfaces or rolling resistance)")
    else:
        kinds = "rods" if sim.variant == "joints" else "joints of several kinds, as general rows"
        lines.append(f"rows: contacts and joints together ({kinds})")
    if has_traits(model):
        lines.append("bodies: some have damping or a gravity scale")
    if sensors := int((roles_of(model) == ShapeRole.SENSOR).sum()):
        now = counted(int(sim.overlaps.numpy("count").sum()), "overlap")
        lines.append(f"sensors: {counted(sensors, 'shape')}, removed from the candidate pairs; {now} at the last step")
    if ways := int(np.isin(roles_of(model), (ShapeRole.ONE_WAY, ShapeRole.ONE_SIDED)).sum()):
        slots, _ = contact_slots(sim.contacts)
        off = counted(int(are_off(sim.contacts, slots).sum()), "contact")
        lines.append(f"one-way: {counted(ways, 'one-sided shape')}; {off} inactive in the last step")
    if config.contact_events:
        now = counted(int(sim.touches.numpy("count").sum()), "pair")
        lines.append(
            f"contact events: {now} of shapes touch; a hit is an approach faster than {config.hit_speed:g} m/s"
        )
    if not friction:
        lines.append("friction: all coefficients are 0; tangential impulses stay zero")
    if not bounce:
        lines.append("restitution: all coefficients are 0; impact biases are skipped")
    if config.soft:
        lines.append(f"solver: {config.substeps} substeps with soft contacts, each with a relaxing sweep")
    elif config.method == "jacobi":
        lines.append("solver: Jacobi with mass splitting, scalar rows")
    elif sim.schedule == "world" and sim.device == "cpu" and sim.backend == "warp":
        lines.append(f"solver: PGS in colour order, {LANES} rows side by side in SIMD lanes")
    else:
        lines.append("solver: PGS in colour order, scalar rows")
    chosen = (config.corrects_positions, config.sleep, sim.added_kernels, config.soft)
    stages = [name for phase in PHASES for name in of_phase(phase, *chosen)]
    if "wake_touched" in stages:
        stages[stages.index("wake_touched") + 1] += " (again, where a sleeper was touched)"
    lines.append(f"stages of a step: {', '.join(stages)}")
    stop, tolerance, relative = config.ends_at
    light = f" and {relative:g} of what a typical weight gives in a step" * (stop != "residual")
    ends = f"stop at {'residual' if stop == 'residual' else 'change'} < {tolerance:g}{light}"
    if stop == "motion":
        ends += f", or where a sweep moves few contacts by more than {config.motion_tolerance:g} slops a step"
        ends += f", or {config.motion_mean:g} of what contacts gave all bodies in the mean" * (config.motion_mean > 0)
    least = min(config.min_sweeps, config.max_sweeps)
    if not config.soft:
        lines.append(
            f"acceleration: {config.acceleration}; {ends}, after at least "
            f"{least} sweeps, or at {config.max_sweeps} sweeps; a world without rows is not swept"
        )
    if config.corrects_positions:
        deep = sim.rows.numpy("deepest") < -config.slop * model.numpy("length_scale")
        overlapping = f"in {counted(int(deep.sum()), 'world')} at the last step"
        run = "always, for the joints" if model.joint_count else overlapping
        lines.append(f"position correction: a separate phase where an overlap exceeds the slop ({run})")
    elif not config.soft:
        lines.append(f"position correction: {config.position_correction}; the position phase is skipped")
    serial = int((sim.contacts.numpy("color") == SERIAL_COLOR).sum())
    if serial:
        lines.append(f"serial colour: {counted(serial, 'contact')} swept one by one (a body has more than 63)")
    if config.sleep:
        dormant = sim.sleepers.numpy("dormant")
        asleep = sim.asleep
        worlds = np.unique(world_of(model.numpy("body_start"))[asleep])
        lines.append(
            f"sleep: {int(asleep.sum())} of {counted(int((body_type == BodyType.DYNAMIC).sum()), 'dynamic body')} "
            f"asleep, in {counted(len(worlds), 'world')}, of which {int(dormant.sum())} skipped whole"
        )
    else:
        lines.append("sleep: no body falls asleep (SolverConfig.sleep is off)")
    if not config.history:
        lines.append("history of sweeps: not kept")
    lines += [f"world {w}: stopped ({why})" for w, why in _stopped(sim)]
    return "\n".join(lines)


def _filled(sim: Simulation, name: str) -> np.ndarray:
    """Return a field of the model, -1 in place of what empty slots hold."""
    values, axis = sim.model.numpy(name), sim.model.table[name].axes[0]
    if sim.given_ids is None:
        return values
    return np.where(sim.given_ids.numpy(f"{axis}_id") < 0, -1, values)


def describe(sim: Simulation) -> str:
    """Return one line with the size of a simulation and the worlds that have stopped."""
    model, stopped = sim.model, _stopped(sim)
    there, slots = model.body_count, ""
    if sim.given_ids is not None:
        there = int((sim.given_ids.numpy("body_id") >= 0).sum())
        slots = f" in {counted(model.body_count, 'slot')}" * (there < model.body_count)
    line = f"<Simulation of {counted(model.world_count, 'world')} and {counted(there, 'body')}{slots}"
    line += f", {sim.dtype}, {sim.backend} on {sim.device}"
    if stopped:
        more = f" and {len(stopped) - SHOWN} more" * (len(stopped) > SHOWN)
        line += f"; stopped: {', '.join(f'world {w} ({why})' for w, why in stopped[:SHOWN])}{more}"
    return line + ">"


def _stopped(sim: Simulation) -> list[tuple[int, str]]:
    """Return the worlds that have stopped, and the names of their flags."""
    flags = sim.state.numpy("flags")
    return [(int(w), flag_names(flags[w])) for w in np.flatnonzero(flags)]
