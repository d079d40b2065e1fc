"""The solver: schedules, lanes, threads and batches give the same bits; solutions satisfy the contact laws."""

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import measure
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR

DT = 0.01
METHODS = [(m, a) for m in ("pgs", "jacobi") for a in ("none", "sor", "aitken", "nncg", "adaptive")]


def box(builder, side=1.6, height=4.0, **material):
    """A static box of chain segments, open at the top."""
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-side, height), (-side, 0), (side, 0), (side, height)), **material)
    return ground


def add_pile(builder, variant, seed, n=14):
    """A world of one variant of the solver rows: discs only, polygons among them, joints among them."""
    rng = np.random.default_rng(seed)
    builder.add_world()
    box(builder, friction=0.4)
    positions = np.stack((rng.uniform(-1.2, 1.2, n), 0.3 + 0.28 * np.arange(n)), axis=1)
    if variant == "discs":
        builder.add_discs(positions, rng.uniform(0.12, 0.24, n), density=rng.uniform(0.5, 4, n), friction=0.5)
        return
    last = None
    for i, position in enumerate(positions):
        body = builder.add_body(position, angle=rng.uniform(0, 6), angular_velocity=rng.normal())
        if i % 3 == 0:
            builder.add_disc(body, rng.uniform(0.12, 0.24), center=(0.03, 0.0))
        else:
            builder.add_box(body, rng.uniform(0.1, 0.25), rng.uniform(0.1, 0.2), density=rng.uniform(0.5, 4))
        if variant == "joints" and last is not None and i % 2:
            builder.add_distance_joint(last, body, (0.05, 0.0), (0.0, 0.05))
        last = body


def pile(variant, dtype="float32", seeds=(0, 1, 2), n=14, config=None, **options):
    """Worlds of one variant with n bodies, one for each seed."""
    builder = dc.ModelBuilder()
    for seed in seeds:
        add_pile(builder, variant, seed, n)
    return dc.Simulation(*builder.finalize(dtype), config=config or dc.SolverConfig(), **options)


def used(sim):
    """Contact slots in use and the world of each."""
    return measure.contact_slots(sim.contacts)


def solve_from(sim, start=0.0, **changes):
    """Solve the present contacts from given start impulses: impulses of contacts and joints, velocities (n, 3)."""
    slots, _ = used(sim)
    sim.contacts.numpy("impulse")[slots] = start
    sim.joints.numpy("joint_impulse")[:] = 0.0
    sim.config = replace(sim.config, **changes)
    sim.solve()
    return (
        sim.contacts.numpy("impulse")[slots].copy(),
        sim.joints.numpy("joint_impulse").copy(),
        sim.motion.numpy("solved")[: sim.model.body_count, :3].copy(),
    )


def as_bytes(values):
    """Bits of numbers; -0 counts as 0 (clamping to a limit of zero leaves either, and neither acts)."""
    return (values + np.zeros(1, values.dtype)).tobytes()


def bits(sim):
    """State, contacts in use and what the solves reported, as bytes."""
    slots, _ = used(sim)
    arrays = [sim.state.numpy(name) for name in sim.state.table]
    arrays += [sim.contacts.numpy(name)[slots] for name in ("key", "impulse", "color", "age", "gap")]
    arrays += [sim.stats.numpy(name) for name in ("sweeps", "change", "residual")]
    return [as_bytes(a) for a in [*arrays, sim.joints.numpy("joint_impulse")]]


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


# ---------------------------------------------------------------- what is solved


def dense(sim):
    """Jacobian (2c, 3b), inverse masses (3b,), predicted velocities, bias and friction of world 0, from the arrays.

    Rows: normal, then tangent, of each contact: J = [-n, -r_A x n, n, r_B x n] (Wu 2018, equations 2.21 and
    2.22), written out here from contact geometry alone, without the solver's rows. The bias of a gap above the slop is
    gap / dt; there is no restitution.
    """
    slots, _ = used(sim)
    get = {n: sim.contacts.numpy(n)[slots].astype(float) for n in ("normal", "arm_a", "arm_b", "gap", "friction")}
    a, b = (sim.contacts.numpy(n)[slots] for n in ("body_a", "body_b"))
    bodies, c = sim.model.body_count, len(slots)
    j = np.zeros((2 * c, 3 * bodies))
    for k in range(c):
        nx, ny = get["normal"][k]
        for row, d in ((2 * k, (nx, ny)), (2 * k + 1, (ny, -nx))):
            for body, arm, sign in ((a[k], get["arm_a"][k], -1.0), (b[k], get["arm_b"][k], 1.0)):
                j[row, 3 * body : 3 * body + 3] += sign * np.array([*d, arm[0] * d[1] - arm[1] * d[0]])
    inverse = np.stack([sim.model.numpy(n).astype(float) for n in ("inv_mass", "inv_mass", "inv_inertia")], axis=1)
    moving = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    velocity = np.column_stack((sim.state.numpy("velocity"), sim.state.numpy("angular_velocity"))).astype(float)
    velocity[:, :2] += moving[:, None] * sim.model.numpy("gravity")[0] * DT
    slop = sim.config.slop * sim.model.numpy("length_scale")[0]
    bias = np.where(get["gap"] > slop, get["gap"], 0.0) / DT
    return j, inverse.ravel(), velocity.ravel(), bias, get["friction"]


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


def check_laws(sim, impulse, solved, tolerance):
    """Signorini and Coulomb, with relative velocities from the dense Jacobian."""
    j, _, _, bias, friction = dense(sim)
    u = (j @ solved.ravel().astype(float)).reshape(-1, 2)
    un, ut = u[:, 0] + bias, u[:, 1]
    pn, pt = impulse.astype(float).T
    assert (pn >= 0).all()
    assert (np.abs(pt) <= friction * pn * (1 + 1e-6)).all()
    assert un.min() > -tolerance  # surfaces don't overlap more
    assert np.abs(pn * un).max() < tolerance * pn.max()  # an impulse only where they touch
    inside = np.abs(pt) < friction * pn - 1e-3 * pn.max()
    assert np.abs(ut[inside]).max(initial=0) < tolerance  # no sliding inside the cone
    sliding = np.abs(ut) > 100 * tolerance
    assert (pt[sliding] * ut[sliding] <= 0).all()  # friction against the sliding
    np.testing.assert_allclose(np.abs(pt[sliding]), friction[sliding] * pn[sliding], atol=1e-3 * pn.max())
    return inside


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


# ---------------------------------------------------------------- when it stops


def settled(dtype="float64", **options):
    sim = pile("discs", dtype, seeds=(4, 5), **options)
    sim.run(150, DT)
    sim.collide(DT)
    return sim


def test_stops_at_the_first_change_below_tolerance_and_keeps_history():
    sim = settled()
    for schedule_method, acceleration in (("pgs", "none"), ("pgs", "aitken"), ("jacobi", "none")):
        solve_from(sim, method=schedule_method, acceleration=acceleration, tolerance=1e-5, history=True)
        history, sweeps = sim.stats.history.numpy(), sim.stats.numpy("sweeps")
        assert history.shape == (2, sim.config.max_sweeps)
        assert sweeps.min() > 1
        for w, n in enumerate(sweeps):
            assert history[w, n - 1] == sim.stats.numpy("change")[w]
            assert history[w, n - 1] < 1e-5 or n == sim.config.max_sweeps
            assert (history[w, : n - 1] >= 1e-5).all()
    solve_from(sim, history=False)
    assert sim.stats.history.numpy().shape == (2, 0)


def test_history_is_zero_beyond_the_sweeps():
    sim = settled()
    solve_from(sim, acceleration="none", tolerance=1e-8, max_sweeps=5000, history=True)
    before = sim.stats.numpy("sweeps").copy()
    solve_from(sim, tolerance=1e-2)
    assert (sim.stats.numpy("sweeps") < before).all()
    for w, n in enumerate(sim.stats.numpy("sweeps")):
        assert not sim.stats.history.numpy()[w, n:].any()


def test_stops_on_the_residual_checked_every_few_sweeps():
    sim = settled()
    for every in (1, 5):
        _, _, _ = solve_from(
            sim, stop="residual", tolerance=1e-4, residual_every=every, acceleration="none", max_sweeps=20_000
        )
        assert (sim.stats.numpy("residual") < 1e-4).all()
        sweeps = sim.stats.numpy("sweeps").copy()
        assert (sweeps % every == 0).all()
        for w in range(2):  # and not before: one check less would not have been enough
            solve_from(sim, stop="residual", tolerance=0.0, max_sweeps=int(sweeps[w]) - every)
            assert sim.stats.numpy("residual")[w] >= 1e-4


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_no_impulse_solves_a_gap_that_stays_open(friction, backend):
    """Also without friction, where the cone of impulses is a ray."""
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    builder.add_box(builder.add_body((0.0, -0.5), type=dc.BodyType.STATIC), 5.0, 0.5, friction=friction)
    builder.add_disc(builder.add_body((0.0, 0.515)), 0.5, friction=friction)
    model, state, _ = builder.finalize("float64", backend=backend)
    sim = dc.Simulation(model, state, config=dc.SolverConfig(stop="residual"))
    sim.collide(1e-3)
    assert sim.contacts.numpy("contact_count")[0] == 1
    sim.solve()
    assert sim.stats.numpy("residual")[0] == 0.0
    assert not sim.contacts.numpy("impulse")[:1].any()


def test_residual_falls_to_round_off_and_is_relative_to_a_frictional_stop():
    """From zero impulses at contacts that all close, the natural map is of the order of its scale."""
    sim = settled()
    solve_from(sim, max_sweeps=0)
    begin = sim.stats.numpy("residual").copy()
    assert ((begin > 0.05) & (begin < 5)).all()
    solve_from(sim, tolerance=1e-14, max_sweeps=100_000, acceleration="none")
    assert (sim.stats.numpy("residual") < 1e-9).all()


def test_no_sweeps_leave_impulses_and_apply_them():
    """V = V* + M^-1 J^T lambda (Wu 2018, equation 2.26)."""
    sim = pile("general", "float64", seeds=(4,))
    sim.run(150, DT)
    sim.collide(DT)
    start = np.random.default_rng(0).uniform(0, 0.1, (len(used(sim)[0]), 2))
    impulse, _, solved = solve_from(sim, start, max_sweeps=0)
    assert (impulse == start).all()
    assert (sim.stats.numpy("sweeps") == 0).all()
    j, inverse, velocity, _, _ = dense(sim)
    np.testing.assert_allclose(solved.ravel(), velocity + inverse * (j.T @ start.ravel()), atol=1e-13)


@pytest.mark.parametrize("schedule", ["world", "color"])
def test_a_world_without_contacts_takes_no_sweeps(schedule):
    builder = dc.ModelBuilder()
    builder.add_world()  # empty
    builder.add_world()
    builder.add_discs([(0.0, 0.0), (5.0, 0.0)], 0.5)
    sim = dc.Simulation(*builder.finalize("float32"), schedule=schedule)
    sim.run(3, DT)
    assert (sim.stats.numpy("sweeps") == 0).all()
    assert not sim.stats.numpy("change").any()
    assert not sim.stats.numpy("residual").any()
    np.testing.assert_allclose(sim.state.numpy("velocity")[:, 1], -9.8 * 3 * DT, rtol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("time"), 3 * DT, rtol=1e-6)


# ---------------------------------------------------------------- start impulses


def test_every_start_ends_at_the_same_velocities():
    sim = pile("discs", "float64", seeds=(3,))
    sim.run(250, DT)
    sim.collide(DT)
    rng = np.random.default_rng(1)
    count = len(used(sim)[0])
    solution, _, expected = solve_from(sim, tolerance=1e-12, max_sweeps=500_000, acceleration="none")
    sweeps = sim.stats.numpy("sweeps")[0]
    starts = {
        "random": np.column_stack((rng.uniform(0, 5, count), rng.uniform(-2, 2, count))),
        "bad": np.full((count, 2), 50.0),
        "thousandfold": 1000 * solution,
        "negative": -solution,
    }
    for name, start in starts.items():
        impulse, _, solved = solve_from(sim, start)
        assert sim.stats.numpy("change")[0] < 1e-12, name
        check_laws(sim, impulse, solved, 1e-7)
        np.testing.assert_allclose(solved, expected, atol=1e-7, err_msg=name)
    _, _, solved = solve_from(sim, solution, tolerance=1e-6, min_sweeps=1)
    assert sim.stats.numpy("sweeps")[0] <= 3 < sweeps
    np.testing.assert_allclose(solved, expected, atol=1e-9)


def test_start_callable_writes_the_start():
    sim = pile("discs", seeds=(0,))
    seen = []

    def copy(sim):
        slots, _ = used(sim)
        sim.contacts.numpy("impulse")[slots] = 0.25
        seen.append(len(slots))

    sim.run(30, DT)
    sim.config = replace(sim.config, max_sweeps=0)
    sim.step(DT, start=copy)
    assert seen == [len(used(sim)[0])]
    assert (sim.contacts.numpy("impulse")[used(sim)[0]] == 0.25).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_that_is_not_finite_names_the_contact(value):
    sim = pile("discs", seeds=(0, 1))
    sim.run(60, DT)
    before = bits(sim)[:6]
    slots, world = used(sim)
    third = slots[world == 1][2]

    def start(sim):
        sim.contacts.numpy("impulse")[third, 1] = value

    with pytest.raises(ValueError, match=rf"contacts\.impulse\[{third}, 1\] \(contact 2 of world 1\)"):
        sim.step(DT, start=start)
    assert bits(sim)[:6] == before  # nothing was committed
    sim.step(DT)
    assert not sim.state.numpy("flags").any()


def test_cache_starts_from_the_step_before():
    warm, cold = (
        pile("discs", "float64", seeds=(4,), config=dc.SolverConfig(tolerance=1e-8, max_sweeps=20_000))
        for _ in range(2)
    )
    cold.config = replace(cold.config, start="zero")
    for sim in (warm, cold):
        sim.run(300, DT)
    assert warm.stats.numpy("sweeps")[0] < cold.stats.numpy("sweeps")[0]
    solution = warm.contacts.numpy("impulse")[used(warm)[0]].copy()
    keys = warm.contacts.numpy("key")[used(warm)[0]].copy()
    warm.collide(DT / 2)  # impulses follow the time step
    now = warm.contacts.numpy("key")[used(warm)[0]]
    common = np.isin(now, keys)
    assert common.any()
    expected = solution[np.searchsorted(keys, now[common])] / 2
    np.testing.assert_allclose(warm.contacts.numpy("impulse")[used(warm)[0]][common], expected, rtol=1e-12)
    cold.collide(DT)
    assert not cold.contacts.numpy("impulse")[used(cold)[0]].any()


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("method", "gauss"),
        ("acceleration", "anderson"),
        ("stop", "never"),
        ("start", "copy"),
        ("position_correction", "split"),
        ("max_sweeps", -1),
        ("tolerance", -1e-4),
        ("tolerance", float("nan")),
        ("residual_every", 0),
        ("omega", 0.0),
        ("omega", 2.5),
        ("aitken_period", 2),
        ("aitken_threshold", 0.0),
        ("aitken_cap", -1.0),
        ("position_iterations", -1),
        ("position_factor", 1.5),
        ("slop", float("nan")),
        ("max_correction", 0.0),
        ("speculative", -0.1),
        ("margin", -0.1),
        ("restitution_threshold", -1.0),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(ValueError, match=rf"SolverConfig\.{name} is"):
        dc.SolverConfig(**{name: value})


def test_settings_that_contradict_each_other():
    with pytest.raises(ValueError, match="aitken_period_max"):
        dc.SolverConfig(aitken_period=50)
    with pytest.raises(ValueError, match="omega"):
        dc.SolverConfig(method="jacobi", acceleration="sor", omega=1.4)


# ---------------------------------------------------------------- distance joints


def test_pendulum_keeps_length_and_period():
    """T = 2 pi sqrt(L / g) (1 + theta^2 / 16 + ...), the simple pendulum (Landau and Lifshitz I, 11)."""
    length, theta, dt = 2.0, 0.1, 0.002
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    anchor = builder.add_body((1.0, 3.0), type=dc.BodyType.STATIC)
    bob = builder.add_body((1.0 + length * np.sin(theta), 3.0 - length * np.cos(theta)), mass=0.7)
    builder.add_distance_joint(anchor, bob)
    sim = dc.Simulation(*builder.finalize("float64"))
    x, lengths = [], []

    def watch(sim):
        offset = sim.state.numpy("position")[bob] - sim.state.numpy("position")[anchor]
        x.append(offset[0])
        lengths.append(np.hypot(*offset))

    sim.run(6000, dt, callback=watch)
    assert np.abs(np.array(lengths) - length).max() < sim.config.slop * 1.0
    x = np.array(x)
    down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    crossing = down + x[down] / (x[down] - x[down + 1])
    period = np.diff(crossing).mean() * dt
    assert len(crossing) >= 4
    np.testing.assert_allclose(period, 2 * np.pi * np.sqrt(length / 9.8) * (1 + theta**2 / 16), rtol=2e-3)
    assert x[-1500:].max() > 0.95 * x[:1500].max()  # the swing lasts


def test_hanging_chain_carries_the_weights_below():
    """Statics: the force in a link is the weight of all that hangs below it."""
    masses = np.array([0.5, 2.0, 1.0, 3.0, 0.25])
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    last = builder.add_body((0.0, 0.0), type=dc.BodyType.STATIC)
    for k, mass in enumerate(masses):
        body = builder.add_body((0.0, -(k + 1.0)), mass=mass)
        builder.add_distance_joint(last, body)
        last = body
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(tolerance=1e-12, max_sweeps=20_000))
    sim.run(20, DT)
    loads = -sim.joints.numpy("joint_impulse") / DT
    np.testing.assert_allclose(loads, 9.8 * masses[::-1].cumsum()[::-1], rtol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("position")[:, 1], -np.arange(6.0), atol=1e-6)
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-8


def test_a_joint_pulls_and_pushes():
    """Two free masses flying apart, then towards each other, keep their distance and their common momentum."""
    builder = dc.ModelBuilder()
    for speed in (1.0, -1.0):
        builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
        a = builder.add_body((0.0, 0.0), velocity=(0.0, 0.0), mass=1.0)
        b = builder.add_body((1.0, 0.0), velocity=(speed, 0.0), mass=3.0)
        builder.add_distance_joint(a, b)
    config = dc.SolverConfig(tolerance=1e-14)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.run(10, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[:, 0], [0.75, 0.75, -0.75, -0.75], atol=1e-12)
    gap = np.diff(sim.state.numpy("position")[:, 0])[[0, 2]]
    np.testing.assert_allclose(gap, 1.0, atol=1e-12)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.step(DT)
    np.testing.assert_allclose(sim.joints.numpy("joint_impulse"), [-0.75, 0.75], atol=1e-12)
