"""The solver: schedules, lanes, threads and batches give the same bits; solutions satisfy the contact laws."""

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR
from tests.solve.scenes import DT, as_bytes, bits, check_laws, dense, pile, solve_from, used

METHODS = [(m, a) for m in ("pgs", "jacobi") for a in ("none", "sor", "aitken", "nncg", "adaptive")]


def world_bits(sim, w):
    """Bits of one world alone."""
    slots, world = used(sim)
    first, last = sim.model.numpy("body_start")[w : w + 2]
    arrays = [sim.state.numpy(n)[first:last] for n in ("position", "angle", "velocity", "angular_velocity")]
    arrays += [sim.contacts.numpy(n)[slots[world == w]] for n in ("impulse", "color", "age", "gap", "normal")]
    arrays += [sim.stats.numpy(n)[w : w + 1] for n in ("sweeps", "change", "residual")]
    return [as_bytes(a) for a in arrays]


# ---------------------------------------------------------------- the same bits


CASES = [(v, t) for v in ("discs", "general", "joints") for t in ("float32", "float64")]


@pytest.mark.parametrize(("variant", "dtype"), CASES)
def test_schedules_give_the_same_bits(variant, dtype):
    """On the CPU the world schedule sweeps in SIMD lanes, the colour schedule row by row in the scalar function."""
    sims = [pile(variant, dtype, schedule=schedule) for schedule in ("world", "color")]
    for sim in sims:
        sim.run(90, DT)
    assert bits(sims[0]) == bits(sims[1])
    for sim in sims:
        sim.collide(DT)
    assert min(sims[0].contacts.numpy("contact_count")) >= 2 * LANES
    for method, acceleration in METHODS:
        omega = 0.8 if method == "jacobi" else 1.4
        for stop in ("change", "residual", "motion"):
            changes = {"method": method, "acceleration": acceleration, "omega": omega, "stop": stop}
            results = [solve_from(s, max_sweeps=60, tolerance=1e-4, history=True, **changes) for s in sims]
            for left, right in zip(*results):
                assert as_bytes(left) == as_bytes(right), changes
            for name in ("sweeps", "change", "residual"):
                assert sims[0].stats.numpy(name).tobytes() == sims[1].stats.numpy(name).tobytes(), changes
            assert (sims[0].stats.history.numpy() == sims[1].stats.history.numpy()).all(), changes
            assert sims[0].stats.numpy("sweeps").min() > 3


def hub(schedule, **options):
    """A light disc with 80 others pressed against it: more contacts at one body than colours."""
    angle = np.arange(80) * 2 * np.pi / 80
    out = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.3, -0.2))
    builder.add_discs([(0.0, 0.0)], 3.0, density=0.01)
    builder.add_discs(3.1 * out, 0.1, velocity=-1.0 * out * (1 + 0.3 * np.sin(3 * angle))[:, None])
    return dc.Simulation(*builder.finalize("float32"), schedule=schedule, **options)


def test_serial_colour_takes_the_overflow_in_both_schedules():
    sims = [hub(schedule) for schedule in ("world", "color")]
    for sim in sims:
        sim.collide(DT)
        colors = sim.contacts.numpy("color")[used(sim)[0]]
        assert (colors == SERIAL_COLOR).sum() == 80 - SERIAL_COLOR
        assert sorted(colors[colors != SERIAL_COLOR]) == list(range(COLORS - 1))
    for method, acceleration in METHODS:
        changes = {"method": method, "acceleration": acceleration, "omega": 0.9}
        results = [solve_from(s, max_sweeps=50, **changes) for s in sims]
        assert all(as_bytes(a) == as_bytes(b) for a, b in zip(*results)), changes
    impulse, _, _ = solve_from(sims[0], method="pgs", acceleration="none", tolerance=1e-7, max_sweeps=5000)
    assert (impulse[:, 0] >= 0).all()
    assert impulse[:, 0].max() > 0.01
    assert sims[0].stats.numpy("residual")[0] < 1e-3


def test_rows_of_discs_agree_with_general_rows():
    """The specialised rows leave out what is zero for discs: same solution up to round-off of the iteration."""
    settled = pile("discs", "float64")
    settled.run(90, DT)
    sims = [pile("discs", "float64", specialize=s) for s in (True, False)]
    assert [s.variant for s in sims] == ["discs", "general"]
    for sim in sims:
        for name in ("position", "angle", "velocity", "angular_velocity"):
            sim.state.assign(name, settled.state.numpy(name))
        sim.collide(DT)
    results = [solve_from(s, tolerance=1e-13, max_sweeps=200_000, acceleration="none") for s in sims]
    assert len(results[0][0]) > 20
    np.testing.assert_allclose(results[0][2], results[1][2], atol=1e-9)
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-8)
    # after a single sweep nothing has been amplified yet
    results = [solve_from(s, max_sweeps=1, acceleration="none") for s in sims]
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-13)


@pytest.mark.parametrize("variant", ["discs", "joints"])
def test_threads_and_batches_do_not_change_a_bit(variant):
    seeds = (5, 6, 7, 8, 9)
    one = pile(variant, seeds=seeds)
    one.run(60, DT)
    for threads in (2, 3, 16):
        other = pile(variant, seeds=seeds, threads=threads)
        other.run(60, DT)
        assert bits(other) == bits(one), threads
    stepped = pile(variant, seeds=seeds, threads=2)
    for _ in range(60):
        stepped.step(DT)
    assert bits(stepped) == bits(one)
    for w in (0, 3):
        alone = pile(variant, seeds=seeds[w : w + 1])
        alone.run(60, DT)
        assert world_bits(alone, 0) == world_bits(one, w)


def dense_pgs(delassus, speed, bias, friction, sweeps):
    """Plain projected Gauss-Seidel on the dense Delassus matrix, contact by contact: impulses (2c,)."""
    x = np.zeros(len(speed))
    for _ in range(sweeps):
        before = x.copy()
        for k in range(len(bias)):
            n, t = 2 * k, 2 * k + 1
            x[n] = max(0.0, x[n] - (delassus[n] @ x + speed[n] + bias[k]) / delassus[n, n])
            limit = friction[k] * x[n]
            x[t] = np.clip(x[t] - (delassus[t] @ x + speed[t]) / delassus[t, t], -limit, limit)
        if np.abs(x - before).max() < 1e-14:
            break
    return x


@pytest.mark.parametrize("variant", ["discs", "general"])
@pytest.mark.parametrize("steps", [75, 300])
def test_solution_against_dense_oracle(variant, steps):
    """An independent PGS on the dense Delassus matrix J M^-1 J^T finds the same velocities, falling and at rest."""
    sim = pile(variant, "float64", seeds=(3,), n=8)
    sim.run(steps, DT)
    sim.collide(DT)
    j, inverse, velocity, bias, friction = dense(sim)
    x = dense_pgs(j * inverse @ j.T, j @ velocity, bias, friction, 20_000)
    expected = (velocity + inverse * (j.T @ x)).reshape(-1, 3)
    impulse, _, solved = solve_from(sim, tolerance=1e-13, max_sweeps=200_000, acceleration="none")
    assert len(impulse) >= 8
    # impulses are given up to the null space of J^T, and velocities follow from them exactly
    np.testing.assert_allclose(velocity + inverse * (j.T @ impulse.ravel()), solved.ravel(), atol=1e-11)
    inside = check_laws(sim, impulse, solved, 1e-8)
    assert inside.any()
    assert sim.stats.numpy("residual")[0] < 1e-7
    np.testing.assert_allclose(solved, expected, atol=1e-7)


def test_single_precision_satisfies_the_contact_laws():
    for variant in ("discs", "general"):
        sim = pile(variant, "float32", seeds=(3,))
        sim.run(300, DT)
        sim.collide(DT)
        impulse, _, solved = solve_from(sim, tolerance=1e-7, max_sweeps=20_000)
        check_laws(sim, impulse, solved, 2e-4)


@pytest.mark.parametrize(("variant", "seed"), [("discs", 4), ("joints", 1)])
def test_every_method_reaches_the_same_velocities(variant, seed):
    sim = pile(variant, "float64", seeds=(seed,))
    sim.run(200, DT)
    sim.collide(DT)
    _, _, expected = solve_from(sim, method="pgs", acceleration="none", tolerance=1e-10, max_sweeps=200_000)
    assert sim.stats.numpy("change")[0] < 1e-10
    for method, acceleration in METHODS:
        omega = 0.9 if method == "jacobi" else 1.4
        _, _, solved = solve_from(sim, method=method, acceleration=acceleration, omega=omega, max_sweeps=200_000)
        assert sim.stats.numpy("change")[0] < 1e-10, (method, acceleration)
        np.testing.assert_allclose(solved, expected, atol=1e-6, err_msg=f"{method} {acceleration}")


def test_jacobi_converges_where_plain_jacobi_diverges():
    """Mass splitting (Tonge et al. 2012): a body shares its mass among its rows; without it nothing converges."""
    sim = hub("world")
    sim.collide(DT)
    expected, _, velocity = solve_from(sim, method="pgs", acceleration="none", tolerance=1e-8, max_sweeps=50_000)
    impulse, _, solved = solve_from(sim, method="jacobi", tolerance=1e-8)
    assert np.isfinite(impulse).all()
    np.testing.assert_allclose(solved, velocity, atol=2e-4)
    j, inverse, predicted, bias, friction = dense(sim)
    delassus = j * inverse @ j.T
    x = np.zeros(len(delassus))
    speed = j @ predicted
    speed[::2] += bias
    changes = []
    for _ in range(500):  # the same projection with unshared masses
        before = x
        x = x - (delassus @ x + speed) / np.diag(delassus)
        x[::2] = np.maximum(x[::2], 0)
        x[1::2] = np.clip(x[1::2], -friction * x[::2], friction * x[::2])
        changes.append(np.abs(x - before).max())
    assert changes[-1] > 1e-3 * expected.max()


@pytest.mark.parametrize("count", [3, 10, 25])
def test_pgs_contracts_by_cos_squared_on_a_stack(count):
    """On a floor, n frictionless discs have n contacts, and a sweep shrinks the change by cos^2(pi / 2n).

    For equal discs of mass m the Delassus matrix is tridiagonal, m A = tridiag(-1, 2, -1) but 1 at the floor's contact
    (which has one free body). The Jacobi matrix I - D^-1 A has the eigenvectors cos((k - 1) theta) with eigenvalue
    cos(theta) and cos(n theta) = 0, so its radius is cos(pi / 2n). A tridiagonal matrix is consistently ordered in any
    order of its rows, so Gauss-Seidel's radius is the square (Young 1971), also in colour order. From zero start no
    projection is active, and the changes of single contacts, here in the maximum norm, follow the slowest mode.
    """
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body((0.0, -10.0), type=dc.BodyType.STATIC), 10.0, friction=0.0)
    builder.add_discs([(0.0, 0.5 + k) for k in range(count)], 0.5, friction=0.0)
    sweeps = 6 * count * count
    config = dc.SolverConfig(acceleration="none", tolerance=0.0, max_sweeps=sweeps, history=True, start="zero")
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.collide(DT)
    slots, _ = used(sim)
    assert len(slots) == count
    sim.solve()
    history = sim.stats.history.numpy()[0]
    late = history[count * count :]
    late = late[late > 1e-9]
    radius = np.cos(np.pi / (2 * count)) ** 2
    np.testing.assert_allclose(late[-1] / late[-2], radius, rtol=1e-6)
    # the same from the dense matrix of these contacts, in the order of their colours
    j, inverse, _, _, _ = dense(sim)
    order = np.argsort(sim.contacts.numpy("color")[slots], kind="stable")
    delassus = (j * inverse @ j.T)[::2, ::2][np.ix_(order, order)]
    lower = np.tril(delassus)
    eigenvalues = np.linalg.eigvals(np.eye(count) - np.linalg.solve(lower, delassus))
    np.testing.assert_allclose(np.abs(eigenvalues).max(), radius, rtol=1e-9)
