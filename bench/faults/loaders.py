"""Loads a file of each kind, uses what it holds, and says by rules of its own what in that is wrong.

As a program it answers what became of files, in a process whose memory is limited.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.faults.common import answer
from bench.faults.originals import DT, network, trained

MEMORY = 6 * 2**30  # of a process that loads [B]: what asks for more has not looked at sizes
REFUSALS = (ValueError, TypeError, OverflowError, OSError)
STEPS = 5


def digest(arrays: Any) -> str:
    """A hash of arrays by name, whatever holds them."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        total.update(name.encode())
        total.update(np.ascontiguousarray(arrays[name]).tobytes())
    return total.hexdigest()


def not_finite(arrays: Any, but: tuple[str, ...] = ()) -> list[str]:
    """Names of the arrays that hold NaN or inf."""
    return [
        f"{name} is not finite"
        for name, values in arrays.items()
        if name not in but and np.asarray(values).dtype.kind == "f" and not np.isfinite(values).all()
    ]


def load_snapshot(path: Path) -> tuple[str, list[str]]:
    """Load a simulation and step it."""
    import dc_kernels as dc

    sim = dc.Simulation.load(path)
    wrong = wrong_in_simulation(sim)
    sim.run(STEPS, DT)
    return digest({name: sim.state.numpy(name) for name in ("position", "angle", "velocity", "time", "flags")}), wrong


def wrong_in_simulation(sim: Any) -> list[str]:
    """What no simulation may hold between two steps."""
    model, state, contacts, joints = sim.model, sim.state, sim.contacts, sim.joints
    of = {name: model.numpy(name) for name in model.table}
    wrong = not_finite(of) + not_finite({name: joints.numpy(name) for name in joints.table})
    free = np.repeat(state.numpy("flags") == 0, np.diff(of["body_start"]))
    wrong += not_finite(
        {name: state.numpy(name)[free] for name in ("position", "angle", "velocity", "angular_velocity")}
    )

    def check(what: str, good: Any) -> None:
        if not np.all(good):
            wrong.append(what)

    for name in ("mass", "inertia", "inv_mass", "inv_inertia", "shape_radius", "shape_friction", "shape_extent"):
        check(f"{name} < 0", of[name] >= 0.0)
    for name in ("length_scale", "cell_size"):
        check(f"{name} <= 0", of[name] > 0.0)
    check("shape_restitution outside [0, 1]", (of["shape_restitution"] >= 0.0) & (of["shape_restitution"] <= 1.0))
    check("body_type", np.isin(of["body_type"], [0, 1, 2]))
    check("shape_type", np.isin(of["shape_type"], [0, 1, 2]))
    fixed = of["body_type"] != 2
    check(
        "a body that nothing moves has an inverse mass", (of["inv_mass"][fixed] == 0) & (of["inv_inertia"][fixed] == 0)
    )
    check("a dynamic body without inverse mass", of["inv_mass"][~fixed] > 0)
    product = of["mass"] * of["inv_mass"]
    check("inv_mass is not that of mass", np.abs(product - 1)[of["inv_mass"] > 0] < 1e-5)
    body_world = np.repeat(np.arange(model.world_count), np.diff(of["body_start"]))
    shape_world = np.repeat(np.arange(model.world_count), np.diff(of["shape_start"]))
    check("shape_body of another world", body_world[of["shape_body"]] == shape_world)
    count = np.diff(of["vertex_start"])
    kinds = of["shape_type"]
    check(
        "vertices of a shape",
        np.where(kinds == 0, count == 1, np.where(kinds == 2, count == 4, (count > 1) & (count < 9))),
    )
    for k in np.flatnonzero((kinds == 1) & (count > 2)):
        corner = of["vertices"][of["vertex_start"][k] : of["vertex_start"][k + 1]].astype(float)
        edge = np.roll(corner, -1, axis=0) - corner
        turn = edge[:, 0] * np.roll(edge, -1, axis=0)[:, 1] - edge[:, 1] * np.roll(edge, -1, axis=0)[:, 0]
        check(f"shape {k} is not convex, counter-clockwise", turn > 0)
    wide = of["vertex_normals"].astype(float)
    length = np.hypot(*wide.T)
    check("vertex_normals are no unit vectors", (np.abs(length - 1) < 1e-3) | (length == 0))
    joint_world = np.repeat(np.arange(model.world_count), np.diff(of["joint_start"]))
    wrong += wrong_in_joints({name: joints.numpy(name) for name in joints.table})
    wrong += wrong_in_what_few_have(of) + wrong_in_lists(sim)
    for name in ("joint_body_a", "joint_body_b"):
        check(f"{name} of another world", body_world[joints.numpy(name)] == joint_world)
    check("joint of a body with itself", joints.numpy("joint_body_a") != joints.numpy("joint_body_b"))
    check("joint_length < 0", joints.numpy("joint_length") >= 0)
    check("joint_color", (joints.numpy("joint_color") >= -1) & (joints.numpy("joint_color") < 64))
    check("time", np.isfinite(state.numpy("time")) & (state.numpy("time") >= 0))
    check("flags", (state.numpy("flags") >= 0) & (state.numpy("flags") < 32))
    cache = sim.cache
    start, live = contacts.numpy("contact_start"), cache.numpy("count")
    check("contact_dt", np.isfinite(contacts.numpy("contact_dt")) & (contacts.numpy("contact_dt") >= 0))
    for w, n in enumerate(live):
        slots = slice(int(start[w]), int(start[w] + n))
        check("keys not in order", np.diff(cache.numpy("key")[slots]) > 0)
        check("keys negative", cache.numpy("key")[slots] >= 0)
        # any finite one: the next solve starts from it, and a sweep puts it on its cone
        check("impulse not finite", np.isfinite(cache.numpy("impulse")[slots]))
        check("color", (cache.numpy("color")[slots] >= -1) & (cache.numpy("color")[slots] < 64))
        check("age", cache.numpy("age")[slots] >= 0)
    return wrong


def broken(rules: dict[str, Any]) -> list[str]:
    """The rules that not all values keep."""
    return [what for what, good in rules.items() if not np.all(good)]


def wrong_in_joints(of: dict[str, np.ndarray]) -> list[str]:
    """What the numbers of no joint may be."""
    kind, parts = of["joint_kind"], of["joint_parts"]
    held = np.array([1, 2, 2, 3, 2, 2, 1, 1])[np.clip(kind, 0, 7)]
    rows = held * (parts & 1) + (parts >> 1 & 1) + (parts >> 2 & 1)
    rules = {f"{name} < 0": of[name] >= 0 for name in ("joint_strength", "joint_frequency", "joint_damping_ratio")}
    return broken(
        {
            **rules,
            "joint_kind": (kind >= 0) & (kind < 8),
            "joint_parts": (parts > 0) & (parts < 8),
            "joint_row_start": np.array_equal(of["joint_row_start"], np.concatenate([[0], np.cumsum(rows)])),
            "joint_axis is no unit vector": np.abs(np.hypot(*of["joint_axis"].T) - 1.0) < 2e-3,
            "limits": ((parts & 4) == 0) | (of["joint_lower"] <= of["joint_upper"]),
            "joint_broken": np.isin(of["joint_broken"], [0, 1]),
            "joint_collides": np.isin(of["joint_collides"], [0, 1]),
            "joint_break_force < 0": of["joint_break_force"] >= 0,
        }
    )


def wrong_in_what_few_have(of: dict[str, np.ndarray]) -> list[str]:
    """What the traits of no body and no shape may be."""
    names = ("linear_damping", "angular_damping", "shape_rolling_resistance")
    return broken(
        {
            **{f"{name} < 0": of[name] >= 0 for name in names},
            "shape_role": (of["shape_role"] >= 0) & (of["shape_role"] < 4),
        }
    )


def wrong_in_lists(sim: Any) -> list[str]:
    """What no lists of sleepers, of what touches or overlaps, and no ids may hold."""
    rules: dict[str, Any] = {}
    if sim.config.sleep:
        rules["asleep"] = np.isin(sim.sleepers.numpy("asleep"), [0, 1, 2])
        rules["rest_time"] = np.isfinite(sim.sleepers.numpy("rest_time")) & (sim.sleepers.numpy("rest_time") >= 0)
    first = sim.model.numpy("shape_start")
    for group, start in ((sim.touches, sim.contacts.numpy("contact_start")), (sim.overlaps, sim.pairs.numpy("start"))):
        for prefix in ("", "begun_", "ended_", "hit_"):
            if f"{prefix}a" not in group.table or not group.sizes["world"]:
                continue
            for w, n in enumerate(group.numpy(f"{prefix}count")):
                pairs = [group.numpy(f"{prefix}{side}")[start[w] : start[w] + n] for side in "ab"]
                rules[f"{type(group).__name__}.{prefix}, world {w}"] = all(
                    (side >= first[w]).all() and (side < first[w + 1]).all() for side in pairs
                )
    if sim.given_ids is not None:
        for kind in ("body", "shape", "joint"):
            ids = sim.ids.numpy(f"{kind}_id")
            rules[f"{kind}_id comes twice"] = len(np.unique(ids[ids >= 0])) == (ids >= 0).sum()
    return broken(rules)


def load_dataset(path: Path) -> tuple[str, list[str]]:
    """Read all states of the data set in the file's folder."""
    from pipeline.data.dataset import States

    states = States(path.parent)
    batch = states.batch(range(len(states)))
    arrays = {name: np.asarray(value) for name, value in vars(batch).items() if hasattr(value, "numpy")}
    wrong = not_finite(arrays)
    for name in ("mass", "inertia", "friction", "shape_radius", "age"):
        if name in arrays and (arrays[name] < 0).any():
            wrong.append(f"{name} < 0")
    for name in ("body_a", "body_b", "shape_body"):
        if (arrays[name] < 0).any() or (arrays[name] >= arrays["body_start"][-1]).any():
            wrong.append(f"{name} outside of the bodies")
    if (np.abs(np.hypot(*arrays["normal"].T) - 1.0) > 1e-3).any():
        wrong.append("normal is no unit vector")
    if (arrays["dt"] <= 0).any():
        wrong.append("dt <= 0")
    return digest(arrays), wrong


def load_resumed(path: Path) -> tuple[str, list[str]]:
    """Go on with the data set: the file is kept, or refused."""
    from pipeline.data.generate import finished_shards
    from pipeline.data.recipe import parse_recipe
    from pipeline.data.shards import config_of, opened

    with opened(path.parent / "shard-00000.h5") as file:
        recipe = parse_recipe(config_of(file))
    finished_shards(recipe, path.parent)
    return load_dataset(path)


def load_trajectory(path: Path) -> tuple[str, list[str]]:
    """Draw a picture of a trajectory."""
    from pipeline.plots.trajectory import animate

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "video.gif"
        animate(path, target, rate=10.0)
        return hashlib.sha256(target.read_bytes()).hexdigest(), []


def load_fclib(path: Path) -> tuple[str, list[str]]:
    """Read a contact problem, and solve it."""
    from dc_kernels import delassus
    from pipeline.fclib.files import read_fclib

    content = read_fclib(path)
    problem = content.problem
    names = ("row_start", "column", "block", "q", "mu", "bilateral")
    arrays = {name: np.asarray(getattr(problem, name)) for name in names}
    arrays |= {f"guess {k}": guess for k, guess in enumerate(content.guesses)}
    if content.solution is not None:
        arrays["solution"] = content.solution
    wrong = not_finite(arrays) + ["mu < 0"] * bool((arrays["mu"] < 0).any())
    delassus.solve(problem, max_sweeps=100)
    return digest(arrays), wrong


def load_network(path: Path) -> tuple[str, list[str]]:
    """Load a network and ask it for an answer."""
    import torch

    from pipeline.networks.checkpoint import load_checkpoint

    model, manifest = load_checkpoint(path)
    weights = {name: tensor.numpy() for name, tensor in model.state_dict().items()}
    with torch.no_grad():
        config = model.config
        made = model(torch.ones(1, config.channels, config.rows, config.columns)).numpy()
    wrong = not_finite(weights) + not_finite({"answer": made})
    return digest({**weights, "made": made, "manifest": np.frombuffer(json.dumps(manifest).encode(), np.uint8)}), wrong


def load_training_state(path: Path) -> tuple[str, list[str]]:
    """Put a training back to where it was."""
    from pipeline.networks.checkpoint import load_training

    model = network()
    optimizer = trained(model)
    progress, _ = load_training(path, model, optimizer, None, {"seed": 3})
    weights = {name: tensor.numpy() for name, tensor in model.state_dict().items()}
    moments = {
        f"{index}/{name}": np.asarray(value)
        for index, state in optimizer.state_dict()["state"].items()
        for name, value in state.items()
    }
    text = np.frombuffer(json.dumps([progress, optimizer.state_dict()["param_groups"]]).encode(), np.uint8)
    return digest({**weights, **moments, "text": text}), not_finite({**weights, **moments})


def load_toml(path: Path) -> tuple[str, list[str]]:
    """Read a recipe."""
    from pipeline.data.recipe import load_recipe

    config = load_recipe(path).config()
    text = json.dumps(config)
    # a tolerance may be infinite: the other one then decides alone
    others = {name: value for name, value in config["solver"].items() if "tolerance" not in name}
    wrong = [word for word in ("NaN", "Infinity") if word in json.dumps({**config, "solver": others})]
    return hashlib.sha256(text.encode()).hexdigest(), wrong


def load_in_solve(path: Path) -> tuple[str, list[str]]:
    """Solve steps with a network in the loop."""
    from pipeline.starts.registry import maker

    return stepped(maker(str(path)))


def load_stepper(path: Path) -> tuple[str, list[str]]:
    """Take steps by a network in the solver's place."""
    from pipeline.stepper.choice import StepperOptions
    from pipeline.stepper.registry import stepper_maker

    return stepped(stepper_maker(StepperOptions(stepper="network", weights=path)))


def stepped(make: Callable[[Any], Any]) -> tuple[str, list[str]]:
    """The state of a pile after some steps with what is made for it, and what is wrong in that."""
    import dc_kernels as dc

    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 6), (0, 0), (6, 0), (6, 6)])
    builder.add_discs([(1.0 + i % 4, 0.5 + i // 4) for i in range(12)], 0.5)
    sim = dc.Simulation(*builder.finalize())
    made = make(sim)
    for _ in range(STEPS):
        sim.collide(DT)
        made.solve()
        sim.advance()
    found = {name: sim.state.numpy(name) for name in ("position", "angle", "velocity", "time", "flags")}
    return digest(found), not_finite(found)


LOADERS: dict[str, Callable[[Path], tuple[str, list[str]]]] = {
    "snapshot": load_snapshot,
    "populated snapshot": load_snapshot,
    "shard": load_dataset,
    "resumed shard": load_resumed,
    "index": load_dataset,
    "trajectory": load_trajectory,
    "fclib": load_fclib,
    "checkpoint": load_network,
    "training": load_training_state,
    "contactnet": load_in_solve,
    "stepper": load_stepper,
    "toml": load_toml,
}


def load(question: dict[str, str]) -> dict[str, Any]:
    """Load a file, and say how that went."""
    try:
        found, wrong = LOADERS[question["kind"]](Path(question["path"]))
    except REFUSALS as error:
        path = Path(question["path"])
        named = path.name in str(error) or str(path.parent) in str(error)
        return {"refused": f"{type(error).__name__}: {error}"[:300], "clear": named}
    except BaseException as error:
        return {"refused": f"{type(error).__name__}: {error}"[:300], "clear": False}
    return {"digest": found, "wrong": wrong}


if __name__ == "__main__":
    import torch  # what is loaded before the limit does not count

    from pipeline.data import dataset, generate  # noqa: F401
    from pipeline.networks import checkpoint  # noqa: F401
    from pipeline.plots import trajectory  # noqa: F401

    torch.set_num_threads(1)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    answer(load)
    sys.exit(0)
