"""The bench of games: its scenes, the bodies that engines get, and the protocol that a peer program speaks."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import dc_kernels as dc
from bench import __main__ as command
from bench.cases import DT
from bench.games import games, program, rows
from bench.games.engines import Foreign, Handed, Ours
from bench.peers.gauge import Gauge
from pipeline import scenes

FALLING = """
import sys
bodies, now = [], []
for line in sys.stdin:
    word, *rest = line.split()
    if word == "name":
        print("name falling bodies")
    elif word == "clear":
        bodies.clear()
    elif word == "world":
        gravity = float(rest[1])
    elif word == "body":
        bodies.append([rest[0] == "dynamic", *map(float, rest[1:7]), gravity])
    elif word == "build":
        now = [list(body) for body in bodies]
        print("built 0.25")
    elif word == "step":
        for body in now:
            for _ in range(int(rest[0])):
                if body[0]:
                    body[5] += body[7] * float(rest[1])
                    body[2] += body[5] * float(rest[1])
        print("stepped 0.5 fall 0.1 rest 0.3")
    elif word == "poses":
        print("poses", len(now))
        for body in now:
            print(*body[1:7])
    elif word == "quit":
        break
    elif word == "error":
        print("error no joints")
    sys.stdout.flush()
"""
"""A peer in which nothing meets."""


@pytest.fixture
def falling(tmp_path):
    path = tmp_path / "falling.py"
    path.write_text(FALLING)
    peer = program.Program([sys.executable, str(path)])
    yield peer
    peer.close()
    assert peer.process.returncode == 0


def free_fall() -> Handed:
    """Two worlds, each with a floor and a disc that is handed over as it rises."""
    builder = dc.ModelBuilder()
    for height in (5.0, 6.0):
        builder.add_world(gravity=(0.0, -9.8))
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(-5.0, 0.0), (5.0, 0.0)])
        builder.add_disc(builder.add_body((1.0, height)), 0.5)
    velocity = np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 0.0], [0.0, 3.0]])
    return Handed(builder, {"velocity": velocity})


def test_a_program_gets_the_bodies_and_returns_their_places(falling):
    handed = free_fall()
    peer, ours = Foreign(falling, handed), Ours(handed, dc.SolverConfig())
    assert falling.name == "falling bodies"
    assert peer.run(20) == 0.5
    ours.run(20)
    for theirs, own in zip(peer.places(), ours.places(), strict=True):
        np.testing.assert_allclose(theirs, own, atol=1e-5)
    assert ours.places()[0][1, 1] > 5.1  # it was handed over as it rose
    assert peer.shares(10) == pytest.approx({"fall": 0.25, "rest": 0.75})
    assert peer.restart() == 0.25
    ours.restart()
    for engine in (peer, ours):
        np.testing.assert_allclose(engine.places()[0][[1, 3], 1], [5.0, 6.0])


def test_another_answer_than_the_protocol_has_is_an_error(falling):
    handed = free_fall()
    with pytest.raises(RuntimeError, match=r"answered 'error 0 1' with 'error no joints'; it must be 'built ...'"):
        falling.ask("error 0 1", "built")
    with pytest.raises(RuntimeError, match="its end"):
        program.Program([sys.executable, "-c", "pass"])
    handed.groups[1].assign("force", np.ones((4, 2)))
    with pytest.raises(ValueError, match="force and torque must be 0"):
        list(program.lines_of(*handed.groups))


def test_lines_tell_all_of_a_scene():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.5, -9.8))
    fixed = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(fixed, [(-5.0, 0.0), (0.0, 0.0), (5.0, 0.0)], friction=0.25)
    drum = builder.add_body(angular_velocity=0.5, type=dc.BodyType.KINEMATIC)
    builder.add_box(drum, 1.0, 0.5, friction=0.25)
    body = builder.add_body((0.0, 3.0), angle=0.125, velocity=(1.0, 2.0))
    builder.add_capsule(body, (-0.5, 0.0), (0.5, 0.0), 0.25, friction=0.25, restitution=0.5, density=2.0, category=4)
    builder.add_distance_joint(fixed, body, (0.0, 5.0))
    groups = builder.finalize("float64")
    mass, inertia = (f"{groups[0].numpy(name)[2]:.9g}" for name in ("mass", "inertia"))
    every = 0xFFFFFFFF
    assert [line.rstrip("\n") for line in program.lines_of(*groups)] == [
        "world 0.5 -9.8",
        "body static 0 0 0 0 0 0 0 0",
        f"segment 0.25 0 1 {every} 0 -5 0 0 0",
        f"segment 0.25 0 1 {every} 0 0 0 5 0",
        "body kinematic 0 0 0 0 0 0.5 0 0",
        f"polygon 0.25 0 1 {every} 0 -1 -0.5 1 -0.5 1 0.5 -1 0.5",
        f"body dynamic 0 3 0.125 1 2 0 {mass} {inertia}",
        f"capsule 0.25 0.5 4 {every} 0.25 -0.5 0 0.5 0",
        "rod 0 2 1 0 5 0 0 2",
    ]


def test_lines_tell_all_of_joints():
    builder = dc.ModelBuilder()
    builder.add_world()
    post, box = builder.add_body(type=dc.BodyType.STATIC), builder.add_body((0.0, 2.0), angle=0.5)
    builder.add_box(box, 0.5, 0.5)
    ends = {"anchor_a": (0.25, 0.0), "anchor_b": (0.0, -2.0)}
    motor = {"motor_speed": 3.0, "max_motor_torque": 0.0}
    builder.add_distance_joint(post, box, **ends, length=1.5, frequency=2.0, damping_ratio=0.5, upper=2.5)
    builder.add_rope_joint(post, box, **ends, max_length=4.0, min_length=1.0)
    builder.add_revolute_joint(post, box, **ends, lower=-0.25, **motor)
    builder.add_prismatic_joint(post, box, (2.0, 0.0), **ends, reference_angle=0.25, collide_connected=True)
    builder.add_weld_joint(post, box, **ends, frequency=4.0)
    builder.add_wheel_joint(post, box, **ends, upper=0.5, **motor)
    broken = builder.add_weld_joint(post, box)
    groups = builder.finalize("float64")
    groups[2].numpy("joint_broken")[broken] = 1
    lines = [line.rstrip("\n") for line in program.lines_of(*groups)]
    at = "0.25 0 0 -2"
    assert lines[-6:] == [
        f"spring 0 1 1 {at} 1.5 2 0.5 0 2.5",
        f"rope 0 1 1 {at} 1 4",
        f"hinge 0 1 0 {at} 0.5 -0.25 1e+30 3 0",
        f"slider 0 1 1 {at} 1 0 0.25 -1e+30 1e+30 0 -1",
        f"weld 0 1 0 {at} 0.5 4 0",
        f"wheel 0 1 0 {at} 0 1 2 0.7 -1e+30 0.5 3 0",
    ]


def test_the_gauge_measures_how_far_joints_have_come_apart():
    builder = dc.ModelBuilder()
    builder.add_world()
    post, box = builder.add_body(type=dc.BodyType.STATIC), builder.add_body((0.0, 2.0))
    builder.add_box(box, 0.5, 0.5)
    builder.add_distance_joint(post, box, (0.0, 0.0), (1.0, 0.0), length=0.0, frequency=1.0)  # gives way
    builder.add_distance_joint(post, box, length=2.5)
    builder.add_rope_joint(post, box, max_length=1.75)
    builder.add_rope_joint(post, box, max_length=2.0)
    builder.add_revolute_joint(post, box, (0.0, 2.0), (1.0, 0.0))
    builder.add_wheel_joint(post, box, (0.6, 0.8), (0.0, 2.0), (1.0, 0.0))
    gauge = Gauge(*builder.finalize("float64"))
    position, angle = np.array([[0.0, 0.0], [0.0, 2.0]]), np.array([0.0, np.pi / 2])
    apart = gauge.separations(position, angle)  # the point of the box at (1, 0) is now at (0, 3)
    np.testing.assert_allclose(apart, [0.5, 0.25, 0.0, 1.0, 0.6])


def test_the_gauge_looks_at_the_worlds_that_an_engine_has():
    scene = scenes.Stack(bodies=2, jitter=0.0)
    model, state, joints = scene.build(2).finalize(dtype="float64")
    gauge = Gauge(model, state, joints)
    position, angle = (np.array(state.numpy(name)) for name in ("position", "angle"))
    assert len(gauge.overlaps(position, angle)) == 8  # two contact points of each of two boxes
    position[:3, 1] -= [0.0, 0.01, 0.01]
    sunk = gauge.overlaps(position[:3], angle[:3])
    np.testing.assert_allclose(np.sort(sunk), [0.0, 0.0, 0.01, 0.01], atol=1e-9)


def test_a_scene_is_measured(monkeypatch, falling, tmp_path):
    monkeypatch.setattr(rows, "FOLDER", tmp_path)
    small = {
        "rest": rows.Row("", scenes.Thesis(bodies=6), fall=5, copies=2, rest=2, steps=2),
        "created": rows.Row(
            "", scenes.Stack(), worlds=2, rest=0, steps=2, anew=True, created=True, still=False, peer_worlds=1
        ),
        "asleep": rows.Row("", scenes.Thesis(bodies=6), fall=5, rest=2, steps=2, asleep=True),
        "jointed": rows.Row("", scenes.JointGrid(bodies=4), rest=2, steps=2, still=False),
    }
    monkeypatch.setattr(games, "ROWS", small)
    monkeypatch.setenv(program.VARIABLE, " ".join(falling.words))
    values = games.measure(True, config="sweeps_10,default")
    assert list(values["scenes"]) == list(small) and values["configs"] == ["sweeps_10", "default"]
    assert len(list(tmp_path.glob("*.npz"))) == 1  # both piles have fallen alike
    for name, row in values["scenes"].items():
        assert row["engines"]["peer"]["ms"] == pytest.approx(1e3 * (0.75 if name == "created" else 0.5) / 2)
        if name == "asleep":
            assert row["ms"] > 0.0 and "over_peer" in row
        else:
            assert row["ms"] == row["engines"]["sweeps_10"]["ms"] > 0.0
            assert {"over_peer", "overlap_mean_mm"} <= row.keys()
            assert sum(row["shares"].values()) == pytest.approx(1.0)
        assert ("creep_mm_s" in row["engines"]["peer"]) == small[name].still
        assert ("separation_max_mm" in row["engines"]["peer"]) == (name == "jointed")
    swung = values["scenes"]["jointed"]["engines"]
    assert 0.0 < swung["default"]["separation_max_mm"] < 2.0 < swung["peer"]["separation_max_mm"]
    fallen = values["scenes"]["rest"]["engines"]["peer"]
    assert fallen["drift_mm"] == pytest.approx(1e3 * 9.8 * DT**2 * 45, rel=0.3)  # nine steps of free fall
    table = games.report(values)
    assert "rest, falling bodies" in table and "created, deep-contact, default: " in table


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pyramids"], "there is no scene 'pyramids'; there are: thesis_64, "),
        (["--config", "default,quickest"], "there is no config 'quickest'; there are: default, "),
    ],
)
def test_an_unknown_scene_or_config_is_one_line(arguments, message, capsys):
    assert command.main(["games", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith(message) and len(error.splitlines()) == 1


def test_scenes_may_be_named_behind_the_options(monkeypatch, capsys):
    seen = []
    monkeypatch.setattr(games, "measure", lambda quick, *names, **more: seen.append((quick, names, more)) or {})
    monkeypatch.setattr(games, "report", lambda values: "a table")
    assert command.main(["games", "--quick", "pyramid_1275", "tumbler_2000", "--config", "default"]) == 0
    assert seen == [(True, ("pyramid_1275", "tumbler_2000"), {"config": "default"})]
    assert command.main(["sweep", "--config", "default"]) == 2
    assert "sweep takes no --config" in capsys.readouterr().err
