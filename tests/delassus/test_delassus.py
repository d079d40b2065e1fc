"""Frictional contact problems in Delassus form: their maps, their solvers, and the way from and to a simulation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.delassus import METHODS, DelassusProblem, from_world, refine, solve
from dc_kernels.delassus.assemble import assemble_rows
from dc_kernels.delassus.first_order import delassus_kernels
from dc_kernels.delassus.lemke import PATCH, lemke, solve_patch
from dc_kernels.delassus.search import Search, SolveOptions
from dc_kernels.model.arrays import kernel_vectors, to_numpy
from dc_kernels.runtime.backends import argument_names, bind
from pipeline import scenes

FIRST_ORDER = [*METHODS]


def test_every_public_name_resolves():
    assert all(getattr(delassus, name) is not None for name in delassus.__all__)
    assert set(delassus.__all__) <= set(dir(delassus))
    with pytest.raises(AttributeError, match="no attribute 'slove'"):
        delassus.slove  # noqa: B018


def from_dense(w: Any, q: Any, mu: Any, **more: Any) -> DelassusProblem:
    """A problem with every block given."""
    w = np.asarray(w, float)
    n = len(w) // 2
    row, column = np.divmod(np.arange(4 * n * n), 2 * n)
    return DelassusProblem.from_compressed(w.ravel(), row, column, q, mu, layout="triplets", **more)


def simulated(scene: scenes.Scene, steps: int, dtype: str = "float64", **config: Any) -> dc.Simulation:
    """A scene after some steps, with the contacts of the next one found."""
    sim = dc.Simulation(*scene.build(1, 3).finalize(dtype), config=dc.SolverConfig(**config))
    sim.run(steps, 0.01)
    sim.collide(0.01)
    return sim


@pytest.fixture(scope="module")
def pile() -> DelassusProblem:
    """Some 50 discs falling on each other: impacts, sliding, sticking."""
    return from_world(simulated(scenes.Thesis(bodies=50), 90))


@pytest.fixture(scope="module")
def stack() -> DelassusProblem:
    """Ten boxes: W has rank 30 of 40."""
    return from_world(simulated(scenes.Stack(bodies=10), 20))


# ---------------------------------------------------------------------- the natural map


@pytest.mark.parametrize(
    ("r", "q", "mu", "defect"),
    [
        # W = 1: u = r + q; z = (r_n - u_n - mu |u_t|, r_t - u_t)
        ((1.0, 0.0), (-1.0, 0.0), 0.5, (0.0, 0.0)),  # rests
        ((0.0, 0.0), (1.0, 3.0), 0.5, (0.0, 0.0)),  # leaves
        ((1.0, -0.5), (-1.0, 2.0), 0.5, (0.0, 0.0)),  # slips: u = (0, 1.5)
        ((0.0, 0.0), (-2.0, 0.5), 0.5, (1.75, -0.5)),  # z = (1.75, -0.5), inside the cone
        ((0.0, 0.0), (-1.0, 2.0), 0.5, (0.8, -0.4)),  # z = (0, -2): the edge (1, -.5), of square 1.25, times 1 / 1.25
        ((2.0, 0.0), (1.0, 0.0), 0.5, (-2.0, 0.0)),  # z = (-1, 0): the apex
    ],
)
def test_natural_map_by_hand(r, q, mu, defect):
    problem = from_dense(np.eye(2), q, [mu])
    assert problem.natural_map(r) == pytest.approx(np.linalg.norm(defect) / np.linalg.norm(q), abs=1e-15)


def test_natural_map_without_q():
    problem = from_dense(np.eye(2), [0.0, 0.0], [0.3])
    assert problem.natural_map([0.0, 0.0]) == 0.0
    assert problem.natural_map([2.0, 0.0]) == 2.0  # not relative then
    assert solve(problem, start=[2.0, 0.1]).converged


def test_scaled_map_has_no_units(pile):
    draw = np.random.default_rng(0)
    r = draw.normal(size=(pile.count, 2))
    other = scaled_problem(pile, 1e6, 1e-4)
    assert other.scaled_map(r * 1e-10) == pytest.approx(pile.scaled_map(r), rel=1e-12)


def scaled_problem(problem: DelassusProblem, w: float, q: float) -> DelassusProblem:
    return DelassusProblem(
        row_start=problem.row_start,
        column=problem.column,
        block=problem.block * w,
        q=problem.q * q,
        mu=problem.mu,
        bilateral=problem.bilateral,
    )


# ---------------------------------------------------------------------- closed forms


def test_sliding_block():
    """One contact on a block of mass 2 pushed down and sideways: r_n = m v_n, r_t = -mu r_n."""
    problem = from_dense(np.eye(2) / 2.0, [-3.0, 4.0], [0.25])
    solution = solve(problem, tolerance=1e-14)
    np.testing.assert_allclose(solution.impulses, [[6.0, -1.5]], rtol=1e-13)


def test_coupled_contact():
    """W = [[2, 1], [1, 2]], q = (-1, -0.2), mu large: sticks, r = W^-1 (1, 0.2) = (0.6, -0.2)."""
    problem = from_dense([[2.0, 1.0], [1.0, 2.0]], [-1.0, -0.2], [5.0])
    np.testing.assert_allclose(solve(problem, tolerance=1e-13).impulses, [[0.6, -0.2]], rtol=1e-12)


def test_bilateral_row_pulls():
    """A joint between a contact and what pulls it up: (W r + q)_joint = 0 with a negative impulse."""
    w = np.diag([1.0, 1.0, 1.0, 0.0])
    w[0, 2] = w[2, 0] = 0.5
    problem = from_dense(w, [-1.0, 0.0, 2.0, 0.0], [0.5, 0.0], bilateral=np.array([False, True]))
    # r_0 + r_1 / 2 = 1, r_0 / 2 + r_1 = -2: r_0 = 8 / 3, r_1 = -10 / 3
    for method in (*FIRST_ORDER, "newton"):
        solution = solve(problem, method, tolerance=1e-10, every=1)
        np.testing.assert_allclose(solution.impulses, [[8 / 3, 0.0], [-10 / 3, 0.0]], atol=1e-8, err_msg=method)


# ---------------------------------------------------------------------- solvers


@pytest.mark.parametrize("method", [*FIRST_ORDER, "newton", "auto"])
def test_each_method_solves(method, pile):
    solution = solve(pile, method, tolerance=1e-8, max_sweeps=4000)
    assert solution.converged
    assert pile.natural_map(solution.impulses) == solution.residual <= 1e-8
    assert pile.scaled_map(solution.impulses) == solution.scaled_residual <= 1e-8
    normal, tangent = solution.impulses.T
    assert (normal >= 0.0).all() and (np.abs(tangent) <= pile.mu * normal * (1 + 1e-15)).all()


def test_accelerations_need_fewer_sweeps(pile):
    plain = solve(pile, "pgs", tolerance=1e-6, every=1).sweeps
    for method in ("aitken", "anderson", "hybrid"):
        assert solve(pile, method, tolerance=1e-6, every=1).sweeps < 0.6 * plain, method


@pytest.mark.parametrize("method", ["auto", "newton"])
def test_singular_matrix(method, stack):
    w = np.zeros((stack.count, 2, stack.count, 2))
    w[np.repeat(np.arange(stack.count), np.diff(stack.row_start)), :, stack.column] = stack.block
    w = w.reshape(2 * stack.count, -1)
    assert np.linalg.matrix_rank(w, tol=1e-9) == 30 and len(w) == 40
    noise = 1.0 + 1e-7 * np.random.default_rng(0).normal(size=w.shape)  # as a text file leaves it
    noisy = from_dense(w * noise, stack.q, stack.mu)
    for problem in (stack, noisy):
        assert solve(problem, method, tolerance=1e-10).converged


@pytest.mark.parametrize("name", ["pile", "stack"])
@pytest.mark.parametrize(("w", "q"), [(1e6, 1.0), (1e-6, 1.0), (1.0, 1e-6), (1e9, 1e-15)])
def test_units_do_not_matter(name, w, q, request):
    problem = request.getfixturevalue(name)
    usual, other = (solve(p, tolerance=1e-8) for p in (problem, scaled_problem(problem, w, q)))
    assert other.converged
    # powers of ten round, so that the ways differ in the last bits; the velocities are unique
    np.testing.assert_allclose(
        scaled_problem(problem, w, q).product(other.impulses) / q, problem.product(usual.impulses), atol=1e-6
    )


def random_problem(draw: np.random.Generator, contacts: int, bodies: int) -> DelassusProblem:
    """Contacts at random on few bodies of random masses, approaching; it has a solution since q = J v."""
    jacobian = np.zeros((contacts, 2, bodies, 3))
    for c in range(contacts):
        angle, pair = draw.uniform(0, 2 * np.pi), draw.permutation(bodies + 1)[:2]
        for sign, body in zip((1.0, -1.0), pair, strict=True):
            if body < bodies:  # the last one is the ground
                n = np.array([np.cos(angle), np.sin(angle)])
                arm = draw.normal(size=2)
                for k, d in enumerate((n, np.array([n[1], -n[0]]))):
                    jacobian[c, k, body] = sign * np.array([*d, arm[0] * d[1] - arm[1] * d[0]])
    flat = jacobian.reshape(2 * contacts, 3 * bodies)
    w = (flat * np.repeat(10.0 ** draw.uniform(-2, 2, bodies), 3)) @ flat.T
    return from_dense(w, flat @ draw.normal(size=3 * bodies), draw.choice([0.0, 0.1, 0.3, 0.6], contacts))


def test_hyperstatic_problems():
    """Up to twenty times as many contacts as bodies could need: singular, and far from unique."""
    draw = np.random.default_rng(5)
    for _ in range(25):
        bodies = int(draw.integers(1, 8))
        problem = random_problem(draw, int(draw.integers(bodies, 20 * bodies)), bodies)
        solution = solve(problem, tolerance=1e-8)
        assert solution.converged, (problem.count, bodies, solution.residual)


def test_pivots_are_exact(pile, stack):
    for problem in (pile, stack):
        assert max(problem.natural_maps(lemke(problem))) < 1e-9
    assert lemke(stack, max_pivots=3) is None


def test_patch_leaves_the_rest(pile):
    near = solve(pile, "pgs", tolerance=1e-12, max_sweeps=5000).impulses  # all that is wrong then lies in the patch
    wrong = near.copy()
    worst = int(np.argmax(near[:, 0]))
    wrong[worst] *= 1.5
    patched = solve_patch(pile, wrong)
    assert pile.scaled_map(patched) < 0.01 * pile.scaled_map(wrong)
    assert 1 < (patched != wrong).any(axis=1).sum() <= PATCH


def test_heavy_on_light():
    """A box of 1e4 times the weight on nine light ones: first-order methods stop far off, Newton does not."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    for i in range(10):
        body = builder.add_body(position=(0.02 * (i % 3), 0.5 + i))
        builder.add_box(body, 0.5, 0.5, density=1e4 if i == 9 else 1.0)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.collide(0.01)
    problem = from_world(sim)
    assert not solve(problem, "aitken", tolerance=1e-4, max_sweeps=3000).converged
    assert solve(problem, tolerance=1e-8).converged


def test_no_friction(pile):
    smooth = DelassusProblem(
        row_start=pile.row_start, column=pile.column, block=pile.block, q=pile.q, mu=np.zeros(pile.count)
    )
    for method in ("newton", "auto"):
        solution = solve(smooth, method, tolerance=1e-9)
        assert solution.converged and not solution.impulses[:, 1].any()


def test_what_has_no_solution_gives_the_best_found():
    """Two rows push the same body against each other with no friction: u_n = -1 in both whatever r is."""
    problem = from_dense([[1, 0, -1, 0], [0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1]], [-1.0, 0, -1.0, 0], [0.0, 0.0])
    solution = solve(problem, max_sweeps=2000)
    assert not solution.converged and np.isfinite(solution.impulses).all()
    assert solution.residual == problem.natural_map(solution.impulses) <= problem.natural_map(np.zeros(4))


@pytest.mark.parametrize("method", [*FIRST_ORDER, "newton", "auto"])
def test_start_is_not_made_worse(method, pile):
    good = solve(pile, tolerance=1e-10).impulses
    solution = solve(pile, method, tolerance=1e-16, max_sweeps=20, start=good)
    assert max(solution.residual, solution.scaled_residual) <= max(pile.natural_map(good), pile.scaled_map(good))
    assert solve(pile, method, tolerance=1e-8, start=good).sweeps == 0


def test_same_bits_again(pile):
    first, second = (solve(pile, "auto", tolerance=1e-11) for _ in range(2))
    np.testing.assert_array_equal(first.impulses, second.impulses)
    np.testing.assert_array_equal(first.history, second.history)


@pytest.mark.parametrize("method", ["anderson", "hybrid", "auto"])
def test_threads_solve_one_problem_at_once(method, pile):
    """Memory is lent from solve to solve: each thread has its own, and nothing of an earlier solve shows."""
    alone = solve(pile, method, tolerance=1e-9)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda tolerance: solve(pile, method, tolerance=tolerance), [1e-9, 1e-5] * 6))
    for solution in found[::2]:
        np.testing.assert_array_equal(solution.impulses, alone.impulses)
        np.testing.assert_array_equal(solution.history, alone.history)


def test_history_counts_sweeps(pile):
    solution = solve(pile, "pgs", tolerance=1e-5, every=7)
    assert (np.diff(solution.history[:, 0]) == 7).all() and solution.history[-1, 0] == solution.sweeps
    assert solution.history[-1, 1] == pytest.approx(solution.residual, rel=1e-6)


def test_float32_sweeps(pile):
    solution = solve(pile, "aitken", tolerance=1e-5, dtype="float32")
    assert solution.converged and solution.impulses.dtype == np.float64


def test_without_scipy(monkeypatch, stack):
    import sys

    for name in ("scipy", "scipy.sparse", "scipy.sparse.linalg"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match="scipy"):
        solve(stack, "newton")
    assert solve(stack, tolerance=1e-6).converged


def test_empty():
    problem = DelassusProblem(row_start=[0], column=[], block=np.zeros((0, 2, 2)), q=np.zeros((0, 2)), mu=[])
    assert solve(problem).converged and problem.natural_map([]) == 0.0


# ---------------------------------------------------------------------- the two backends


def test_backends_assemble_the_same_matrix():
    """Rows of few bodies, some of which nothing moves, against the product of matrices."""
    rng = np.random.default_rng(0)
    n, bodies = 40, 9
    body = np.stack([rng.integers(0, 4, n), rng.integers(4, bodies, n)], axis=1) + 100
    inverse = rng.uniform(0.1, 2.0, (bodies + 100, 3))
    inverse[[101, 106]] = 0.0
    jacobian = rng.normal(size=(n, 2, 2, 3))
    found = [assemble_rows(jacobian, body, inverse[body], backend) for backend in ("warp", "numpy")]
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])
    np.testing.assert_allclose(found[0][2], found[1][2], atol=1e-13)
    wide = np.zeros((2 * n, 3 * len(inverse)))
    for i, side in np.ndindex(n, 2):
        at = 3 * body[i, side]
        wide[2 * i : 2 * i + 2, at : at + 3] += jacobian[i, side]
    start, column, block = found[0]
    dense = np.zeros((2 * n, 2 * n))
    for i in range(n):
        assert (np.diff(column[start[i] : start[i + 1]]) > 0).all()
        for k in range(start[i], start[i + 1]):
            dense[2 * i : 2 * i + 2, 2 * column[k] : 2 * column[k] + 2] = block[k]
    np.testing.assert_allclose(dense, wide * inverse.ravel() @ wide.T, atol=1e-12)
    assert 0 < len(column) < n * n
    empty = assemble_rows(np.zeros((0, 2, 2, 3)), np.zeros((0, 2), int), np.zeros((0, 2, 3)), "warp")
    assert [len(array) for array in empty] == [1, 0, 0]


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_backends_have_the_same_kernels(dtype):
    warp, oracle = (delassus_kernels(backend, dtype) for backend in ("warp", "numpy"))
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name]), name


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("method", FIRST_ORDER)
def test_backends_agree(method, dtype, pile):
    sweeps = 90 if method == "hybrid" and dtype == "float64" else 25  # 60 and the sweeps without momentum
    ends = []
    for backend in ("warp", "numpy"):
        search = Search(
            pile,
            np.zeros((pile.count, 2)),
            SolveOptions(tolerance=1e-300, scaled=False, max_sweeps=10**6, every=3, dtype=dtype, backend=backend),
        )
        search.tolerance = 1e-30
        ends.append((search.sweep(method, sweeps), search.rows[0], search.best))
    bound = 1e-9 if dtype == "float64" else 2e-3
    for got, want in zip(*ends, strict=True):
        np.testing.assert_allclose(got, want, rtol=bound, atol=bound * pile.units[0])


def test_maps_of_the_kernels(pile):
    r = np.abs(np.random.default_rng(1).normal(size=(pile.count, 2)))
    impulse, speed = pile.units
    for backend in ("warp", "numpy"):
        maps = np.zeros((1, 2))
        values = {
            "scale": impulse / speed,
            "problem": pile.packed("float64", backend).struct,
            "impulse": kernel_vectors(r / impulse, backend),
            "maps": kernel_vectors(maps, backend),
        }
        bind(delassus_kernels(backend, "float64")["map_delassus"], 1, values, "cpu")()
        np.testing.assert_allclose(maps[0], [pile.natural_map(r), pile.scaled_map(r)], rtol=1e-12)


# ---------------------------------------------------------------------- from and to a simulation


SCENES = {
    "discs": (scenes.Thesis(bodies=40), 100, {}),
    "polygons": (scenes.Mixed(bodies=40), 110, {}),
    "bounce": (scenes.Mixed(bodies=40, restitution=0.5), 100, {}),
    "baumgarte": (scenes.Stack(bodies=4), 30, {"position_correction": "baumgarte"}),
    "joints": (scenes.Chain(bodies=6), 40, {}),
}


@pytest.mark.parametrize("name", list(SCENES))
def test_simulation_solves_the_same_problem(name):
    """The simulation's own solution solves the Delassus problem, and its velocities are W r + q less the bias."""
    scene, steps, config = SCENES[name]
    sim = simulated(scene, steps, tolerance=1e-12, max_sweeps=100_000, **config)
    problem = from_world(sim)
    sim.solve()
    assert problem.count > 5 and problem.bilateral.any() == (name == "joints")
    r = np.zeros((problem.count, 2))
    r[~problem.bilateral] = sim.contacts.numpy("impulse")[problem.slot[~problem.bilateral]]
    r[problem.bilateral, 0] = sim.joints.numpy("joint_impulse")[problem.slot[problem.bilateral]]
    assert problem.scaled_map(r) < 1e-7
    if name in ("discs", "polygons"):
        slots = problem.slot
        a, b = (sim.contacts.numpy(f"body_{x}")[slots] for x in "ab")
        arm_a, arm_b = (sim.contacts.numpy(f"arm_{x}")[slots] for x in "ab")
        v = sim.motion.numpy("solved")
        speed = [
            v[i, :2] + v[i, 2:3] * np.stack([-arm[:, 1], arm[:, 0]], axis=1) for i, arm in ((a, arm_a), (b, arm_b))
        ]
        n = sim.contacts.numpy("normal")[slots]
        tangent = np.stack([n[:, 1], -n[:, 0]], axis=1)
        relative = ((speed[1] - speed[0]) * tangent).sum(axis=1)
        np.testing.assert_allclose(problem.velocity(r)[:, 1], relative, atol=1e-11)


def test_open_gaps_of_bouncing_pairs_are_left_out():
    sim = simulated(scenes.Mixed(bodies=40, restitution=0.5), 100)
    problem = from_world(sim)
    assert problem.count < int(sim.contacts.numpy("contact_count")[0])
    assert np.abs(problem.q).max() < 1e3


def test_out_of_turn():
    sim = dc.Simulation(*scenes.Stack(bodies=2).build().finalize())
    with pytest.raises(ValueError, match="collide"):
        from_world(sim)
    with pytest.raises(ValueError, match="refine"):
        refine(sim, 1e-6)
    sim.collide(0.01)
    with pytest.raises(ValueError, match=r"world is 1; it must lie in \[0, 1\)"):
        from_world(sim, 1)
    sim.solve()
    with pytest.raises(ValueError, match="tolerance is -1"):
        refine(sim, -1)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_refine_takes_a_solve_further(dtype):
    sims = [simulated(scenes.Stack(bodies=12), 3, dtype, stop="change", max_sweeps=20, history=True) for _ in range(2)]
    for sim in sims:
        sim.solve()
    before = float(sims[0].stats.numpy("residual")[0])
    found = refine(sims[1], 1e-5)
    after = float(sims[1].stats.numpy("residual")[0])
    assert list(found) == [0] and found[0].converged and before > 1e-4
    assert after < (1e-4 if dtype == "float32" else 2e-5)
    assert sims[1].stats.numpy("sweeps")[0] == 20 + found[0].sweeps
    np.testing.assert_array_equal(to_numpy(sims[0].stats.history), to_numpy(sims[1].stats.history))
    # velocities follow: the step goes on with them, and what is cached are the refined impulses
    impulses = sims[1].contacts.numpy("impulse").copy()
    sims[1].advance()
    np.testing.assert_array_equal(sims[1].cache.numpy("impulse")[: len(impulses)], impulses)
    height = sims[1].state.numpy("velocity")[1:, 1]
    assert np.abs(height).max() < 1e-3  # a stack at rest


def test_refine_leaves_what_is_solved_and_undoes_what_is_worse(monkeypatch):
    sim = simulated(scenes.Stack(bodies=3), 5, tolerance=1e-12, max_sweeps=50_000)
    sim.solve()
    assert refine(sim, 1e-6) == {}
    from dc_kernels.delassus import world as delassus_world

    groups = dict.fromkeys(("residual", "sweeps", "iteration"), sim.stats)
    groups |= {"impulse": sim.contacts, "solved": sim.motion}
    kept = {name: group.numpy(name).copy() for name, group in groups.items()}
    true = delassus_world.solve

    def worse(problem, **options):
        solution = true(problem, **options)
        return type(solution)(**{**vars(solution), "impulses": solution.impulses + 1.0})

    monkeypatch.setattr(delassus_world, "solve", worse)
    assert list(refine(sim, 1e-30, max_sweeps=10)) == [0]
    for name, group in groups.items():
        np.testing.assert_array_equal(group.numpy(name), kept[name], err_msg=name)


# ---------------------------------------------------------------------- bad input

GOOD: dict[str, Any] = {
    "row_start": [0, 1, 2],
    "column": [0, 1],
    "block": np.stack([np.eye(2)] * 2),
    "q": np.zeros((2, 2)),
    "mu": [0.5, 0.5],
}


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("mu", [0.5, -0.1], r"mu\[1\] is -0.1; it must be not negative"),
        ("mu", [0.5, np.nan], r"mu\[1\] is nan; it must be finite"),
        ("q", np.full((2, 2), np.inf), r"q\[0, 0\] is inf"),
        ("q", np.zeros((3, 2)), r"q has shape \(3, 2\); it must be \(2, 2\)"),
        ("row_start", [0, 2, 1], r"row_start\[2\] is 1; it must be ascending"),
        ("row_start", [0, 1, 1], r"row_start\[2\] is 1; it must be 2, the length"),
        ("column", [0, 2], r"column\[1\] is 2; it must be in \[0, 2\)"),
        ("column", [0, 0], r"the normal diagonal of W\[1\] is 0.0; it must be > 0"),
        ("block", np.stack([np.eye(2), np.diag([-1.0, 1.0])]), r"the normal diagonal of W\[1\] is -1.0"),
        ("block", np.stack([np.eye(2), np.diag([1.0, 0.0])]), r"the tangential diagonal of W\[1\] is 0.0; .* where mu"),
        ("bilateral", [True], r"bilateral has shape \(1,\)"),
        ("bilateral", np.array([True, False]), r"mu\[0\] is 0.5; it must be 0 where bilateral"),
    ],
)
def test_bad_problem(name, value, message):
    DelassusProblem(**GOOD)
    with pytest.raises(ValueError, match=message):
        DelassusProblem(**{**GOOD, name: value})


def test_block_given_twice():
    with pytest.raises(ValueError, match=r"column\[1\] is 0 once more in row 0"):
        DelassusProblem(**{**GOOD, "row_start": [0, 2, 3], "column": [0, 0, 1], "block": np.stack([np.eye(2)] * 3)})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "pqs"}, "method is 'pqs'"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"max_sweeps": -1}, "max_sweeps is -1"),
        ({"every": 0}, "every is 0"),
        ({"omega": 2.0}, "omega is 2.0"),
        ({"dtype": "int8"}, "dtype is 'int8'"),
        ({"backend": "cuda"}, "backend is 'cuda'"),
        ({"start": [[0.0, 1.0]]}, "start has shape"),
        ({"start": np.full((2, 2), np.nan)}, r"start\[0, 0\] is nan"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(ValueError, match=message):
        solve(DelassusProblem(**GOOD), **options)


@pytest.mark.parametrize("layout", ["columns", "rows", "triplets"])
def test_layouts_agree(layout):
    sparse = pytest.importorskip("scipy.sparse")
    draw = np.random.default_rng(2)
    w = draw.normal(size=(6, 6)) * (draw.uniform(size=(6, 6)) < 0.6) + 8.0 * np.eye(6)
    made = {"columns": sparse.csc_matrix, "rows": sparse.csr_matrix, "triplets": sparse.coo_matrix}[layout](w)
    ends = made.col if layout == "triplets" else made.indptr
    indices = made.row if layout == "triplets" else made.indices
    q, r = draw.normal(size=6), draw.normal(size=6)
    problem = DelassusProblem.from_compressed(made.data, indices, ends, q, [0.5] * 3, layout=layout)
    np.testing.assert_allclose(problem.velocity(r).ravel(), w @ r + q, rtol=1e-13)


def test_a_problem_does_not_change_with_the_arrays_it_was_made_from():
    given = {name: np.array(values) for name, values in GOOD.items()}
    problem = DelassusProblem(**given)
    before = {name: getattr(problem, name).copy() for name in given}
    for name, array in given.items():
        assert not np.shares_memory(array, getattr(problem, name))
        array[...] = 7
        np.testing.assert_array_equal(getattr(problem, name), before[name])
        with pytest.raises(ValueError, match="read-only"):
            getattr(problem, name)[...] = 7


def test_bad_compressed():
    options = {"q": np.zeros(2), "mu": [0.5]}
    with pytest.raises(ValueError, match=r"indices\[1\] is 2; it must be in \[0, 2\)"):
        DelassusProblem.from_compressed([1.0, 1.0], [0, 2], [0, 1, 2], **options)
    with pytest.raises(ValueError, match=r"pointers\[2\] is 1; it must be 2, the length"):
        DelassusProblem.from_compressed([1.0, 1.0], [0, 1], [0, 1, 1], **options)
    with pytest.raises(ValueError, match="layout is 'dense'"):
        DelassusProblem.from_compressed([1.0], [0], [0], layout="dense", **options)
