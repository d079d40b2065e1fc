"""A data set against the laws that its file states, in float64 from the file alone: no code of the project reads it."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.data.generate import generate
from pipeline.data.recipe import GenerateOptions, Recipe
from pipeline.scenes import SCENES, Mixed, Scene, Thesis
from pipeline.scenes.base import parameter_docs

h5py = pytest.importorskip("h5py")

UNIT = re.compile(r"1|rad|m|s|kg|N|J|(rad|m|s|kg|N|J)(\^2)?( (m|s)(\^2)?)*(/(s|m)(\^2)?)?")
RECIPES = {
    "discs": Recipe(scene=Thesis(bodies=30), options=GenerateOptions(worlds=3, steps=90, dt=0.02, shard_worlds=2)),
    "bouncing": Recipe(
        scene=Mixed(bodies=12, restitution=0.4),
        options=GenerateOptions(
            worlds=4, steps=70, shard_worlds=2, ranges=(("radius", 0.3, 0.6), ("dt", 0.01, 0.02), ("bodies", 8, 12))
        ),
    ),
    "baumgarte": Recipe(
        scene=Mixed(bodies=9),
        options=GenerateOptions(worlds=2, steps=70, dt=0.02, grids=True, grid_size=(6.0, 6.0), grid_spacing=0.5),
        solver=dc.SolverConfig(min_sweeps=1, position_correction="baumgarte"),
    ),
}


@pytest.fixture(scope="module", params=RECIPES)
def file(request, tmp_path_factory):
    """The index of a small data set, open."""
    folder = tmp_path_factory.mktemp(request.param)
    generate(RECIPES[request.param], folder, threads=1, progress=False)
    with h5py.File(folder / "index.h5") as opened:
        yield opened


def datasets(file) -> dict:
    """All datasets by path."""
    found: dict = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    return found


class Flat:
    """All states of a file at once, in float64: of each contact its state, its bodies' rows in motion."""

    def __init__(self, file) -> None:
        self.arrays = {name: data[...] for name, data in datasets(file).items()}
        self.config = json.loads(file.attrs["config"])
        self.world = np.repeat(np.arange(len(self["world/seed"])), np.diff(self["world/step_start"]))  # of each state
        self.motion_start, self.contact_start = self["step/motion_start"], self["step/contact_start"]
        self.state = np.repeat(np.arange(len(self.world)), np.diff(self.contact_start))  # of each contact
        self.body_state = np.repeat(np.arange(len(self.world)), np.diff(self.motion_start))  # of each row of motion
        within = np.arange(len(self.body_state)) - self.motion_start[self.body_state]
        self.body = self["world/body_start"][self.world[self.body_state]] + within  # its row in body
        self.a = self.motion_start[self.state] + self["contact/body_a"]
        self.b = self.motion_start[self.state] + self["contact/body_b"]
        dynamic = self["body/body_type"] == json.loads(file["body/body_type"].attrs["codes"])["DYNAMIC"]
        self.inverse = np.stack([inverted(self["body/mass"], dynamic), inverted(self["body/inertia"], dynamic)], 1)
        self.inverse = self.inverse[self.body]
        self.dt = self["world/dt"].astype(float)[self.world]  # of each state
        normal = self["contact/normal"].astype(float)
        self.axes = np.stack([normal, np.stack([normal[:, 1], -normal[:, 0]], 1)], 1)  # (contacts, n or t, 2)
        point, position = self["contact/point"].astype(float), self["motion/position"].astype(float)
        self.arms = [point - position[side] for side in (self.a, self.b)]
        self.before = np.concatenate([self["motion/velocity"], self["motion/angular_velocity"][:, None]], 1).astype(
            float
        )
        self.predicted = self.before.copy()
        gravity = self["world/gravity"].astype(float)[self.world[self.body_state]]
        self.predicted[:, :2] += np.where(dynamic[self.body, None], self.dt[self.body_state, None] * gravity, 0.0)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    def relative(self, velocity: np.ndarray) -> np.ndarray:
        """Velocity of B against A at each contact, along normal and tangent."""
        at = [
            velocity[side, :2] + velocity[side, 2:] * np.stack([-arm[:, 1], arm[:, 0]], 1)
            for side, arm in zip((self.a, self.b), self.arms)
        ]
        return np.einsum("cki,ci->ck", self.axes, at[1] - at[0])

    def moved(self, impulse: np.ndarray) -> np.ndarray:
        """Velocities that impulses (contacts, 2) leave."""
        velocity = self.predicted.copy()
        push = np.einsum("ck,cki->ci", impulse, self.axes)
        for side, arm, sign in ((self.a, self.arms[0], -1.0), (self.b, self.arms[1], 1.0)):
            turn = arm[:, 0] * push[:, 1] - arm[:, 1] * push[:, 0]
            both = np.stack([push[:, 0], push[:, 1], turn], 1)
            np.add.at(velocity, side, sign * both * self.inverse[side][:, [0, 0, 1]])
        return velocity

    def natural_map(self, stage: int) -> np.ndarray:
        """What each contact lacks of the law, in impulses of its own effective mass, (contacts, 2) [N s]."""
        impulse = self["contact/impulse"][stage].astype(float)
        speed = self.relative(self.moved(impulse))
        speed[:, 0] += self["contact/bias"]
        inverse = np.zeros_like(speed)
        for side, arm in zip((self.a, self.b), self.arms):
            lever = arm[:, None, 0] * self.axes[..., 1] - arm[:, None, 1] * self.axes[..., 0]
            inverse += self.inverse[side, :1] + self.inverse[side, 1:] * lever**2
        wanted = impulse - speed / inverse
        limit = self["contact/friction"] * np.maximum(impulse[:, 0], 0.0)
        projected = np.stack([np.maximum(wanted[:, 0], 0.0), np.clip(wanted[:, 1], -limit, limit)], 1)
        return impulse - projected


def inverted(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """1 / values where they count and are not 0, else 0."""
    with np.errstate(divide="ignore"):
        return np.where(counts & (values > 0.0), 1.0 / values.astype(float), 0.0)


@pytest.fixture(scope="module")
def flat(file) -> Flat:
    return Flat(file)


def test_every_dataset_has_a_unit_of_its_own_and_a_meaning(file):
    for name, data in datasets(file).items():
        for unit in data.attrs["unit"].split(", "):
            assert UNIT.fullmatch(unit), (name, unit)
        assert len(data.attrs["meaning"]) > 5, name
    units = {"motion/velocity": "m/s", "end/angle": "rad", "contact/impulse": "N s", "body/mass": "kg"}
    assert {name: file[name].attrs["unit"] for name in units} == units
    if "drawn" in file:
        assert {name: data.attrs["unit"] for name, data in file["drawn"].items()} == {
            "bodies": "1",
            "dt": "s",
            "radius": "m",
        }
        assert "Radius of the largest body" in file["drawn/radius"].attrs["meaning"]
    if "grid" in file:
        given = file["grid/input"].attrs
        assert dict(zip(given["channels"], given["units"], strict=True)) == {
            "mass": "kg",
            "velocity_x": "m/s",
            "velocity_y": "m/s",
            "omega": "rad/s",
            "normal_x": "1",
            "normal_y": "1",
        }
        assert file["grid/label"].attrs["unit"] == "N s"


@pytest.mark.parametrize(
    ("name", "enumeration"),
    [("body/body_type", dc.BodyType), ("shape/shape_type", dc.ShapeType), ("step/flags", dc.Flag)],
)
def test_codes_stand_beside_the_values(file, name, enumeration):
    codes = json.loads(file[name].attrs["codes"])
    assert codes == {member.name: member.value for member in enumeration.__members__.values()}
    assert set(np.unique(file[name][...]).tolist()) <= set(codes.values())


def test_offsets_lead_to_the_rows(file, flat):
    rows = {
        "world/body_start": "body/mass",
        "world/shape_start": "shape/shape_body",
        "world/step_start": "step/step",
        "shape/vertex_start": "vertex/vertices",
        "step/motion_start": "motion/angle",
        "step/contact_start": "contact/gap",
    }
    for start, of in rows.items():
        assert flat[start][0] == 0 and flat[start][-1] == len(flat[of]) and (np.diff(flat[start]) >= 0).all(), start
    assert len(flat["end/angle"]) == len(flat["body/mass"])
    assert (np.diff(flat["world/seed"]) == 1).all()


def test_a_state_follows_from_the_one_before_and_the_end_from_the_last(file, flat):
    """To the round-off of float32, position correction included; the last state leads to ``end``."""
    assert "position_correction" in file["motion/position"].attrs["law"]
    ends = np.isin(flat.body_state, flat["world/step_start"][1:] - 1)
    count = np.diff(flat.motion_start)[flat.body_state]  # rows of motion to the same body in the next state
    successor = np.arange(len(flat.body_state)) + count
    assert ends.any()
    for name, rate in (("position", "velocity"), ("angle", "angular_velocity")):
        here, speed = flat[f"motion/{name}"].astype(float), flat[f"motion/{rate}"].astype(float)
        at = np.minimum(successor, len(here) - 1)
        following, after = here[at], speed[at]
        following[ends], after[ends] = flat[f"end/{name}"][flat.body[ends]], flat[f"end/{rate}"][flat.body[ends]]
        dt = flat.dt[flat.body_state].reshape(-1, *(1,) * (here.ndim - 1))
        way = dt * after + flat[f"motion/{name}_correction"]
        error = np.abs(following - here - way)
        assert (error <= 2e-7 * (np.abs(here) + np.abs(way)) + 1e-9).all(), float(error.max())
        assert np.abs(way).max() > 0.01


def test_positions_are_corrected_where_overlap_exceeds_the_slop(flat):
    slop = flat["world/slop"][flat.world]
    deep = np.zeros(len(flat.world), bool)
    np.logical_or.at(deep, flat.state, flat["contact/gap"] < -slop[flat.state])
    correction = np.abs(flat["motion/position_correction"]).max(axis=1) + np.abs(flat["motion/angle_correction"])
    moved = np.zeros(len(flat.world))
    np.maximum.at(moved, flat.body_state, correction)
    if flat.config["solver"]["position_correction"] == "baumgarte":
        deep[:] = False
    assert (moved[~deep] == 0.0).all()  # where it is deep the velocities may have mended it within the step
    assert not deep.any() or (moved[deep] > 0.0).mean() > 0.5
    assert deep.any() == (flat.config["scene"]["name"] == "mixed" and "baumgarte" not in str(flat.config["solver"]))


def test_the_impulse_leads_to_the_next_velocities(flat):
    velocity = flat.moved(flat["contact/impulse"][1].astype(float))
    ends = np.isin(flat.body_state, flat["world/step_start"][1:] - 1)
    successor = np.minimum(np.arange(len(velocity)) + np.diff(flat.motion_start)[flat.body_state], len(velocity) - 1)
    after = flat.before[successor]
    of_end = np.concatenate([flat["end/velocity"], flat["end/angular_velocity"][:, None]], 1)
    after[ends] = of_end[flat.body[ends]]
    # places are rounded to float32: an arm that is off by 5e-7 m turns a body of 0.1 kg m^2 by so much
    np.testing.assert_allclose(after, velocity, rtol=1e-5, atol=1e-4)


def test_the_bias_is_that_of_its_law(file, flat):
    assert "gap / dt" in file["contact/bias"].attrs["law"]
    solver = flat.config["solver"]
    world = flat.world[flat.state]
    slop, threshold = (flat[f"world/{name}"].astype(float)[world] for name in ("slop", "restitution_threshold"))
    np.testing.assert_allclose(flat["world/slop"], solver["slop"] * flat["world/length_scale"], rtol=1e-6)
    gap, e, dt = flat["contact/gap"].astype(float), flat["contact/restitution"].astype(float), flat.dt[flat.state]
    before, closing = flat.relative(flat.before)[:, 0], flat.relative(flat.predicted)[:, 0]
    bias = np.where(gap > slop, gap / dt, 0.0)
    if solver["position_correction"] == "baumgarte":
        most = solver["max_correction"] * flat["world/length_scale"].astype(float)[world]
        bias = np.where(gap < -slop, np.maximum(solver["position_factor"] * (gap + slop), -most) / dt, bias)
    bounced = np.where(
        before > 0.0,
        np.maximum(bias, e * before),
        np.where(before < -threshold * (e < 1.0), np.minimum(bias, e * before), bias),
    )
    bounced = np.where((gap > slop) & (gap + dt * closing >= 0.0), 1e6 * gap / dt, bounced)
    bias = np.where(e > 0.0, bounced, bias)
    # where a speed is within round-off of a limit of the law, either side of it is right
    near = (e > 0.0) & ((np.abs(before + threshold) < 1e-5) | (np.abs(gap + dt * closing) < 1e-6))
    np.testing.assert_allclose(flat["contact/bias"][~near], bias[~near], rtol=1e-4, atol=2e-5)
    assert near.mean() < 0.01 and len(np.unique(bias)) > 20


def test_labels_satisfy_the_law(file, flat):
    assert "u_n + bias" in file["contact/impulse"].attrs["law"] and flat.config["label_tolerance"] == 1e-5
    assert list(file["contact/impulse"].attrs["stages"]) == ["start", "impulse", "label"]
    impulse = flat["contact/impulse"].astype(float)
    cone = np.abs(impulse[..., 1]) - flat["contact/friction"] * impulse[..., 0]
    assert impulse[1:, :, 0].min() >= 0.0 and cone[1:].max() < 1e-6 * impulse.max()
    reached = flat["step/label_reached"][flat.state] == 1
    assert reached.mean() > 0.95
    lacking = {stage: np.abs(flat.natural_map(stage)).max(axis=1) for stage in (1, 2)}
    label = lacking[2][reached]
    # the last sweep changed no impulse by more than the tolerance, but those after a contact's own changed its speed
    assert np.quantile(label, 0.999) < 2e-5 and label.max() < 1e-4
    assert lacking[1].mean() > 2.0 * label.mean()


def test_a_start_is_the_impulse_of_the_step_before(flat):
    key, age, impulse = flat["contact/key"], flat["contact/age"], flat["contact/impulse"]
    checked = 0
    for state in range(1, len(flat.world)):
        if flat.world[state] != flat.world[state - 1]:
            continue
        old, new = (slice(*flat.contact_start[s : s + 2]) for s in (state - 1, state))
        assert (np.diff(key[new]) > 0).all()
        place = np.searchsorted(key[old], key[new])
        known = np.zeros(len(place), bool)
        inside = place < len(key[old])
        known[inside] = key[old][place[inside]] == key[new][inside]
        np.testing.assert_array_equal(age[new] > 0, known)
        wanted = np.zeros((len(known), 2), np.float32)
        wanted[known] = impulse[1, old][place[known]]
        np.testing.assert_array_equal(impulse[0, new], wanted)
        checked += int(known.sum())
    assert checked > 200


@pytest.mark.parametrize("name", SCENES)
def test_every_parameter_of_a_scene_has_a_unit(name):
    docs = parameter_docs(SCENES[name])
    numbers = [field.name for field in dataclasses.fields(SCENES[name]) if isinstance(field.default, int | float)]
    assert {"friction", "gravity"} <= set(numbers) <= set(docs)
    for field in numbers:
        meaning, unit = docs[field]
        assert unit != "not stated" and len(meaning) > 5, field


def test_a_parameter_without_a_unit_is_called_so():
    made = dataclasses.make_dataclass("Made", [("size", float, 1.0)], bases=(Scene,), frozen=True, kw_only=True)
    docs = parameter_docs(made)
    assert docs["size"][1] == "not stated"
    assert docs["gravity"] == ("Downward acceleration", "m/s^2")
