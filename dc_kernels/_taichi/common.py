"""What the kernel files share: scalar types, rotations."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.runtime.compiler import ti


@cache
def scalar_types(dtype: str) -> SimpleNamespace:
    """Taichi's scalar, vec2 and vec4 types of "float32" or "float64"."""
    real = {"float32": ti.f32, "float64": ti.f64}[dtype]
    return SimpleNamespace(real=real, vec2=ti.types.vector(2, real), vec4=ti.types.vector(4, real))


@cache
def integer_types() -> dict:
    """Taichi's integers by the names that NumPy has for them."""
    return {"int32": ti.i32, "int64": ti.i64, "uint32": ti.u32, "uint64": ti.u64}


@ti.func
def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


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
    """The normal turned by -90 degrees."""
    return ti.Vector([n[1], -n[0]])
