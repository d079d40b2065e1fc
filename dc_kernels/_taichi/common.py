"""What the kernel files share: scalar types, rotations."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.runtime.compiler import ti


@cache
def scalar_types(dtype: str) -> SimpleNamespace:
    """Taichi's scalar, vec2, vec3, vec4 and vec8 types of "float32" or "float64"."""
    real = {"float32": ti.f32, "float64": ti.f64}[dtype]
    vectors = {f"vec{n}": ti.types.vector(n, real) for n in (2, 3, 4, 8)}
    return SimpleNamespace(real=real, **vectors)


@cache
def integer_types() -> dict:
    """Taichi's integers by the names that NumPy has for them."""
    return {"int32": ti.i32, "int64": ti.i64, "uint32": ti.u32, "uint64": ti.u64}


@ti.func
def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


@ti.func
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1]


@ti.func
def length(v):
    return ti.sqrt(v[0] * v[0] + v[1] * v[1])


@ti.func
def clamp(x, low, high):
    return ti.min(ti.max(low, x), high)


@ti.func
def rotate(c, s, v):
    """R v with R = [[c, -s], [s, c]]."""
    return ti.Vector([c * v[0] - s * v[1], s * v[0] + c * v[1]])


@ti.func
def rotate_back(c, s, v):
    """R^T v."""
    return ti.Vector([c * v[0] + s * v[1], c * v[1] - s * v[0]])


@ti.func
def tangent(n):
    """The normal turned by -90 degrees; without a zero that is negative, as Warp's ``-x`` is ``0 - x``."""
    return ti.Vector([n[1], 0.0 - n[0]])
