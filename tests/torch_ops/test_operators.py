"""The torch operators: the bits of the host functions, gradients by gradcheck, shared memory, refusals, compilation."""

from __future__ import annotations

import math
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dc_kernels.grid import transfer
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.splat import TILED_BYTES, Splat
from dc_kernels.grid.stencil import Stencil
from dc_kernels.sph.smoothing import STENCILS

torch = pytest.importorskip("torch")
from dc_kernels.runtime import launches  # noqa: E402
from dc_kernels.torch_ops import transfer as operators  # noqa: E402
from dc_kernels.torch_ops.transfer import gather_torch, splat_torch  # noqa: E402

GRID = Grid(rows=5, columns=6, spacing=0.5, origin=(1.0, -2.0))
H = 0.9
START, BINS = [0, 4, 4, 7], [0, 1, 1, 0, 1, 0, 1]


def smooth_points() -> Any:
    """Seven points where splat and gather have derivatives in float64, two of them just beyond the grid.

    Central differences of step 1e-6 need a derivative on both sides. There is none on the lines between nodes
    (bilinear) and on the border (what is beyond is moved onto it), nor where a node lies at r = h (the Gaussian jumps)
    or at r = 0 (spiky); and where nodes are barely reached the ratio of their weights changes too fast.
    """
    offset = np.array([[0.3, 0.4], [2.37, 1.21], [4.13, 3.64], [3.4, -0.23], [1.66, 2.58], [5.21, 2.35], [2.71, 0.62]])
    far = np.linalg.norm(offset - np.stack(np.meshgrid(range(6), range(5)), axis=-1).reshape(-1, 1, 2), axis=-1)
    assert np.abs(offset - np.round(offset)).min() > 0.1
    assert np.abs(far - H / GRID.spacing).min() > 1e-3 and far.min() > 0.1
    assert (far.min(axis=0) < 0.8 * H / GRID.spacing).all()
    return torch.tensor(GRID.origin + offset * GRID.spacing, dtype=torch.float64)


def numbers(*shape: int, seed: int = 0, dtype: Any = torch.float64) -> Any:
    return torch.tensor(np.random.default_rng(seed).normal(size=shape), dtype=dtype)


def as_settings(points: Any, **options: Any) -> tuple[Any, ...]:
    """The trailing arguments of the raw operators."""
    given = {"kernel": "poly6", "start": None, "bins": 1, "point_bin": None, **options}
    stencil = Stencil(given["kernel"], h=H)
    return operators._settings(GRID, stencil, given["start"], given["bins"], given["point_bin"], 1)


# ---------------------------------------------------------------------- values


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("threads", [1, 2])
def test_operators_give_the_bits_of_the_host_functions(dtype, threads):
    points, values = smooth_points().to(dtype), numbers(7, 3, dtype=dtype)
    image = numbers(3, 6, 5, 6, seed=1, dtype=dtype)
    places, amounts = points.numpy(), values.numpy()
    for kernel in STENCILS:
        for nearest in (True, False):
            stencil = Stencil(kernel, h=0.3, nearest=nearest)
            options: dict[str, Any] = {"start": START, "bins": 2, "point_bin": BINS, "threads": threads}
            for normalize in ("particle", "sum"):
                options["stencil"] = replace(stencil, normalize=normalize)
                found = splat_torch(points, values, GRID, **options)
                np.testing.assert_array_equal(found.numpy(), transfer.splat(places, amounts, GRID, **options))
                found = gather_torch(image, points, GRID, **options)
                np.testing.assert_array_equal(found.numpy(), transfer.gather(image.numpy(), places, GRID, **options))
            options["stencil"] = replace(stencil, normalize="shepard")
            found = splat_torch(points, values, GRID, **options)
            np.testing.assert_array_equal(found.numpy(), transfer.splat(places, amounts, GRID, **options))
            options["stencil"] = stencil
            found = gather_torch(image, points, GRID, reverse=True, **options)
            expected = transfer.gather(image.numpy(), places, GRID, reverse=True, **options)
            np.testing.assert_array_equal(found.numpy(), expected)


@pytest.mark.parametrize(("backend", "threads"), [("warp", 1), ("warp", 2), ("taichi", 2)])
def test_large_images_go_by_tiles(backend, threads, monkeypatch):
    pytest.importorskip(backend)
    grid = Grid(rows=1100, columns=1100, spacing=0.01)
    assert 2 * 4 * grid.rows * grid.columns > TILED_BYTES
    draw = np.random.default_rng(0)
    points, values = (
        draw.uniform(-0.1, 11.1, (500, 2)).astype(np.float32),
        draw.normal(size=(500, 2)).astype(np.float32),
    )
    made = []
    monkeypatch.setattr(operators, "Splat", lambda *args, **options: made.append(Splat(*args, **options)) or made[-1])
    found = splat_torch(torch.from_numpy(points), torch.from_numpy(values), grid, threads=threads, backend=backend)
    assert [stage.tiled for stage in made] == [True]
    np.testing.assert_array_equal(found.numpy(), transfer.splat(points, values, grid))


def test_empty_input():
    none = torch.zeros(0, 2)
    assert splat_torch(none, torch.zeros(0, 3), GRID).shape == (1, 3, 5, 6)
    image = splat_torch(none, torch.zeros(0, 3), GRID, start=[0, 0, 0])
    assert image.shape == (2, 3, 5, 6) and not image.any()
    assert splat_torch(none, torch.zeros(0, 3), GRID, start=[0]).shape == (0, 3, 5, 6)
    assert gather_torch(image, none, GRID, start=[0, 0, 0]).shape == (0, 3)


# ---------------------------------------------------------------------- gradients


@pytest.mark.parametrize("kernel", STENCILS)
@pytest.mark.parametrize("normalize", ["particle", "sum", "shepard"])
def test_gradients_of_splat(kernel, normalize):
    options: dict[str, Any] = {"stencil": Stencil(kernel, h=H, normalize=normalize), "start": START}
    options.update(bins=2, point_bin=BINS)
    inputs = (smooth_points().requires_grad_(), numbers(7, 1).requires_grad_())
    bounds: dict[str, Any] = {"rtol": 1e-5, "atol": 1e-6, "fast_mode": True}  # along a random direction
    assert torch.autograd.gradcheck(lambda p, v: splat_torch(p, v, GRID, **options), inputs, **bounds)


@pytest.mark.parametrize("kernel", STENCILS)
@pytest.mark.parametrize("way", ["particle", "sum", "reverse"])
def test_gradients_of_gather(kernel, way):
    options: dict[str, Any] = {"start": START, "bins": 2, "point_bin": BINS, "reverse": way == "reverse"}
    options["stencil"] = Stencil(kernel, h=H, normalize="particle" if way == "reverse" else way)
    inputs = (numbers(3, 2, 5, 6).requires_grad_(), smooth_points().requires_grad_())
    bounds: dict[str, Any] = {"rtol": 1e-5, "atol": 1e-6, "fast_mode": True}  # along a random direction
    assert torch.autograd.gradcheck(lambda i, p: gather_torch(i, p, GRID, **options), inputs, **bounds)


def test_points_that_are_moved_onto_the_grid_have_no_gradient():
    """Along the coordinate that is clamped, or at all where the nearest node takes everything."""
    points = torch.tensor([[9.0, -1.3], [1.3, 40.0], [9.0, 9.0]], dtype=torch.float64, requires_grad=True)
    image = numbers(1, 2, 5, 6)
    gather_torch(image, points, GRID).sum().backward()
    assert ((points.grad != 0) == torch.tensor([[False, True], [True, False], [False, False]])).all()
    points.grad = None
    gather_torch(image, points, GRID, Stencil()).sum().backward()
    assert not points.grad.any()


@pytest.mark.parametrize("kernel", STENCILS)
def test_averages_over_sparse_points_have_finite_gradients(kernel):
    """Most nodes have weight 0 there: 0 / 0 must be masked in the derivative too."""
    points, values = smooth_points()[:1].float().requires_grad_(), torch.ones(1, 2, requires_grad=True)
    image = splat_torch(points, values, GRID, Stencil(kernel, h=0.6, normalize="shepard"))
    (image * torch.randn_like(image)).sum().backward()
    assert points.grad.isfinite().all() and values.grad.isfinite().all() and values.grad.any()
    field = torch.ones(1, 2, 5, 6, requires_grad=True)
    gather_torch(field, points, GRID, Stencil(kernel, h=0.6), reverse=True).square().sum().backward()
    assert points.grad.isfinite().all() and field.grad.isfinite().all()


def test_cotangents_of_any_layout():
    """Those of a sum are one number with strides 0."""
    points, values = smooth_points().requires_grad_(), numbers(7, 2).requires_grad_()
    splat_torch(points, values, GRID, Stencil(h=H)).sum().backward()
    torch.testing.assert_close(values.grad, torch.ones_like(values))  # what conserves the sum
    torch.testing.assert_close(points.grad, torch.zeros_like(points), rtol=0, atol=1e-12)
    weight = numbers(6, 5, 2, 1)
    image = splat_torch(points, values, GRID, Stencil(h=H))
    turned = torch.autograd.grad((image.permute(3, 2, 1, 0) * weight).sum(), (points, values))
    image = splat_torch(points, values, GRID, Stencil(h=H))
    plain = torch.autograd.grad((image * weight.permute(3, 2, 1, 0).contiguous()).sum(), (points, values))
    torch.testing.assert_close(turned, plain, rtol=0, atol=0)


def test_second_derivatives_by_values_exist_and_by_places_raise():
    points, values = smooth_points().requires_grad_(), numbers(7, 2).requires_grad_()
    image = splat_torch(points, values, GRID, Stencil(h=H))
    by_values, by_points = torch.autograd.grad(image.pow(3).sum(), (values, points), create_graph=True)
    assert torch.autograd.grad(by_values.sum(), values, retain_graph=True)[0].any()
    with pytest.raises(NotImplementedError, match=r"by points cannot be differentiated again; .*points.detach\(\)"):
        by_points.sum().backward()
    only = torch.autograd.gradgradcheck(
        lambda v: splat_torch(points.detach(), v, GRID, Stencil(h=H)).square(), (values,)
    )
    assert only


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_threads_do_not_change_a_bit_of_the_gradients(dtype):
    found = []
    for threads in (1, 2, 3):
        points, values = smooth_points().to(dtype).requires_grad_(), numbers(7, 2, dtype=dtype).requires_grad_()
        image = splat_torch(points, values, GRID, start=START, threads=threads)
        gather_torch(image, points, GRID, start=START, threads=threads).square().sum().backward()
        found.append((points.grad, values.grad))
    for other in found[1:]:
        torch.testing.assert_close(other, found[0], rtol=0, atol=0)


def test_calls_of_several_threads_do_not_mix():
    """Packed launches are reused: two calls under way must not share one."""
    inputs = [(numbers(2000, 2, seed=i) + 2.0, numbers(2000, 2, seed=10 + i)) for i in range(4)]
    alone = [splat_torch(*pair, GRID) for pair in inputs]
    with ThreadPoolExecutor(4) as pool:
        for i, found in enumerate(pool.map(lambda k: splat_torch(*inputs[k % 4], GRID), range(200))):
            torch.testing.assert_close(found, alone[i % 4], rtol=0, atol=0)


# ---------------------------------------------------------------------- memory


def test_kernels_read_and_write_the_tensors_own_memory(monkeypatch):
    seen: list[int] = []
    plain = launches.Bound.point

    def spy(self: Any, name: str, pointer: int, shape: tuple[int, ...]) -> None:
        seen.append(pointer)
        plain(self, name, pointer, shape)

    monkeypatch.setattr(launches.Bound, "point", spy)
    points, values = smooth_points(), numbers(7, 2)
    image = splat_torch(points, values, GRID)
    assert {tensor.data_ptr() for tensor in (points, values, image)} <= set(seen)
    seen.clear()
    back = gather_torch(image, points, GRID)
    assert {tensor.data_ptr() for tensor in (points, image, back)} <= set(seen)
    # a view of a larger tensor is read where it begins
    seen.clear()
    view = torch.cat([numbers(3, 2), points])[3:]
    torch.testing.assert_close(splat_torch(view, values, GRID), image, rtol=0, atol=0)
    assert view.data_ptr() in seen


def test_inputs_stay_and_results_have_memory_of_their_own():
    points, values, image = smooth_points(), numbers(7, 2), numbers(1, 2, 5, 6)
    before = [tensor.clone() for tensor in (points, values, image)]
    first = splat_torch(points, values, GRID, Stencil(normalize="shepard"))
    gather_torch(image, points, GRID, reverse=True)
    kept = first.clone()
    assert splat_torch(points, -values, GRID, Stencil(normalize="shepard")).data_ptr() != first.data_ptr()
    for tensor, old in zip((points, values, image, first), (*before, kept)):
        torch.testing.assert_close(tensor, old, rtol=0, atol=0)


def test_bad_tensors_are_refused_by_name():
    points, values, image = smooth_points(), numbers(7, 2), numbers(1, 2, 5, 6)
    bad = points.clone()
    bad[3, 0] = math.nan
    plain = Stencil(normalize="sum")
    for message, call in (
        (r"points\[3, 0\] is nan; it must be finite", lambda: splat_torch(bad, values, GRID)),
        (r"points\[3, 0\] is nan; it must be finite", lambda: gather_torch(image, bad, GRID)),
        (r"points has dtype torch.float16", lambda: splat_torch(points.half(), values.half(), GRID)),
        (r"points has shape \(7, 4\)", lambda: splat_torch(numbers(7, 4), values, GRID)),
        (r"points has strides .*; it must be contiguous", lambda: splat_torch(numbers(7, 4)[:, :2], values, GRID)),
        (r"points is on meta", lambda: operators._Call(points.to("meta"), as_settings(points))),
        (r"values has strides .*; it must be contiguous", lambda: splat_torch(points, numbers(2, 7).T, GRID)),
        (
            r"values has dtype torch.float32; points have torch.float64",
            lambda: splat_torch(points, values.float(), GRID),
        ),
        (r"values has dtype torch.int64", lambda: splat_torch(points, values.long(), GRID)),
        (r"values has shape \(6, 2\); it must be \(7, C\)", lambda: splat_torch(points, values[:6], GRID)),
        (r"values has shape \(7,\)", lambda: splat_torch(points, numbers(7), GRID)),
        (r"image has strides", lambda: gather_torch(numbers(1, 2, 6, 5).transpose(2, 3), points, GRID)),
        (
            r"image has shape \(1, 2, 6, 5\); it must be \(1, 1 C, 5, 6\)",
            lambda: gather_torch(numbers(1, 2, 6, 5), points, GRID),
        ),
        (r"image has shape \(1, 2, 6, 5\)", lambda: gather_torch(numbers(1, 2, 6, 5), points, GRID, reverse=True)),
        (r"image has dtype torch.float32", lambda: gather_torch(image.float(), points, GRID)),
        (
            r"start\[1\] is 6; it must be the number of points, 7",
            lambda: splat_torch(points, values, GRID, start=[0, 6]),
        ),
        (r"start is .*; it must be integers", lambda: splat_torch(points, values, GRID, start=[0.0, 7.0])),
        (r"point_bin\[0\] is 2", lambda: splat_torch(points, values, GRID, bins=2, point_bin=[2] * 7)),
        (r"kernel is 'cone'", lambda: splat_torch(points, values, GRID, Stencil("cone"))),
        (r"h is -1", lambda: splat_torch(points, values, GRID, Stencil(h=-1))),
        (
            r"reverse needs 'particle'",
            lambda: gather_torch(image, points, GRID, plain, reverse=True),
        ),
        (r"threads is 0", lambda: splat_torch(points, values, GRID, threads=0)),
        (r"bins is 0", lambda: splat_torch(points, values, GRID, bins=0)),
    ):
        with pytest.raises(ValueError, match=message):
            call()


# ---------------------------------------------------------------------- torch's own rules


@pytest.mark.parametrize("kernel", ["poly6", "bilinear"])
def test_operators_keep_torchs_rules(kernel):
    """Schemas, fake tensors, autograd registration and AOT dispatch, with static and dynamic shapes."""
    settings = as_settings(None, kernel=kernel, start=torch.tensor(START), bins=2, point_bin=torch.tensor(BINS))
    points, values, image = smooth_points(), numbers(7, 2), numbers(3, 4, 5, 6)
    ops = torch.ops.deep_contact
    torch.library.opcheck(ops.splat, (points.requires_grad_(), values.requires_grad_(), *settings))
    torch.library.opcheck(ops.gather, (image.requires_grad_(), points, *settings))
    fixed = [tensor.detach() for tensor in (image, points, values)]
    torch.library.opcheck(ops.gather_gradient, (*fixed, *settings))


def compilers() -> list[Any]:
    missing = not any(shutil.which(name) for name in ("g++", "clang++"))
    skip = pytest.mark.skipif(missing, reason="inductor needs a C++ compiler")
    return ["eager", "aot_eager", pytest.param("inductor", marks=(skip, pytest.mark.slow))]


@pytest.mark.parametrize("backend", compilers())
def test_compiled_functions_give_the_same(backend):
    """The whole graph with both directions: a splat, an average, and both gathers between pointwise operations."""

    def loss(points: Any, values: Any) -> Any:
        image = splat_torch(points, 2.0 * values, GRID, Stencil(h=H), start=start)
        image = image.tanh() + splat_torch(points, values, GRID, Stencil(h=H, normalize="shepard"), start=start)
        back = gather_torch(image, points, GRID, start=start)
        return (back * gather_torch(image, points, GRID, Stencil(h=H), reverse=True, start=start)).sum()

    start = torch.tensor(START)
    compiled = torch.compile(loss, backend=backend, fullgraph=True)
    found = []
    for function in (loss, compiled):
        inputs = (smooth_points().requires_grad_(), numbers(7, 2).requires_grad_())
        result = function(*inputs)
        result.backward()
        found.append((result.detach(), *(tensor.grad for tensor in inputs)))
    torch.testing.assert_close(found[1], found[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("normalize", ["particle", "shepard"])
@pytest.mark.parametrize("kernel", ["poly6", "bilinear"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_z_is_passed_over(kernel, normalize, dtype):
    """Values, images and derivatives by x and y have the bits of plane points; the derivative by z is 0."""
    stencil = Stencil(kernel, normalize=normalize) if kernel == "poly6" else Stencil(kernel)
    flat = smooth_points().to(dtype)
    deep = torch.cat([flat, torch.full((len(flat), 1), torch.nan, dtype=dtype)], 1)
    values = numbers(len(flat), 2, dtype=dtype)
    found = []
    for points in (flat.requires_grad_(), deep.requires_grad_()):
        image = splat_torch(points, values, GRID, stencil, start=START)
        back = gather_torch(image, points, GRID, Stencil("bilinear"), start=START)
        (back * values).sum().backward()
        found.append((image, back, points.grad[:, :2]))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)
    assert not deep.grad[:, 2].any()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_batch_is_as_many_worlds(dim):
    points, values = numbers(4, 9, dim).requires_grad_(), numbers(4, 9, 3).requires_grad_()
    start = torch.arange(5) * 9
    bins = torch.randint(0, 2, (4, 9), generator=torch.Generator().manual_seed(0))
    found = []
    for shape in ((4, 9), (36,)):
        given = {} if len(shape) == 2 else {"start": start}
        p, v, b = (tensor.reshape(*shape, *tensor.shape[2:]) for tensor in (points, values, bins))
        image = splat_torch(p, v, GRID, Stencil(h=H), bins=2, point_bin=b, **given)
        back = gather_torch(image, p, GRID, bins=2, point_bin=b, **given)
        assert image.shape[0] == 4 and back.shape == (*shape, 3)
        gradients = torch.autograd.grad(back.square().sum() + image.square().sum(), (points, values))
        found.append((image, back.reshape(36, 3), *gradients))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_a_batch_of_another_shape_is_refused():
    points, values = numbers(4, 9, 2), numbers(4, 9, 3)
    with pytest.raises(ValueError, match=r"values has shape \(36, 3\); it must be \(4, 9, C\), as points"):
        splat_torch(points, values.reshape(36, 3), GRID)
    with pytest.raises(ValueError, match=r"start must be None where points has shape \(4, 9, 2\)"):
        splat_torch(points, values, GRID, start=[0, 36])
    with pytest.raises(ValueError, match=r"point_bin has shape \(36,\); it must be \(4, 9\)"):
        splat_torch(points, values, GRID, bins=2, point_bin=torch.zeros(36, dtype=torch.int64))
    with pytest.raises(ValueError, match=r"points has strides .* for shape \(9, 4, 2\); it must be contiguous"):
        gather_torch(splat_torch(points, values, GRID), points.transpose(0, 1), GRID)
    with pytest.raises(ValueError, match=r"points has shape \(4, 4\); it must be \(n, 2\)"):
        splat_torch(numbers(4, 4), numbers(4, 1), GRID)
