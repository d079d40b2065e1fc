"""Differentiable sweeps: against a loop in torch, the solver, dense algebra and the oracle; gradients by gradcheck."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.enums import Flag
from dc_kernels.runtime.backends import argument_names, bind
from pipeline.scenes import Mixed, Thesis

torch = pytest.importorskip("torch")
from dc_kernels.learn.differentiable import ContactProblem, sweeps_torch  # noqa: E402
from dc_kernels.learn.packed import Column  # noqa: E402
from dc_kernels.torch_ops.sweeps import sweep_kernels  # noqa: E402

torch.set_num_threads(1)
CONTACTS, BODIES = (4, 0, 7, 1, 0), (3, 2, 5, 2, 0)  # of the worlds of ``arrays``


def arrays(seed: int = 0, dtype: Any = np.float64) -> dict[str, np.ndarray]:
    """Worlds with many contacts, one and none; static bodies, and one that only turns; contacts without friction."""
    draw = np.random.default_rng(seed)
    body_start, contact_start = (np.concatenate(([0], np.cumsum(n))) for n in (BODIES, CONTACTS))
    pairs = [
        first + draw.choice(n, 2, replace=False) for first, n, m in zip(body_start, BODIES, CONTACTS) for _ in range(m)
    ]
    a, b = np.transpose(pairs)
    angle, count, bodies = draw.uniform(0, 2 * np.pi, len(a)), len(a), body_start[-1]
    inv_mass, inv_inertia = draw.uniform(0.5, 2.0, bodies), draw.uniform(0.5, 8.0, bodies)
    inv_mass[body_start[:3]] = 0.0
    inv_inertia[body_start[:2]] = 0.0
    values = {
        "normal": np.stack([np.cos(angle), np.sin(angle)], axis=1),
        "arm_a": draw.normal(0, 0.5, (count, 2)),
        "arm_b": draw.normal(0, 0.5, (count, 2)),
        "friction": draw.choice([0.0, 0.3, 0.8], count),
        "bias": draw.normal(0, 0.3, count),
        "inv_mass": inv_mass,
        "inv_inertia": inv_inertia,
        "velocity": draw.normal(size=(bodies, 3)),
    }
    integers = {"contact_start": contact_start, "body_start": body_start, "body_a": a, "body_b": b}
    return {**integers, **{name: value.astype(dtype) for name, value in values.items()}}


def problem(seed: int = 0, dtype: Any = np.float64, **changed: Any) -> ContactProblem:
    values = {name: torch.from_numpy(value) for name, value in arrays(seed, dtype).items()}
    return ContactProblem(**{**values, **changed})


def impulses(seed: int = 0, dtype: Any = torch.float64, count: int = sum(CONTACTS)) -> Any:
    return torch.tensor(np.random.default_rng(100 + seed).normal(0.3, 0.5, (count, 2)), dtype=dtype)


def jacobians(p: ContactProblem) -> tuple[Any, Any]:
    """J, (2 M, 3 N), and the diagonal of M^-1, (3 N,), from the definition."""
    rows = torch.zeros(2 * len(p.body_a), 3 * len(p.velocity), dtype=p.velocity.dtype)
    for c in range(len(p.body_a)):
        n = p.normal[c]
        for k, d in enumerate((n, torch.stack([n[1], -n[0]]))):
            for body, arm, sign in ((p.body_a[c], p.arm_a[c], -1.0), (p.body_b[c], p.arm_b[c], 1.0)):
                turn = arm[0] * d[1] - arm[1] * d[0]
                rows[2 * c + k, 3 * body : 3 * body + 3] = sign * torch.stack([d[0], d[1], turn])
    return rows, torch.stack([p.inv_mass, p.inv_mass, p.inv_inertia], dim=1).flatten()


def stop(free: Any, low: Any, high: Any, leak: float) -> Any:
    """Clamp; beyond the limits a share of the gradient passes."""
    clamped = torch.where(free > high, high, torch.where(free < low, low, free))
    return clamped + leak * (free - free.detach()) * ((free < low) | (free > high))


def plain_sweeps(x: Any, p: ContactProblem, sweeps: int, leak: float = 0.0) -> tuple[Any, Any, Any, float]:
    """The same in dense torch, row by row; and how near a row came to a kink."""
    rows, inverse = jacobians(p)
    response = rows * inverse
    mass = (rows * response).sum(dim=1)
    mass = torch.where(mass > 0, 1.0 / mass, 0.0)
    x, v = list(x.flatten()), p.velocity.flatten() + x.flatten() @ response
    changes, nearest = [v.new_zeros(())] * len(x), math.inf
    zero, infinity = torch.zeros((), dtype=v.dtype), torch.tensor(math.inf, dtype=v.dtype)
    for _ in range(sweeps):
        for i in range(len(x)):
            normal = i % 2 == 0
            limit = infinity if normal else p.friction[i // 2] * x[i - 1]
            free = x[i] - mass[i] * (rows[i] @ v + (p.bias[i // 2] if normal else 0.0))
            if mass[i] > 0:
                gaps = [abs(free.item())] if normal else [abs((free + s * limit).item()) for s in (-1, 1)]
                nearest = min(nearest, *gaps)
            new = stop(free, zero if normal else -limit, limit, leak)
            changes[i] = new - x[i]
            x[i], v = new, v + response[i] * changes[i]
    return torch.stack(x).reshape(-1, 2), v.reshape(-1, 3), torch.stack(changes).reshape(-1, 2), nearest


# ---------------------------------------------------------------------- against torch


@pytest.mark.parametrize("leak", [0.0, 0.25])
@pytest.mark.parametrize("sweeps", [0, 1, 2, 5])
def test_sweeps_and_their_gradient_are_those_of_a_loop_in_torch(sweeps, leak):
    stopped = 0
    for seed in range(4):
        p, weights = problem(seed), [impulses(s) for s in (5, 6)]
        speed_weight = torch.tensor(np.random.default_rng(7).normal(size=tuple(p.velocity.shape)))
        results = []
        for sweep in (sweeps_torch, plain_sweeps):
            x = impulses(seed).requires_grad_()
            y, v, change = sweep(x, p, sweeps, leak=leak)[:3]
            loss = (weights[0] * y).sum() + (speed_weight * v).sum() + (weights[1] * change.square()).sum()
            results.append((y, v, change, torch.autograd.grad(loss, x)[0]))
        for found, expected in zip(*results):
            torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-12)
        stopped += int((results[0][0][:, 0] == 0).sum())
    assert sweeps == 0 or stopped > 5  # the cone was met


def test_gradients_by_finite_differences():
    for seed in range(3):
        p = problem(seed)
        assert plain_sweeps(impulses(seed), p, 3)[3] > 1e-4  # no kink nearby
        x = impulses(seed).requires_grad_()
        assert torch.autograd.gradcheck(sweeps_torch, (x, p, 3), rtol=1e-6, atol=1e-8)
        assert torch.autograd.gradcheck(p.velocities, (x,))
        assert torch.autograd.gradcheck(p.energy, (x,))


def test_a_second_derivative_raises():
    x = impulses().requires_grad_()
    y, _, _ = sweeps_torch(x, problem(), 2)
    (by,) = torch.autograd.grad(y.square().sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="no autograd formula"):
        by.sum().backward()


def test_velocities_energy_and_natural_map_are_those_of_dense_algebra():
    p, x = problem(), impulses()
    rows, inverse = jacobians(p)
    v = p.velocity.flatten() + inverse * (rows.T @ x.flatten())
    torch.testing.assert_close(p.velocities(x), v.reshape(-1, 3))
    energy = p.energy(x)
    delassus = rows @ torch.diag(inverse) @ rows.T
    for w, (first, last) in enumerate(zip(p.contact_start[:-1], p.contact_start[1:])):
        part = slice(2 * int(first), 2 * int(last))
        torch.testing.assert_close(energy[w], 0.5 * x.flatten()[part] @ delassus[part, part] @ x.flatten()[part])
    assert not energy[1] and not energy[4]
    mass = torch.diagonal(delassus)
    free = x - (torch.where(mass > 0, 1 / mass, 0) * (rows @ v)).reshape(-1, 2)
    free[:, 0] -= torch.where(mass > 0, 1 / mass, 0)[::2] * p.bias
    n = free[:, 0].clamp(min=0)
    t = torch.maximum(torch.minimum(free[:, 1], p.friction * n), -p.friction * n)
    torch.testing.assert_close(p.natural_map(x), torch.stack([n, t], dim=1) - x)


def test_sweeps_go_on_where_they_stopped_and_end_at_a_zero_of_the_natural_map():
    p, x = problem(2), impulses(2)
    whole = sweeps_torch(x, p, 7)
    torch.testing.assert_close(sweeps_torch(sweeps_torch(x, p, 3)[0], p, 4)[0], whole[0])
    torch.testing.assert_close(whole[1], p.velocities(whole[0]))
    before = sweeps_torch(x, p, 6)[0]
    torch.testing.assert_close(whole[2], whole[0] - before)
    end, _, change = sweeps_torch(x, p, 3000)
    assert change.abs().max() < 1e-12 and end.abs().max() > 0.1
    assert p.natural_map(end).abs().max() < 1e-10 < p.natural_map(before).abs().max()


def test_leak_changes_the_gradient_only():
    p, x = problem(), impulses().requires_grad_()
    found = [sweeps_torch(x, p, 4, leak=leak) for leak in (0.0, 0.1)]
    for one, other in zip(*found):
        torch.testing.assert_close(one, other, rtol=0, atol=0)
    without, with_leak = (torch.autograd.grad(y.square().sum() + v.sum(), x)[0] for y, v, _ in found)
    assert (without == 0).sum() > (with_leak == 0).sum()


# ---------------------------------------------------------------------- against the solver


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("scene", [Thesis(bodies=40), Mixed(bodies=12)], ids=["discs", "mixed"])
def test_sweeps_are_those_of_the_solver(scene, dtype):
    config = dc.SolverConfig(acceleration="none", tolerance=0.0, max_sweeps=6)
    sim = dc.Simulation(*scene.build(3, 0).finalize(dtype), config=config)
    sim.run(120, 0.01)
    sim.collide(0.01)
    p = ContactProblem.from_simulation(sim)
    slots = p.slot.numpy()
    start = torch.from_numpy(sim.contacts.numpy("impulse")[slots])
    chosen = ContactProblem.from_simulation(sim, [2, 0])
    sim.solve()
    x, v, change = sweeps_torch(start, p, 6)
    atol = 1e-13 if dtype == "float64" else 1e-5
    solution = sim.contacts.numpy("impulse")[slots]
    assert len(solution) > 30 and (p.inv_mass == 0).any() and (p.inv_mass > 0).any()
    assert (p.normal[:, 0] * p.normal[:, 1]).abs().max() > 0.01 and (solution[:, 1] != 0).any()
    np.testing.assert_allclose(x.numpy(), solution, rtol=0, atol=atol)
    np.testing.assert_allclose(v.numpy(), sim.motion.numpy("solved")[: len(v), :3], rtol=0, atol=10 * atol)
    largest = [float(change[a:b].abs().max()) for a, b in zip(p.contact_start[:-1], p.contact_start[1:])]
    np.testing.assert_allclose(largest, sim.stats.numpy("change"), rtol=0, atol=atol)
    # some worlds, in another order
    first, bodies = p.contact_start.tolist(), p.body_start.tolist()
    x, v, _ = sweeps_torch(torch.cat([start[first[2] :], start[: first[1]]]), chosen, 6)
    np.testing.assert_array_equal(chosen.slot.numpy(), np.concatenate([slots[first[2] :], slots[: first[1]]]))
    expected = sim.contacts.numpy("impulse")[chosen.slot.numpy()]
    np.testing.assert_allclose(x.numpy(), expected, rtol=0, atol=atol)
    solved = sim.motion.numpy("solved")
    expected = np.concatenate([solved[bodies[2] : bodies[3], :3], solved[: bodies[1], :3]])
    np.testing.assert_allclose(v.numpy(), expected, rtol=0, atol=10 * atol)


def test_effective_masses_are_worked_out_as_the_solver_does():
    sim = dc.Simulation(*Mixed(bodies=12).build(1, 0).finalize("float64"))
    sim.run(100, 0.01)
    sim.collide(0.01)
    p = ContactProblem.from_simulation(sim)
    other = dataclasses.replace(p, effective_mass=None)
    torch.testing.assert_close(other._row, p._row, rtol=1e-13, atol=1e-13)
    double = dataclasses.replace(p, effective_mass=2 * p.effective_mass)
    assert (double._row != p._row).any()


def test_flagged_worlds_have_no_contacts():
    sim = dc.Simulation(*Thesis(bodies=10).build(2, 0).finalize("float64"))
    sim.run(150, 0.01)
    sim.collide(0.01)
    count = int(sim.contacts.numpy("contact_count")[1])
    sim.state.numpy("flags")[0] = Flag.NONFINITE
    sim.motion.numpy("predicted")[1] = math.nan
    p = ContactProblem.from_simulation(sim)
    assert p.contact_start.tolist() == [0, 0, count] and count
    assert not p.velocity[: int(p.body_start[1])].any()


def test_from_simulation_refuses():
    sim = dc.Simulation(*Thesis(bodies=3).build(2, 0).finalize())
    with pytest.raises(ValueError, match=r"needs collide\(dt\) first"):
        ContactProblem.from_simulation(sim)
    sim.collide(0.01)
    assert len(ContactProblem.from_simulation(sim, [])._row) == 0
    for worlds, index in (([0, 2], 1), ([-1], 0), ([1, 1], 1)):
        with pytest.raises(ValueError, match=rf"worlds\[{index}\] is {worlds[index]}; it must lie in \[0, 1\]"):
            ContactProblem.from_simulation(sim, worlds)
    from pipeline.scenes import Chain

    sim = dc.Simulation(*Chain(bodies=3).build().finalize())
    sim.collide(0.01)
    with pytest.raises(ValueError, match="joints; a contact problem holds contacts only"):
        ContactProblem.from_simulation(sim)


# ---------------------------------------------------------------------- kernels


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_kernels_agree_with_the_oracle(dtype):
    """Each on the same arrays, the adjoint on the tape of the sweeps before it."""
    import warp as wp

    tables = {backend: sweep_kernels(backend, dtype) for backend in ("warp", "numpy")}
    assert tables["warp"].keys() == tables["numpy"].keys()
    given = arrays(1, np.dtype(dtype))
    draw, count, bodies = np.random.default_rng(2), sum(CONTACTS), sum(BODIES)
    values: dict[str, Any] = {
        **{name: array.astype(np.int32) if array.dtype.kind == "i" else array for name, array in given.items()},
        "world_offset": 0,
        "leak": 0.2,
        "given_mass": 0,
        "inverse": np.stack([given["inv_mass"], given["inv_mass"], given["inv_inertia"]], axis=1),
        "row": np.zeros((count, len(Column)), dtype),
        "row_body": np.stack([given["body_a"], given["body_b"]], axis=1).astype(np.int32),
        "impulse": draw.normal(0.3, 0.5, (count, 2)).astype(dtype),
        "active": np.zeros((3, count), np.int8),
        "by_velocity": draw.normal(size=(bodies, 3)).astype(dtype),
        **{name: draw.normal(size=(count, 2)).astype(dtype) for name in ("speed", "step", "change")},
        **{name: draw.normal(size=(count, 2)).astype(dtype) for name in ("by_impulse", "by_change")},
    }
    columns = {"normal": slice(Column.NX, Column.NY + 1), "bias": Column.BIAS, "friction": Column.MU}
    for key, column in columns.items():
        values["row"][:, column] = given[key]
    atol = 1e-13 if dtype == "float64" else 2e-6
    for name in tables["warp"]:
        names = argument_names(tables["warp"][name])
        assert names == argument_names(tables["numpy"][name])
        results = {}
        for backend, table in tables.items():
            copies = {key: v.copy() if isinstance(v, np.ndarray) else v for key, v in values.items()}
            bound = dict(copies)
            if backend == "warp":
                for argument in table[name].adj.args:
                    if hasattr(argument.type, "dtype"):
                        bound[argument.label] = wp.array(
                            copies[argument.label], dtype=argument.type.dtype, device="cpu", copy=False
                        )
            bind(table[name], len(CONTACTS), bound, "cpu")()
            results[backend] = copies
        for key in names:
            # what a backend leaves of the velocities' cotangent is its own business
            if isinstance(values[key], np.ndarray) and (name, key) != ("pull_problem", "by_velocity"):
                found, expected = (results[backend][key] for backend in ("warp", "numpy"))
                np.testing.assert_allclose(found, expected, rtol=0, atol=atol, err_msg=f"{name}: {key}")
        values.update({key: results["numpy"][key] for key in ("row", "active") if key in names})
    assert {1, 2, 3, 4, 5} <= set(np.unique(values["active"]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_threads_do_not_change_a_bit(dtype):
    p = problem(dtype=str(dtype).removeprefix("torch."))
    found = []
    for threads in (1, 2, 5, 9):
        x = impulses(dtype=dtype).requires_grad_()
        y, v, change = sweeps_torch(x, p, 4, threads=threads)
        energy = p.energy(x, threads=threads)
        (y.sum() + v.square().sum() + change.sum() + energy.sum()).backward()
        found.append((y, v, change, energy, p.natural_map(x, threads=threads), x.grad))
    for other in found[1:]:
        torch.testing.assert_close(other, found[0], rtol=0, atol=0)


def test_nothing_at_all():
    for bodies in (0, 3):
        none = {"contact_start": [0, 0], "body_start": [0, bodies], "body_a": [], "body_b": []}
        shapes = {"normal": (0, 2), "arm_a": (0, 2), "arm_b": (0, 2), "friction": (0,), "bias": (0,)}
        shapes.update(inv_mass=(bodies,), inv_inertia=(bodies,), velocity=(bodies, 3))
        integers = {name: torch.tensor(value, dtype=torch.int32) for name, value in none.items()}
        p = ContactProblem(**integers, **{name: torch.ones(shape) for name, shape in shapes.items()})
        x, v, change = sweeps_torch(torch.zeros(0, 2, requires_grad=True), p, 3)
        assert x.shape == change.shape == (0, 2) and v.shape == (bodies, 3)
        v.sum().backward()
        assert p.energy(x).tolist() == [0.0]


def test_inputs_stay_and_cotangents_may_have_any_layout():
    p, x = problem(), impulses().requires_grad_()
    before = x.detach().clone(), p.velocity.clone()
    y, v, _ = sweeps_torch(x, p, 3)
    (y.sum() + (v.T.contiguous().T * 2).sum()).backward()
    by_sum, x.grad = x.grad, None
    y, v, _ = sweeps_torch(x, p, 3)
    torch.autograd.backward([y, v], [torch.ones_like(y), 2 * torch.ones_like(v)])
    torch.testing.assert_close(x.grad, by_sum)
    torch.testing.assert_close((x.detach(), p.velocity), before, rtol=0, atol=0)


def test_operators_keep_torchs_rules():
    p, x = problem(), impulses().requires_grad_()
    packed = p._packed(x, 1)
    ops = torch.ops.deep_contact
    torch.library.opcheck(ops.push_impulses, (x, p.velocity, *packed))
    torch.library.opcheck(ops.sweep_problem, (x, p.velocity, *packed, 2, 0.1))
    fixed = x.detach()
    torch.library.opcheck(ops.pull_velocities, (p.velocity, *packed))
    active = torch.ones(2, len(x), dtype=torch.int8)
    torch.library.opcheck(ops.pull_problem, (fixed, p.velocity, fixed, active, *packed, 0.1))


# ---------------------------------------------------------------------- refusals


def changed(name: str, index: Any, value: float) -> Any:
    tensor = torch.from_numpy(arrays()[name]).clone()
    tensor[index] = value
    return tensor


def test_bad_input_is_refused_by_name():
    p, x = problem(), impulses()
    bad = x.clone()
    bad[3, 1] = math.nan
    for message, call in (
        (r"impulse\[3, 1\] is nan; it must be finite", lambda: sweeps_torch(bad, p, 2)),
        (r"impulse\[3, 1\] is nan", lambda: p.energy(bad)),
        (r"impulse\[3, 1\] is nan", lambda: p.natural_map(bad)),
        (r"impulse has dtype float32; it must be float64", lambda: sweeps_torch(x.float(), p, 2)),
        (r"impulse has dtype torch.int64", lambda: sweeps_torch(x.long(), p, 2)),
        (r"impulse has shape \(11, 2\); it must be \(12, 2\)", lambda: p.velocities(x[1:].contiguous())),
        (r"impulse has strides .*; it must be contiguous", lambda: sweeps_torch(x.T.contiguous().T, p, 2)),
        (r"sweeps is -1", lambda: sweeps_torch(x, p, -1)),
        (r"sweeps is 1.5", lambda: sweeps_torch(x, p, 1.5)),
        (r"leak is 1.5", lambda: sweeps_torch(x, p, 1, leak=1.5)),
        (r"leak is nan", lambda: sweeps_torch(x, p, 1, leak=math.nan)),
        (r"threads is 0", lambda: sweeps_torch(x, p, 1, threads=0)),
        (r"body_a\[4\] is 3; it must lie in \[5, 9\]", lambda: problem(body_a=changed("body_a", 4, 3))),
        (r"body_b\[11\] is 12; it must lie in \[10, 11\]", lambda: problem(body_b=changed("body_b", 11, 12))),
        (r"body_b\[0\] is -1", lambda: problem(body_b=changed("body_b", 0, -1))),
        (r"body_a has shape \(12,\), dtype float64; it must be \(12,\) integers", lambda: problem(body_a=p.bias)),
        (r"friction\[2\] is -0.1; it must be finite and >= 0", lambda: problem(friction=changed("friction", 2, -0.1))),
        (r"bias\[0\] is inf; it must be finite", lambda: problem(bias=changed("bias", 0, math.inf))),
        (r"velocity\[1, 2\] is nan", lambda: problem(velocity=changed("velocity", (1, 2), math.nan))),
        (r"inv_mass\[1\] is -1.0", lambda: problem(inv_mass=changed("inv_mass", 1, -1.0))),
        (r"normal\[5\] is .*; it must be a unit vector", lambda: problem(normal=changed("normal", (5, 0), 2.0))),
        (r"arm_a has dtype float32; it must be float64", lambda: problem(arm_a=p.arm_a.float())),
        (r"arm_b has shape \(12,\)", lambda: problem(arm_b=p.arm_b[:, 0].contiguous())),
        (r"effective_mass has shape", lambda: problem(effective_mass=p.bias)),
        (r"velocity has dtype torch.float16", lambda: problem(velocity=p.velocity.half())),
        (r"body_start\[5\] is 12; it must be the number of bodies, 11", lambda: problem(velocity=p.velocity[1:])),
        (r"contact_start\[2\] is 3; it must be", lambda: problem(contact_start=changed("contact_start", 2, 3))),
        (r"contact_start has 2 entries; body_start has 6", lambda: problem(contact_start=torch.tensor([0, 12]))),
    ):
        with pytest.raises(ValueError, match=message):
            call()
