"""Smoothing kernels: moments, derivatives, and that the formulas printed in Wu (2018) are wrong as stated."""

import json
import math

import numpy as np
import pytest

from dc_kernels.sph.smoothing import (
    GAUSSIAN_CUT,
    GAUSSIAN_LOSS,
    KERNELS,
    constant,
    radial,
    scale,
    smoothing,
    smoothing_gradient,
    smoothing_hessian,
    smoothing_laplacian,
    smoothing_laplacian_gradient,
)

H = 0.7
DIMS = (2, 3)
every = pytest.mark.parametrize(("kernel", "dim"), [(kernel, dim) for kernel in KERNELS for dim in DIMS])


def shells(dim: int, h: float = H) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points in (0, h) and their weights times the area of a sphere; the cubic spline's pieces meet at h / 2."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    r = np.concatenate([h * (nodes + 1) / 4, h * (nodes + 3) / 4])
    return r, np.tile(weights * h / 4, 2) * (2 * np.pi * r if dim == 2 else 4 * np.pi * r * r)


def along_axis(r: np.ndarray, dim: int) -> np.ndarray:
    return np.pad(r[:, None], ((0, 0), (0, dim - 1)))


def moments(value, slope, laplacian, dim: int, h: float = H) -> np.ndarray:
    """Integrals of W, r . grad W, lap W and r^2 lap W, of functions of r."""
    r, area = shells(dim, h)
    return np.array([(area * f).sum() for f in (value(r), r * slope(r), laplacian(r), r * r * laplacian(r))])


def kernel_moments(kernel: str, dim: int, h: float = H) -> np.ndarray:
    return moments(
        lambda r: smoothing(kernel, r, h, dim),
        lambda r: smoothing_gradient(kernel, along_axis(r, dim), h)[:, 0],
        lambda r: smoothing_laplacian(kernel, r, h, dim),
        dim,
        h,
    )


def truncated_moments(dim: int) -> np.ndarray:
    """The same of the Gaussian inside r <= h, from integration by parts with W and W' at h."""
    a, inside = GAUSSIAN_CUT, 1.0 - GAUSSIAN_LOSS[dim]
    # W(h) h^dim times the area of the unit sphere; h W'(h) is -a^2 W(h)
    edge = (a * a / (2 * math.pi)) ** (dim / 2) * math.exp(-a * a / 2) * (2 * math.pi if dim == 2 else 4 * math.pi)
    slope, flux = edge - dim * inside, -a * a * edge
    return np.array([inside, slope, flux / H**2, flux - 2 * slope])


@every
def test_moments(kernel, dim):
    wanted = truncated_moments(dim) if kernel == "gaussian" else [1.0, -dim, 0.0, 2.0 * dim]
    np.testing.assert_allclose(kernel_moments(kernel, dim), wanted, atol=1e-11)


def test_the_gaussian_lacks_what_the_cut_takes():
    assert pytest.approx(3.35e-4, rel=2e-3) == GAUSSIAN_LOSS[2]
    assert pytest.approx(1.134e-3, rel=2e-3) == GAUSSIAN_LOSS[3]
    for dim in DIMS:
        assert smoothing("gaussian", H, H, dim) / smoothing("gaussian", 0.0, H, dim) == pytest.approx(3.35e-4, rel=2e-3)


@every
def test_derivatives_match_differences(kernel, dim):
    """Each derivative against central differences of the one before it, away from where they bend."""
    rng = np.random.default_rng(1)
    offset = rng.uniform(-H, H, (400, dim))
    q = np.linalg.norm(offset, axis=1) / H
    keep = (q > 0.1) & (q < 0.99) & (np.abs(q - 0.5) > 0.01)
    offset, step = offset[keep], 1e-5
    moved = step * np.eye(dim)

    def difference(function):
        """d/dx_k along the last axis."""
        return np.stack([(function(offset + m) - function(offset - m)) / (2 * step) for m in moved], axis=-1)

    def length(x):
        return np.linalg.norm(x, axis=-1)

    gradient = smoothing_gradient(kernel, offset, H)
    hessian = smoothing_hessian(kernel, offset, H)
    third = smoothing_laplacian_gradient(kernel, offset, H)
    for found, wanted in (
        (gradient, difference(lambda x: smoothing(kernel, length(x), H, dim))),
        (hessian, difference(lambda x: smoothing_gradient(kernel, x, H))),
        (third, difference(lambda x: smoothing_laplacian(kernel, length(x), H, dim))),
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(found).max(), rtol=1e-6)
    trace = np.trace(hessian, axis1=1, axis2=2)
    np.testing.assert_allclose(smoothing_laplacian(kernel, length(offset), H, dim), trace, atol=1e-9)


@every
def test_symmetry_positivity_and_support(kernel, dim):
    r = np.linspace(0.0, 1.5 * H, 301)
    value = smoothing(kernel, r, H, dim)
    np.testing.assert_array_equal(value, smoothing(kernel, -r, H, dim))
    assert (value[r < H] > 0).all()
    assert (np.diff(value) <= 0).all()
    offset = np.random.default_rng(2).uniform(-H, H, (100, dim))
    gradient = smoothing_gradient(kernel, offset, H)
    np.testing.assert_array_equal(gradient, -smoothing_gradient(kernel, -offset, H))
    assert ((gradient * offset).sum(axis=1) <= 0).all()
    beyond = np.array([H * (1 + 1e-12), 2 * H, 1e300])
    assert not smoothing(kernel, beyond, H, dim).any()
    assert not smoothing_gradient(kernel, along_axis(beyond, dim), H).any()
    assert not smoothing_laplacian(kernel, beyond, H, dim).any()


@every
def test_values_at_the_centre_and_the_edge(kernel, dim):
    """Closed forms at r = 0, continuity at h, and nothing that is not finite in between or next to 0."""
    peak = constant(kernel, dim) / H**dim
    assert smoothing(kernel, 0.0, H, dim) == pytest.approx(peak)
    curvature = {"poly6": -6, "spiky": 0, "gaussian": -(GAUSSIAN_CUT**2), "cubic": -12, "wendland": -20}[kernel]
    assert smoothing_laplacian(kernel, 0.0, H, dim) == pytest.approx(dim * curvature * peak / H**2)
    edge = [smoothing(kernel, H, H, dim), *smoothing_gradient(kernel, along_axis(np.array([H]), dim), H)[0]]
    edge.append(smoothing_laplacian(kernel, H, H, dim))
    limit = 0.08 * np.array([peak, *[peak / H] * dim, peak / H**2]) if kernel == "gaussian" else 1e-12
    assert (np.abs(edge) <= limit).all()
    tiny = along_axis(np.array([0.0, 5e-324, 1e-200, 1e-20, 1e-7, 1e-6, 1e-3]) * H, dim)
    for function in (smoothing_gradient, smoothing_hessian, smoothing_laplacian_gradient):
        assert np.isfinite(function(kernel, tiny, H)).all()
        assert not function(kernel, tiny[:1], H)[0].ravel()[1:dim].any()
    assert not smoothing_gradient(kernel, tiny[:1], H).any()
    assert not smoothing_laplacian_gradient(kernel, tiny[:1], H).any()


def test_the_seeds_printed_formulas_fail():
    """Equations 3.9-3.14 as printed: right in 3D but for the Laplacians, and wrong in 2D."""
    c9, c6 = math.pi * H**9, math.pi * H**6
    poly6 = moments(
        lambda r: 315 / (64 * c9) * (H * H - r * r) ** 3,
        lambda r: -945 / (32 * c9) * r * (H * H - r * r) ** 2,
        lambda r: -945 / (16 * c9) * (H * H - r * r) * (3 * H * H - 7 * r * r),
        3,
    )
    np.testing.assert_allclose(poly6, [1.0, -3.0, 0.0, 2 * 6.0], atol=1e-11)  # 3.11 is twice too large
    spiky = moments(
        lambda r: 15 / c6 * (H - r) ** 3,
        lambda r: -45 / c6 * (H - r) ** 2,
        lambda r: 90 / c6 * (H - r),
        3,
    )
    np.testing.assert_allclose(spiky[:2], [1.0, -3.0], atol=1e-11)
    np.testing.assert_allclose(spiky[2:], [30.0 / H**2, 12.0], rtol=1e-11)  # 3.14 holds W'' only
    # the constants of 3D in 2D
    r, area = shells(2)
    assert (area * 315 / (64 * c9) * (H * H - r * r) ** 3).sum() == pytest.approx(1.23046875 / H)
    assert (area * 15 / c6 * (H - r) ** 3).sum() == pytest.approx(1.5 / H)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: smoothing("poly", 0.1, H), r"kernel is 'poly'; it must be one of \('poly6', 'spiky'"),
        (lambda: smoothing("poly6", 0.1, H, 1), "dim is 1; it must be one of .2, 3."),
        (lambda: smoothing("poly6", 0.1, 0.0), r"h is 0.0; it must be finite and > 0"),
        (lambda: smoothing_laplacian("poly6", 0.1, math.inf), "h is inf; it must be finite"),
        (lambda: smoothing("poly6", 0.1, "0.5"), "h is '0.5'; it must be a number, finite"),
        (lambda: smoothing("poly6", [0.1, math.nan], H), r"r\[1\] is nan; it must be finite"),
        (lambda: smoothing_gradient("poly6", [[0.1, math.inf]], H), r"offset\[0, 1\] is inf"),
        (lambda: smoothing_gradient("poly6", [0.1], H), r"offset has shape \(1,\); it must be \(..., 2\)"),
        (lambda: radial("cubic", math.nan), "q is nan"),
        (lambda: smoothing_gradient("poly6", [1.0, 0.0], 1e-120), r"h is 1e-120 m; .* leave float64"),
        (lambda: scale("poly6", 1e-10, 2, 2, np.float32), r"derivatives of order 2 of poly6 in 2D leave float32"),
        (lambda: scale("poly6", 1e30, 2, 0, np.float32), "leave float32"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_command_figures(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    from pipeline.cli import main

    assert main(["figures", "kernels", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["path"] == str(tmp_path / "kernels.png")
    assert [path.name for path in tmp_path.iterdir()] == ["kernels.png"]
    assert (tmp_path / "kernels.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(SystemExit):
        main(["figures", "nothing"])
