"""What the kernel files share: scalar types, Warp modules with the right options, rotations."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

OPTIMIZATION: dict[str, int] = {}
"""Level from 0 to 3 that LLVM optimises modules of a scalar type at; Warp's own where the type is not there. The tests
set it: bits are the same on each level, and modules compile the faster the lower it is."""


@cache
def scalar_types(dtype: str) -> SimpleNamespace:
    """Warp's scalar, vec2 and vec4 types of "float32" or "float64"."""
    real = {"float32": wp.float32, "float64": wp.float64}[dtype]
    return SimpleNamespace(real=real, vec2=wp.types.vector(2, real), vec4=wp.types.vector(4, real))


def kernel_module(name: str, dtype: str, *variant: object) -> wp.Module:
    """The Warp module of a kernel file for one scalar type and variant.

    No adjoints, and no fused multiply-add: a sweep must give the same bits in SIMD lanes, in the scalar
    function and in either schedule (contraction off costs 0-15 % of a sweep, measured).
    """
    module = wp.get_module(".".join(["dc_kernels", name, dtype, *map(str, variant)]))
    level = OPTIMIZATION.get(dtype)
    module.options.update({"enable_backward": False, "fuse_fp": False, "optimization_level": level})
    return module


# read anew at each call, as another thread may set it; never on a GPU
@wp.func_native("""
#if !defined(__CUDA_ARCH__)
return address != 0 && __atomic_load_n((const int*)address, __ATOMIC_RELAXED) != 0;
#else
return 0;
#endif
""")
def is_set(address: wp.uint64) -> wp.int32: ...


# an index from memory: without it each access by it would ask whether it counts from the end
@wp.func_native("__builtin_assume(i >= 0); return i;")
def from_start(i: wp.int32) -> wp.int32: ...


@wp.func
def cross(a: Any, b: Any):
    return a[0] * b[1] - a[1] * b[0]


@wp.func
def rotate(c: Any, s: Any, v: Any):
    """R v with R = [[c, -s], [s, c]]."""
    return type(v)(c * v[0] - s * v[1], s * v[0] + c * v[1])


@wp.func
def rotate_back(c: Any, s: Any, v: Any):
    """R^T v."""
    return type(v)(c * v[0] + s * v[1], c * v[1] - s * v[0])


@wp.func
def tangent(n: Any):
    """The normal turned by -90 degrees."""
    return type(n)(n[1], -n[0])
