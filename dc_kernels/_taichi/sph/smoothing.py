"""The radial functions of ``dc_kernels.sph.smoothing``: w, f, g and k of each at vectors of q2 = q^2 <= 1."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.lanes import lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.sph.smoothing import COINCIDENT, GAUSSIAN_CUT, STENCILS

POLY6, SPIKY, GAUSSIAN, CUBIC, WENDLAND, BILINEAR, BSPLINE = STENCILS.values()
RATE = GAUSSIAN_CUT**2  # of exp(-RATE q^2 / 2)
TAYLOR = {"float32": 9, "float64": 17}  # degree of the polynomial of exp that errs below round-off


@cache
def radial_functions(dtype: str) -> SimpleNamespace:
    """``w``, ``f``, ``g`` and ``k``, each of the code of a smoothing kernel, known when it is compiled, and of q2."""
    vector = lane_functions(dtype).vector
    inverse = [1.0 / n for n in range(TAYLOR[dtype], 0, -1)]

    @ti.func
    def divisor(q):
        return ti.max(q, vector(COINCIDENT))

    @ti.func
    def apart(q, value):
        """What is singular where a neighbour lies at the place of the query, and counts as 0 there."""
        return ti.select(q < vector(COINCIDENT), vector(0.0), value)

    @ti.func
    def cone_w(q):
        """(1 - q)^3 for q > 0, which the outer part of the cubic spline is twice of."""
        t = 1.0 - q
        return t * t * t

    @ti.func
    def cone_f(q, p):
        t = 1.0 - q
        return -3.0 * t * t / p

    @ti.func
    def cone_g(q, p):
        t = 1.0 - q
        return 3.0 * t * (1.0 + q) / (p * p * p)

    @ti.func
    def cone_k(q2, p):
        return 3.0 * (q2 - 3.0) / (p * p * p * p * p)

    @ti.func
    def gaussian(q2):
        """exp(x), x in [-RATE / 2, 0], as the sixteenth power of a Taylor polynomial of exp(x / 16)."""
        x = q2 * (-RATE / 32.0)
        e = 1.0 + x * ti.static(inverse[0])
        for share in ti.static(inverse[1:]):
            e = 1.0 + e * (x * share)
        for _ in ti.static(range(4)):
            e = e * e
        return e

    @ti.func
    def w(kernel: ti.template(), q2):
        value = vector(0.0)
        if ti.static(kernel == POLY6):
            s = 1.0 - q2
            value = s * s * s
        elif ti.static(kernel == SPIKY):
            value = cone_w(ti.sqrt(q2))
        elif ti.static(kernel == GAUSSIAN):
            value = gaussian(q2)
        elif ti.static(kernel == CUBIC):
            q = ti.sqrt(q2)
            value = ti.select(q <= vector(0.5), 6.0 * q2 * (q - 1.0) + 1.0, 2.0 * cone_w(q))
        else:
            q = ti.sqrt(q2)
            t = 1.0 - q
            value = (t * t) * (t * t) * (1.0 + 4.0 * q)
        return value

    @ti.func
    def f(kernel: ti.template(), q2):
        value = vector(0.0)
        if ti.static(kernel == POLY6):
            s = 1.0 - q2
            value = -6.0 * s * s
        elif ti.static(kernel == SPIKY):
            q = ti.sqrt(q2)
            value = apart(q, cone_f(q, divisor(q)))
        elif ti.static(kernel == GAUSSIAN):
            value = gaussian(q2) * -RATE
        elif ti.static(kernel == CUBIC):
            q = ti.sqrt(q2)
            value = ti.select(q <= vector(0.5), 18.0 * q - 12.0, 2.0 * cone_f(q, divisor(q)))
        else:
            t = 1.0 - ti.sqrt(q2)
            value = -20.0 * t * t * t
        return value

    @ti.func
    def g(kernel: ti.template(), q2):
        value = vector(0.0)
        if ti.static(kernel == POLY6):
            value = 24.0 * (1.0 - q2)
        elif ti.static(kernel == SPIKY):
            q = ti.sqrt(q2)
            value = apart(q, cone_g(q, divisor(q)))
        elif ti.static(kernel == GAUSSIAN):
            value = gaussian(q2) * (RATE * RATE)
        elif ti.static(kernel == CUBIC):
            q = ti.sqrt(q2)
            p = divisor(q)
            value = apart(q, ti.select(q <= vector(0.5), 18.0 / p, 2.0 * cone_g(q, p)))
        else:
            q = ti.sqrt(q2)
            t = 1.0 - q
            value = apart(q, 60.0 * t * t / divisor(q))
        return value

    @ti.func
    def k(kernel: ti.template(), q2):
        value = vector(0.0)
        if ti.static(kernel == POLY6):
            value = vector(-48.0)
        elif ti.static(kernel == SPIKY):
            q = ti.sqrt(q2)
            value = apart(q, cone_k(q2, divisor(q)))
        elif ti.static(kernel == GAUSSIAN):
            value = gaussian(q2) * -(RATE * RATE * RATE)
        elif ti.static(kernel == CUBIC):
            q = ti.sqrt(q2)
            p = divisor(q)
            value = apart(q, ti.select(q <= vector(0.5), -18.0 / (p * p * p), 2.0 * cone_k(q2, p)))
        else:
            q = ti.sqrt(q2)
            t = 1.0 - q
            p = divisor(q)
            value = apart(q, -60.0 * t * (1.0 + q) / (p * p * p))
        return value

    return SimpleNamespace(w=w, f=f, g=g, k=k)
