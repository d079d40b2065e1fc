"""Smoothing kernels of SPH by name: W, its gradient and Laplacian, and their adjoints' needs (Wu 2018, section 3.2.2).

With q = r / h and the constant c_d of the dimension d a kernel is W(r) = c_d h^-d w(q), zero beyond the support radius
h. With D = (1/q) d/dq and the offset e = (x - x_p) / h every derivative follows from w, f = D w, g = D f and k = D g:

    grad W     = c_d h^-(d+1) f e
    Hessian W  = c_d h^-(d+2) (f I + g e e^T)
    lap W      = c_d h^-(d+2) (d f + q^2 g)
    grad lap W = c_d h^-(d+3) ((d + 2) g + q^2 k) e

In these terms W' = c_d h^-(d+1) f q, W'' = c_d h^-(d+2) (f + q^2 g) and lap W = W'' + (d-1) W'/r.

Where a derivative does not exist its value is 0, so nothing is ever infinite: what is singular at r = 0 counts as 0
for q < COINCIDENT (all derivatives of spiky, whose Laplacian grows as -1/r, and g and k of the cubic spline and of
Wendland C2). Poly6, spiky and the cubic spline have W'' or lap W that bend, but do not jump, at r = h.

The Gaussian has sigma = h / GAUSSIAN_CUT and keeps its constant for all of space, so what the cut takes off is
missing: of the integral of W 3.4e-4 in 2D and 1.1e-3 in 3D (GAUSSIAN_LOSS), and at r = h W falls to 0 from 3.4e-4 of
its peak.

Sources: poly6 and spiky: Mueller, Charypar and Gross 2003; spiky: Desbrun and Gascuel 1996; cubic spline: Monaghan and
Lattanzio 1985, scaled to the support h; Wendland C2: Wendland 1995. The constants of poly6 and spiky printed in
Wu (2018) are those of 3D; its Laplacian of poly6 (3.11) is twice too large, and that of spiky (3.14) lacks 2 W'/r.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.settings import check_choice, numeric
from dc_kernels.runtime.inputs import check_positive

KERNELS = {"poly6": 0, "spiky": 1, "gaussian": 2, "cubic": 3, "wendland": 4}
STENCILS = {**KERNELS, "bilinear": 5, "bspline": 6}
GAUSSIAN_CUT = 4.0  # a Gaussian of support h has sigma = h / GAUSSIAN_CUT
COINCIDENT = 1e-6  # q below which two points are at the same place
# part of the Gaussian's integral that lies beyond the cut, by dimension
GAUSSIAN_LOSS = {
    2: math.exp(-(GAUSSIAN_CUT**2) / 2),
    3: math.erfc(GAUSSIAN_CUT / math.sqrt(2))
    + math.sqrt(2 / math.pi) * GAUSSIAN_CUT * math.exp(-(GAUSSIAN_CUT**2) / 2),
}
_RATE = GAUSSIAN_CUT**2
_CONSTANTS = {
    "poly6": {2: 4 / math.pi, 3: 315 / (64 * math.pi)},
    "spiky": {2: 10 / math.pi, 3: 15 / math.pi},
    "gaussian": {2: _RATE / (2 * math.pi), 3: (_RATE / (2 * math.pi)) ** 1.5},
    "cubic": {2: 40 / (7 * math.pi), 3: 8 / math.pi},
    "wendland": {2: 7 / math.pi, 3: 21 / (2 * math.pi)},
}


class Radial(NamedTuple):
    """w and its derivatives by D = (1/q) d/dq, each of the shape of q and without unit."""

    w: np.ndarray
    f: np.ndarray
    g: np.ndarray
    k: np.ndarray


def check_kernel(kernel: str, dim: int) -> None:
    """Check the name of a kernel and a dimension.

    Raises:
        ValueError: for a name not in KERNELS, or a dimension other than 2 and 3.
    """
    check_choice("kernel", kernel, KERNELS)
    check_choice("dim", dim, (2, 3))


def constant(kernel: str, dim: int) -> float:
    """c_d of W(r) = c_d h^-d w(r / h) [1].

    Raises:
        ValueError: for an unknown kernel or dimension.
    """
    check_kernel(kernel, dim)
    return _CONSTANTS[kernel][dim]


def scale(kernel: str, h: Any, dim: int, order: int = 0, dtype: Any = np.float64) -> float:
    """c_d h^-(d + order), the factor of a kernel's derivatives of that order [1/m^(d + order)].

    Raises:
        ValueError: for an unknown kernel or dimension, or an h that is not finite and > 0 or whose factor leaves the
            range of the dtype.
    """
    h, limits = check_positive("h", h), np.finfo(dtype)
    exponent = math.log2(constant(kernel, dim)) - (dim + order) * math.log2(h)
    if not limits.minexp < exponent < limits.maxexp - 1:
        raise ValueError(f"h is {h!r} m; derivatives of order {order} of {kernel} in {dim}D leave {limits.dtype} there")
    return constant(kernel, dim) / h ** (dim + order)


def radial(kernel: str, q: Any) -> Radial:
    """w, f, g and k of a kernel at q = r / h; 0 beyond q = 1.

    Args:
        kernel: a key of KERNELS.
        q: distance over support radius, any shape; the sign does not matter [1].

    Raises:
        ValueError: for an unknown kernel, or the first q that is not finite.
    """
    check_kernel(kernel, 2)
    q = np.abs(_finite("q", q))
    p = np.where(q < COINCIDENT, 1.0, q)  # to divide by
    if kernel == "poly6":
        s = 1 - q * q
        w, f, g, k = s**3, -6 * s**2, 24 * s, np.full_like(q, -48.0)
    elif kernel == "spiky":
        w, f, g, k = _spiky(q, p)
        f = np.where(q < COINCIDENT, 0.0, f)
    elif kernel == "gaussian":
        w = np.exp(-_RATE * q * q / 2)
        f, g, k = -_RATE * w, _RATE**2 * w, -(_RATE**3) * w
    elif kernel == "cubic":
        inner = (6 * q**3 - 6 * q * q + 1, 18 * q - 12, 18 / p, -18 / p**3)
        w, f, g, k = (np.where(q <= 0.5, a, 2 * b) for a, b in zip(inner, _spiky(q, p)))
    else:
        t = 1 - q
        w, f, g, k = t**4 * (1 + 4 * q), -20 * t**3, 60 * t * t / p, -60 * t * (1 + q) / p**3
    if kernel in ("spiky", "cubic", "wendland"):
        g, k = (np.where(q < COINCIDENT, 0.0, a) for a in (g, k))
    return Radial(*(np.where(q <= 1, a, 0.0) for a in (w, f, g, k)))


def smoothing(kernel: str, r: Any, h: float, dim: int = 2) -> np.ndarray:
    """W at distances r: the shape of r [1/m^dim].

    Args:
        kernel: a key of KERNELS.
        r: distances, any shape; the sign does not matter [m].
        h: support radius, > 0 [m].
        dim: 2 or 3.

    Raises:
        ValueError: for an unknown kernel or dimension, an h out of range, or the first r that is not finite.
    """
    check_kernel(kernel, dim)
    factor, q = _scaled(kernel, r, h, dim, 0)
    return factor * radial(kernel, q).w


def smoothing_gradient(kernel: str, offset: Any, h: float) -> np.ndarray:
    """Gradient of W with respect to x at offsets x - x_p: (..., dim) [1/m^(dim+1)].

    Args:
        kernel: a key of KERNELS.
        offset: (..., dim) with dim 2 or 3 [m].
        h: support radius, > 0 [m].

    Raises:
        ValueError: as for ``smoothing``.
    """
    factor, e = _scaled(kernel, offset, h, None, 1)
    return factor * radial(kernel, np.linalg.norm(e, axis=-1)).f[..., None] * e


def smoothing_hessian(kernel: str, offset: Any, h: float) -> np.ndarray:
    """Second derivatives of W at offsets (..., dim): (..., dim, dim) [1/m^(dim+2)]; arguments as for the gradient."""
    factor, e = _scaled(kernel, offset, h, None, 2)
    v = radial(kernel, np.linalg.norm(e, axis=-1))
    outer = e[..., :, None] * e[..., None, :]
    return factor * (v.f[..., None, None] * np.eye(e.shape[-1]) + v.g[..., None, None] * outer)


def smoothing_laplacian(kernel: str, r: Any, h: float, dim: int = 2) -> np.ndarray:
    """Laplacian of W at distances r: the shape of r [1/m^(dim+2)]; arguments as for ``smoothing``."""
    check_kernel(kernel, dim)
    factor, q = _scaled(kernel, r, h, dim, 2)
    v = radial(kernel, q)
    return factor * (dim * v.f + q * q * v.g)


def smoothing_laplacian_gradient(kernel: str, offset: Any, h: float) -> np.ndarray:
    """Gradient of the Laplacian of W at offsets (..., dim): (..., dim) [1/m^(dim+3)]; arguments as for the gradient."""
    factor, e = _scaled(kernel, offset, h, None, 3)
    q = np.linalg.norm(e, axis=-1)
    v = radial(kernel, q)
    return factor * ((e.shape[-1] + 2) * v.g + q * q * v.k)[..., None] * e


def _spiky(q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
    """w, f, g, k of (1 - q)^3; p is q, or anything where q is too small to divide by."""
    t = 1 - q
    return t**3, -3 * t * t / p, 3 * t * (1 + q) / p**3, 3 * (q * q - 3) / p**5


def _scaled(kernel: str, lengths: Any, h: float, dim: int | None, order: int) -> tuple[float, np.ndarray]:
    """c_d h^-(d+order), and lengths over h; without a dimension they are vectors (..., dim)."""
    if dim is None:
        lengths = _finite("offset", lengths)
        if lengths.ndim == 0 or lengths.shape[-1] not in (2, 3):
            raise ValueError(f"offset has shape {lengths.shape}; it must be (..., 2) or (..., 3)")
        dim = lengths.shape[-1]
    else:
        check_kernel(kernel, dim)
        lengths = _finite("r", lengths)
    factor = scale(kernel, h, dim, order)
    # a distance of many supports may overflow: it is beyond any
    with np.errstate(over="ignore"):
        return factor, np.clip(lengths / h, -2.0, 2.0)


def _finite(name: str, values: Any) -> np.ndarray:
    """Values in float64.

    Raises:
        ValueError: naming the first that is not finite.
    """
    array = numeric(name, values).astype(np.float64)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = ", ".join(str(int(i)) for i in bad[0])
        raise ValueError(f"{name}{f'[{index}]' if index else ''} is {array[tuple(bad[0])]}; it must be finite")
    return array
