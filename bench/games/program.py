"""Any engine beside ours: a program that reads a scene from its standard input, steps it and writes where all went.

Lines of words with a space between, numbers in decimal; ``bench/README.md`` describes them. ``PEER`` in the environment
is the command that starts the program.
"""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

import dc_kernels as dc
from dc_kernels.model.enums import BodyType, JointKind, JointPart, ShapeType
from dc_kernels.model.fields import UNBOUNDED
from pipeline.scenes.peer_joints import PeerJoint, peer_joints

VARIABLE = "PEER"
KINDS = {BodyType.STATIC: "static", BodyType.KINEMATIC: "kinematic", BodyType.DYNAMIC: "dynamic"}


def command() -> list[str] | None:
    """Return the words of the command in ``PEER``; None where there is none."""
    return shlex.split(os.environ.get(VARIABLE, "")) or None


def lines_of(model: dc.Model, state: dc.State, joints: dc.Joints) -> Iterator[str]:
    """Describe all worlds, line by line.

    Raises:
        ValueError: for forces, which last in our steps and which the protocol does not have, and for joints that it
            does not have (``peer_joints``).
    """
    m = {name: model.numpy(name) for name in model.table}
    s = {name: state.numpy(name) for name in state.table}
    j = {name: joints.numpy(name) for name in joints.table}
    if s["force"].any() or s["torque"].any():
        raise ValueError("force and torque must be 0: a peer program is told of none")
    for world in range(model.world_count):
        first, last = m["body_start"][world : world + 2].tolist()
        yield _line("world", *m["gravity"][world])
        for b in range(first, last):
            kind = BodyType(int(m["body_type"][b]))
            pose = (*s["position"][b], s["angle"][b], *s["velocity"][b], s["angular_velocity"][b])
            yield _line("body", KINDS[kind], *pose, m["mass"][b], m["inertia"][b])
            for shape in np.flatnonzero(m["shape_body"] == b).tolist():
                yield _shape(m, shape)
        for joint in peer_joints(j, range(*m["joint_start"][world : world + 2].tolist()), first):
            yield _joint(joint)


def _shape(m: Mapping[str, np.ndarray], shape: int) -> str:
    points = m["vertices"][slice(*m["vertex_start"][shape : shape + 2])]
    kind = ShapeType(int(m["shape_type"][shape]))
    if kind == ShapeType.SEGMENT:
        points, name = points[:2], "segment"
    elif kind == ShapeType.DISC:
        name = "disc"
    else:
        name = "capsule" if len(points) == 2 else "polygon"
    material = m["shape_friction"][shape], m["shape_restitution"][shape]
    bits = (int(m[f"shape_{name}"][shape]) & 0xFFFFFFFF for name in ("category", "mask"))
    return _line(name, *material, *bits, m["shape_radius"][shape], *points.ravel())


def _joint(joint: PeerJoint) -> str:
    ends = (*joint.bodies, int(joint.collides), *joint.anchors[0], *joint.anchors[1])
    limits = (-UNBOUNDED if joint.lower is None else joint.lower, UNBOUNDED if joint.upper is None else joint.upper)
    motor = (joint.speed, -1 if joint.strength is None else joint.strength)
    spring = (joint.frequency, joint.damping_ratio)
    if joint.kind == JointKind.DISTANCE:
        if JointPart.HOLD in joint.parts:
            if joint.is_spring:
                return _line("spring", *ends, joint.length, *spring, *limits)
            return _line("rod", *ends, joint.length)
        return _line("rope", *ends, *limits)
    if joint.kind == JointKind.REVOLUTE:
        return _line("hinge", *ends, joint.reference, *limits, *motor)
    if joint.kind == JointKind.PRISMATIC:
        return _line("slider", *ends, *joint.axis, joint.reference, *limits, *motor)
    if joint.kind == JointKind.WELD:
        return _line("weld", *ends, joint.reference, *spring)
    return _line("wheel", *ends, *joint.axis, *spring, *limits, *motor)


def _line(*words: object) -> str:
    """Write floats with the digits that float32 needs, and end the line."""
    return " ".join(f"{word:.9g}" if isinstance(word, (float, np.floating)) else str(word) for word in words) + "\n"


class Program:
    """A peer program in a process of its own."""

    def __init__(self, words: Iterable[str]) -> None:
        """Start it; it is asked for its name.

        Raises:
            FileNotFoundError: there is no such program.
            RuntimeError: it ends, or answers otherwise than the protocol says.
        """
        self.words = list(words)
        self.process = subprocess.Popen(self.words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.name = " ".join(self.ask("name", "name"))

    def tell(self, lines: Iterable[str]) -> None:
        """Send lines that have no answer; each ends with a line break."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.writelines(lines)
            self.process.stdin.flush()
        except BrokenPipeError:
            raise RuntimeError(f"{self.words[0]} has ended with {self.process.wait()}") from None

    def ask(self, question: str, answer: str) -> list[str]:
        """Send a line and return the words of the answer behind its first, which must be ``answer``.

        Raises:
            RuntimeError: for an end of the program, or another answer, such as ``error TEXT``.
        """
        self.tell([f"{question}\n"])
        return self._read(question, answer)

    def _read(self, question: str, answer: str) -> list[str]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        words = line.split()
        if not words or words[0] != answer:
            said = repr(line.rstrip()) if line else f"its end, {self.process.wait()}"
            raise RuntimeError(f"{self.words[0]} answered {question!r} with {said}; it must be '{answer} ...'")
        return words[1:]

    def build(self) -> float:
        """Let it make the worlds as they were told, from the beginning; the time that it took [s]."""
        return float(self.ask("build", "built")[0])

    def step(self, steps: int, dt: float) -> tuple[float, dict[str, float]]:
        """Let it take steps of dt [s] in all worlds; the time [s], and that of the parts it names [s]."""
        taken, *rest = self.ask(f"step {steps} {dt:.9g}", "stepped")
        return float(taken), {name: float(value) for name, value in zip(rest[::2], rest[1::2], strict=True)}

    def poses(self) -> np.ndarray:
        """Position [m], angle [rad], velocity [m/s] and spin [rad/s] of all bodies, static ones too, (n, 6)."""
        count = int(self.ask("poses", "poses")[0])
        assert self.process.stdout is not None
        rows = [self.process.stdout.readline().split() for _ in range(count)]
        return np.array(rows, np.float64).reshape(count, 6)

    def close(self) -> None:
        """End it."""
        if self.process.poll() is None:
            try:
                self.tell(["quit\n"])
                self.process.wait(5.0)
            except (RuntimeError, subprocess.TimeoutExpired):
                self.process.kill()
                self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
