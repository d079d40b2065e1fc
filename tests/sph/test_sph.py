"""SPH sums against the oracle, double loops and closed forms, and their adjoints against differences."""

import numpy as np
import pytest

from dc_kernels.sph.smoothing import (
    KERNELS,
    smoothing,
    smoothing_gradient,
    smoothing_hessian,
    smoothing_laplacian,
    smoothing_laplacian_gradient,
)
from dc_kernels.sph.sums import CHUNK, PUBLIC, sph_density, sph_sum

H = 0.35
TOLERANCE = {"float32": 2e-6, "float64": 3e-15}
every = pytest.mark.parametrize("dim", [2, 3])


def particles(n, nq, dim, channels=3, dtype="float64", seed=0):
    """Queries, the first of them on particles, and particles with values, mass and density."""
    rng = np.random.default_rng(seed)
    points = rng.random((n, dim))
    queries = rng.uniform(-0.2, 1.2, (nq, dim))
    same = min(n, nq // 4)
    queries[:same] = points[:same]
    values, mass, density = rng.standard_normal((n, channels)), rng.uniform(0.5, 1, n), rng.uniform(1, 2, n)
    return [array.astype(dtype) for array in (queries, points, values, mass, density)]


def double_loop(queries, points, values, mass, density, h, kernel, quantity):
    """Equations 3.7 and 3.8 over all pairs, in float64."""
    queries, points, values = (array.astype(np.float64) for array in (queries, points, values))
    weighted = values * (mass.astype(np.float64) / density)[:, None]
    offset = queries[:, None] - points[None]
    r = np.linalg.norm(offset, axis=2)
    if quantity == "gradient":
        return np.einsum("pc,qpk->qck", weighted, smoothing_gradient(kernel, offset, h))
    function = smoothing if quantity == "value" else smoothing_laplacian
    return function(kernel, r, h, points.shape[1]) @ weighted


def close(found, wanted, dtype="float64", factor=1.0):
    np.testing.assert_allclose(
        found, wanted, rtol=0, atol=factor * TOLERANCE[dtype] * max(np.abs(wanted).max(), 1e-300)
    )


# ---------------------------------------------------------------------- sums


@every
@pytest.mark.parametrize("kernel", KERNELS)
def test_sums_are_those_of_a_double_loop_and_of_the_oracle(kernel, dim):
    for dtype in TOLERANCE:
        case = particles(150, 40, dim, dtype=dtype)
        for quantity in PUBLIC:
            wanted = double_loop(*case, H, kernel, quantity)
            for backend in ("warp", "numpy"):
                found = sph_sum(*case, H, kernel=kernel, quantity=quantity, backend=backend)
                assert found.dtype == dtype
                close(found, wanted, dtype, 4.0)


@every
def test_two_particles_have_the_closed_form(dim):
    """One particle of volume 0.5 and value 3 at a distance of 0.3 from the query, and one out of reach."""
    points = np.zeros((2, dim))
    points[0, 0], points[1, 0] = 1.3, 5.0
    query = np.eye(1, dim)
    rest = np.array([[3.0], [7.0]]), np.array([0.6, 1.0]), np.array([1.2, 1.0])
    for kernel in KERNELS:
        value, gradient, laplacian = (sph_sum(query, points, *rest, 0.5, kernel=kernel, quantity=q) for q in PUBLIC)
        assert value[0, 0] == pytest.approx(1.5 * smoothing(kernel, 0.3, 0.5, dim))
        np.testing.assert_allclose(gradient[0, 0], 1.5 * smoothing_gradient(kernel, -0.3 * np.eye(1, dim)[0], 0.5))
        assert gradient[0, 0, 0] > 0  # uphill to the particle
        assert laplacian[0, 0] == pytest.approx(1.5 * smoothing_laplacian(kernel, 0.3, 0.5, dim))
    own = sph_density(points, rest[1], 0.5)
    np.testing.assert_allclose(own, rest[1] * smoothing("poly6", 0.0, 0.5, dim))


@every
def test_a_lattice_reproduces_linear_fields_inside_and_loses_half_at_a_face(dim):
    """With h of 4 spacings a constant errs by up to 1.3e-3 (spiky 3.5e-2), a slope by 8e-3 (spiky 1.5e-2)."""
    h, side = 4.0, 11
    points = np.stack(np.meshgrid(*[np.arange(float(side))] * dim), axis=-1).reshape(-1, dim)
    middle = np.full((1, dim), 5.0)
    queries = np.concatenate([middle, middle + 0.31])
    slope = np.arange(1.0, dim + 1)
    values = np.stack([np.ones(len(points)), (points - middle) @ slope], axis=1)
    mass = density = np.full(len(points), 2.0)
    layer = points[points[:, 0] == 5.0]  # of the lattice, through the middle
    face = (points == [0.0, *[5.0] * (dim - 1)]).all(axis=1)
    for kernel in KERNELS:
        value, gradient = (
            sph_sum(queries, points, values, mass, density, h, kernel=kernel, quantity=quantity)
            for quantity in ("value", "gradient")
        )
        spiky = kernel == "spiky"
        np.testing.assert_allclose(value[:, 0], 1.0, atol=0.035 if spiky else 1.3e-3)
        np.testing.assert_allclose(value[0, 1], 0.0, atol=1e-12)  # by symmetry
        np.testing.assert_allclose(gradient[0, 0], 0.0, atol=1e-12)
        np.testing.assert_allclose(gradient[0, 1], slope, rtol=0.015 if spiky else 8e-3)
        # in the middle of a face one layer is whole and the others are halved
        whole = 2.0 * smoothing(kernel, np.linalg.norm(layer - middle, axis=1), h, dim).sum()
        found = sph_density(points, mass, h, kernel=kernel)
        assert found[face] == pytest.approx((whole + 2.0 * value[0, 0]) / 2)


def test_worlds_do_not_see_each_other():
    cases = [particles(n, nq, 2, seed=seed) for seed, (n, nq) in enumerate([(60, 20), (0, 5), (30, 0), (1, 3)])]
    flat = [np.concatenate(arrays) for arrays in zip(*cases)]
    starts = [np.cumsum([0, *(len(case[i]) for case in cases)]) for i in (0, 1)]
    for quantity in PUBLIC:
        together = sph_sum(*flat, H, quantity=quantity, query_start=starts[0], point_start=starts[1])
        alone = [sph_sum(*case, H, quantity=quantity) for case in cases]
        np.testing.assert_array_equal(together, np.concatenate(alone))
    assert not together[20:25].any()  # the world without particles
    density = sph_density(flat[1], flat[3], H, start=starts[1])
    np.testing.assert_array_equal(density, np.concatenate([sph_density(case[1], case[3], H) for case in cases]))


def test_bits_do_not_depend_on_threads_nor_methods():
    """A last chunk that is not full, lists longer than a block of the kernel, and more threads than chunks."""
    case = particles(3 * CHUNK, 3 * CHUNK + 7, 2, dtype="float32")
    for quantity in PUBLIC:
        one = sph_sum(*case, H, quantity=quantity)
        for options in ({"threads": 2}, {"threads": 5}, {"method": "all"}):
            np.testing.assert_array_equal(one, sph_sum(*case, H, quantity=quantity, **options))


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_nothing_is_a_sum_too(backend):
    for n, nq, channels in ((0, 5, 2), (5, 0, 2), (0, 0, 0), (5, 4, 0)):
        case = particles(n, nq, 3, channels)
        for quantity in PUBLIC:
            shape = (nq, channels, 3) if quantity == "gradient" else (nq, channels)
            found = sph_sum(*case, H, quantity=quantity, backend=backend)
            assert found.shape == shape
            assert not found.any() or n
    assert sph_density(np.zeros((0, 2)), np.zeros(0), H, backend=backend).shape == (0,)


def test_a_pair_at_exactly_the_support_counts_once_and_coincident_ones_stay_finite():
    points = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.0]], np.float32)
    one = np.ones(3, np.float32)
    for kernel in KERNELS:
        for quantity in PUBLIC:
            found = sph_sum(points, points, one[:, None], one, one, 0.5, kernel=kernel, quantity=quantity)
            assert np.isfinite(found).all()
            if quantity == "gradient":
                np.testing.assert_array_equal(found[0], found[2])
    edge = sph_sum(points[:1], points[1:2], one[:1, None], one[:1], one[:1], 0.5, kernel="gaussian")
    assert edge[0, 0] == pytest.approx(smoothing("gaussian", 0.5, 0.5, 2), rel=1e-5)


def bad(name, change):
    """Arguments with one of them changed."""
    named = dict(zip(("queries", "points", "values", "mass", "density"), particles(6, 4, 2)))
    named[name] = change(named[name])
    return named


def put(value, *index):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (bad("density", put(0.0, 2)), r"density\[2\] is 0.0; it must be finite and > 0"),
        (bad("mass", put(-1.0, 3)), r"mass\[3\] is -1.0; it must be finite and >= 0"),
        (bad("mass", put(np.nan, 1)), r"mass\[1\] is nan"),
        (bad("points", put(np.inf, 5, 1)), r"points\[5, 1\] is inf; it must be finite"),
        (bad("values", put(np.nan, 0, 2)), r"values\[0, 2\] is nan"),
        (bad("values", lambda a: a[:5]), r"values has shape \(5, 3\); it must be \(6, any\)"),
        (bad("mass", lambda a: a.astype(np.float32)), "mass has dtype float32; it must be float64"),
        (bad("queries", lambda a: a.astype(np.float16)), "queries has dtype float16; it must be float32 or float64"),
        (bad("queries", lambda a: np.zeros((4, 3))), "dtype and dimension must agree"),
        (
            bad("points", lambda a: np.asfortranarray(a)),
            r"points has strides \(8, 48\) for shape \(6, 2\); it must be contiguous",
        ),
        (bad("points", lambda a: a[:, :1].copy()), r"points has shape \(6, 1\); it must be \(n, 2\)"),
        (bad("values", lambda a: a.tolist()), "values is a list; it must be a numpy array"),
        (bad("density", put(1e-320, 4)), r"mass\[4\] / density\[4\]"),
        ({"h": -1.0}, "h is -1.0"),
        ({"kernel": "poly"}, "kernel is 'poly'"),
        ({"quantity": "divergence"}, "quantity is 'divergence'; it must be one of"),
        ({"threads": 0}, "threads is 0"),
        ({"backend": "torch"}, "backend is 'torch'"),
        ({"method": "grid"}, "method is 'grid'"),
        ({"query_start": [0, 3]}, "query_start"),
    ],
)
def test_bad_input_is_named(arguments, message):
    given = {**bad("mass", lambda a: a), "h": H, **arguments}
    with pytest.raises(ValueError, match=message):
        sph_sum(**given)


# ---------------------------------------------------------------------- adjoints


@pytest.fixture(scope="module")
def operators():
    pytest.importorskip("torch")
    from dc_kernels.torch_ops import sph as sph_operators

    return sph_operators


def smooth_case(dim, seed=0):
    """A few particles and queries, no pair near where a third derivative jumps, so that differences mean something.

    That is r = 0 and r = h, and r = h / 2 of the cubic spline (W of the Gaussian itself jumps at h).
    """
    rng = np.random.default_rng(seed)
    while True:
        both = rng.random((11, dim))
        i, j = np.triu_indices(len(both), 1)
        q = np.linalg.norm(both[i] - both[j], axis=1) / 0.6
        if (np.abs(q[:, None] - [0.0, 0.5, 1.0]) > 2e-3).all() and (q > 0.02).all():
            break
    rest = rng.standard_normal((7, 2)), rng.uniform(0.5, 1, 7), rng.uniform(0.5, 1, 7)
    return both[7:].copy(), both[:7].copy(), *rest


def tensors(case):
    import torch

    return [torch.tensor(array, requires_grad=True) for array in case]


@every
@pytest.mark.parametrize("quantity", PUBLIC)
def test_adjoints_match_differences(operators, quantity, dim):
    """By all five inputs; the second time the queries are the particles, which moves both ends of each pair."""
    import torch

    queries, *rest = tensors(smooth_case(dim))
    for kernel in KERNELS:

        def apart(queries, *rest, kernel=kernel):
            return operators.sph_sum_torch(queries, *rest, 0.6, kernel=kernel, quantity=quantity)

        def themselves(points, *rest, kernel=kernel):
            return operators.sph_sum_torch(points, points, *rest, 0.6, kernel=kernel, quantity=quantity)

        # along a direction of random numbers, which no wrong number of the Jacobian passes unseen
        assert torch.autograd.gradcheck(apart, (queries, *rest), rtol=1e-6, atol=1e-6, fast_mode=True)
        assert torch.autograd.gradcheck(themselves, tuple(rest), rtol=1e-6, atol=1e-6, fast_mode=True)


@every
def test_a_pair_pulls_by_the_next_derivative(operators, dim):
    """Closed form of the gradient by the query's position: grad W, the Hessian's rows, grad lap W."""
    offset = np.array([0.2, -0.1, 0.15])[:dim]
    for kernel in KERNELS:
        wanted = (
            smoothing_gradient(kernel, offset, H),
            smoothing_hessian(kernel, offset, H)[1],
            smoothing_laplacian_gradient(kernel, offset, H),
        )
        for quantity, expected in zip(PUBLIC, wanted):
            case = tensors([offset[None], np.zeros((1, dim)), np.full((1, 1), 3.0), np.ones(1), np.full(1, 2.0)])
            result = operators.sph_sum_torch(*case, H, kernel=kernel, quantity=quantity)
            result.reshape(-1)[1 if quantity == "gradient" else 0].backward()
            close(case[0].grad.numpy()[0], 1.5 * expected)
            close(case[1].grad.numpy()[0], -1.5 * expected)


def test_density_is_differentiable_and_threads_change_no_bit(operators):
    import torch

    _, points, _, mass, _ = tensors(smooth_case(2))

    def density(points, mass):
        return operators.sph_density_torch(points, mass, 0.6, kernel="wendland")

    assert torch.autograd.gradcheck(density, (points, mass))
    wanted = sph_density(points.detach().numpy(), mass.detach().numpy(), 0.6, kernel="wendland")
    np.testing.assert_array_equal(density(points, mass).detach(), wanted)
    gradients = []
    for threads in (1, 3):
        case = tensors(particles(2 * CHUNK + 3, 2 * CHUNK + 9, 2, dtype="float32"))
        starts = {"query_start": [0, 500, len(case[0])], "point_start": [0, 700, len(case[1])]}
        operators.sph_sum_torch(*case, 0.1, quantity="gradient", threads=threads, **starts).square().sum().backward()
        gradients.append([tensor.grad.numpy() for tensor in case])
    for one, three in zip(*gradients):
        assert one.any()
        np.testing.assert_array_equal(one, three)


def test_queries_that_are_the_particles_share_one_search_only_in_the_same_worlds(operators):
    """The search is shared when both are one tensor; a copy of it takes two and must agree."""
    for starts in ((None, None), ([0, 5, 7], [0, 5, 7]), ([0, 5, 7], [0, 2, 7])):
        _, *same = tensors(smooth_case(2))
        _, *other = tensors(smooth_case(2))
        queries = other[0].detach().clone().requires_grad_()
        options = {"query_start": starts[0], "point_start": starts[1], "quantity": "laplacian"}
        operators.sph_sum_torch(same[0], *same, 0.6, **options).square().sum().backward()
        operators.sph_sum_torch(queries, *other, 0.6, **options).square().sum().backward()
        other[0].grad += queries.grad
        for a, b in zip(same, other):
            close(a.grad.numpy(), b.grad.numpy(), factor=4.0)


def test_operators_keep_torchs_contract_and_compile(operators):
    import torch

    case = tensors(smooth_case(2))
    for quantity in ("value", "gradient"):
        arguments = (*case, None, None, 0.6, "poly6", quantity, "hash", 1, "warp")
        torch.library.opcheck(torch.ops.deep_contact.sph_sum.default, arguments)

    def loss(*tensors):
        return operators.sph_sum_torch(*tensors, 0.6, quantity="gradient").square().sum()

    loss(*case).backward()
    wanted = [tensor.grad.clone() for tensor in case]
    for backend in ("eager", "aot_eager"):  # neither needs a C++ compiler
        again = [tensor.detach().clone().requires_grad_() for tensor in case]
        torch.compile(loss, fullgraph=True, backend=backend)(*again).backward()
        for tensor, gradient in zip(again, wanted):
            assert torch.equal(tensor.grad, gradient)


def test_tensors_that_would_need_a_copy_are_refused(operators):
    import torch

    def refuse(message, index, change):
        case = [tensor.detach() for tensor in tensors(smooth_case(2))]
        case[index] = change(case[index])
        with pytest.raises(ValueError, match=message):
            operators.sph_sum_torch(*case, 0.6)

    refuse(r"points has strides \(1, 7\) for shape \(7, 2\); it must be contiguous", 1, lambda t: t.T.contiguous().T)
    refuse("values has dtype torch.bfloat16; it must be float32 or float64", 2, lambda t: t.bfloat16())
    refuse("mass has dtype float32; it must be float64", 3, lambda t: t.float())
    refuse(r"density\[1\] is -1.0", 4, lambda t: t.index_fill(0, torch.tensor([1]), -1.0))
    with pytest.raises(ValueError, match="queries is on"):
        operators.tensor_array("queries", torch.zeros(3, 2, device="meta"))
