"""SPH sums as torch operators, differentiable by values, mass, density and all positions; needs the extra ``pipeline``.

Importing this module registers ``deep_contact::sph_sum`` and its adjoint with torch, so that autograd and
``torch.compile`` see one opaque operator each way; both directions run in the kernels of ``sph``. With the volume
V = m / rho, the cotangent y of the sum and S the sum over neighbours, the adjoint is again made of sums:

    B = S^T y           of values V B, and through V of mass and density
    x_q, x_p            pull_neighbors over the neighbours of the queries, and of the particles among the queries

so every result is written by one thread and the bits do not depend on the number of threads. It is the derivative of
the kernel functions at each distance: neighbours entering the support count as nothing, which is exact but for the
Gaussian, which jumps there by 3.4e-4 of its peak. A second derivative is not offered.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.settings import check_choice
from dc_kernels.neighbors.search import METHODS, Neighbors, neighbor_lists
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_array, check_positive
from dc_kernels.runtime.interop import tensor_array, tensor_integers
from dc_kernels.sph.quantities import PUBLIC, Quantity
from dc_kernels.sph.smoothing import KERNELS, scale
from dc_kernels.sph.sums import (
    check_options,
    check_particles,
    out_shape,
    pull_lists,
    sph_sum,
    sum_lists,
    volume,
)
from dc_kernels.torch_ops.tensors import check_devices, check_tensors, given_tensor

torch = require("torch", "pipeline")

_COMMON = (
    "Tensor queries, Tensor points, Tensor values, Tensor mass, Tensor density, Tensor? query_start, "
    "Tensor? point_start, float h, str kernel, str quantity, str method, int threads, str backend"
)


def sph_sum_torch(
    queries: Any,
    points: Any,
    values: Any,
    mass: Any,
    density: Any,
    h: float,
    *,
    kernel: str = "poly6",
    query_start: Any = None,
    point_start: Any = None,
    quantity: str = "value",
    method: str = "hash",
    threads: int = 1,
    backend: str = "warp",
) -> Any:
    """``sph.sph_sum`` of tensors, differentiable by the first five arguments.

    Args:
        queries: (nq, 2) or (nq, 3), contiguous on the CPU, float32 or float64, as all tensors here [m].
        points: (n, 2) or (n, 3) [m]; may be the queries themselves.
        values: (n, C), in any unit [u].
        mass: (n,), >= 0 [kg].
        density: (n,), > 0 [kg/m^dim].
        h: support radius, > 0 [m].
        kernel: a key of ``smoothing.KERNELS``.
        query_start: first query of each world and the number of queries, (W + 1,) integers; None for one world.
        point_start: first particle of each world and the number of particles.
        quantity: "value", "gradient" or "laplacian".
        method: method of the neighbour search (``neighbors.METHODS``).
        threads: Python threads that share the queries.
        backend: backend of the sums, as in ``sph``.

    Returns:
        (nq, C) [u] for "value", (nq, C, dim) [u/m] for "gradient", (nq, C) [u/m^2] for "laplacian".

    Raises:
        ValueError: an argument, which the error names, has another dtype, device or memory layout (nothing is copied),
            or is out of range.
    """
    starts = given_tensor("query_start", query_start), given_tensor("point_start", point_start)
    check_tensors(queries=queries, points=points, values=values, mass=mass, density=density)
    h, threads = check_positive("h", h), check_options(quantity, threads, backend)[1]
    check_choice("kernel", kernel, KERNELS)
    check_choice("method", method, METHODS)
    return torch.ops.deep_contact.sph_sum(
        queries, points, values, mass, density, *starts, h, kernel, quantity, method, threads, backend
    )


def sph_density_torch(
    points: Any,
    mass: Any,
    h: float,
    *,
    kernel: str = "poly6",
    start: Any = None,
    method: str = "hash",
    threads: int = 1,
    backend: str = "warp",
) -> Any:
    """``sph.sph_density`` of tensors, differentiable by points and mass: (n,) [kg/m^dim]; raises as ``sph_sum_torch``.

    Density of each particle by summation, itself included.
    """
    check_tensors(points=points, mass=mass)
    one = torch.ones_like(mass)
    return sph_sum_torch(
        points,
        points,
        one[:, None],
        mass,
        one,
        h,
        kernel=kernel,
        query_start=start,
        point_start=start,
        method=method,
        threads=threads,
        backend=backend,
    )[:, 0]


# ------------------------------------------------------------------ operators


class _Options(NamedTuple):
    """What ``_COMMON`` holds behind the five tensors of the particles."""

    query_start: Any
    point_start: Any
    h: float
    kernel: str
    quantity: str
    method: str
    threads: int
    backend: str

    def starts(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """First query and first particle of each world."""
        return tensor_integers("query_start", self.query_start), tensor_integers("point_start", self.point_start)


def _arrays(*tensors: Any) -> dict[str, np.ndarray]:
    """The five tensors by name, the same memory."""
    names = ("queries", "points", "values", "mass", "density")
    return {name: tensor_array(name, tensor) for name, tensor in zip(names, tensors)}


@torch.library.custom_op("deep_contact::sph_sum", mutates_args=(), schema=f"({_COMMON}) -> Tensor")
def _sum(queries: Any, points: Any, values: Any, mass: Any, density: Any, *rest: Any) -> Any:
    options = _Options(*rest)
    query_start, point_start = options.starts()
    arrays: dict[str, Any] = _arrays(queries, points, values, mass, density)
    settings = {name: getattr(options, name) for name in ("h", "kernel", "quantity", "method", "threads", "backend")}
    return torch.from_numpy(sph_sum(**arrays, query_start=query_start, point_start=point_start, **settings))


@_sum.register_fake
def _(queries: Any, points: Any, values: Any, *rest: Any) -> Any:
    check_devices(queries=queries, points=points, values=values, mass=rest[0], density=rest[1])
    return queries.new_empty(out_shape(PUBLIC[rest[6]], queries.shape[0], values.shape[1], points.shape[1]))


@torch.library.custom_op(
    "deep_contact::sph_sum_backward",
    mutates_args=(),
    schema=f"(Tensor cotangent, {_COMMON}, bool[] wanted) -> (Tensor, Tensor, Tensor, Tensor, Tensor)",
)
def _sum_backward(cotangent: Any, *inputs: Any) -> tuple[Any, ...]:
    """Cotangents of the five tensors; an empty one for each that is not wanted."""
    q, p, a, m, rho = _arrays(*inputs[:5]).values()
    options, wanted = _Options(*inputs[5:-1]), inputs[-1]
    h, kernel, threads = options.h, options.kernel, options.threads
    check_particles(q, p, a, m, rho)
    code = check_options(options.quantity, threads, options.backend)[0]
    # autograd hands over expanded tensors, such as the ones of a sum
    y = tensor_array("cotangent", cotangent.contiguous())
    check_array("cotangent", y, out_shape(code, len(q), a.shape[1], p.shape[1]), p.dtype)
    y = y.reshape(len(q), y.size // max(len(q), 1))
    starts = options.starts()
    cells = volume(m, rho)
    weighted = a * cells[:, None]
    want_q, want_p, want_a, want_m, want_rho = wanted

    def search(i: int) -> Neighbors:
        sides, first = ((q, p), starts) if i == 0 else ((p, q), starts[::-1])
        return neighbor_lists(
            *sides, h, method=options.method, query_start=first[0], point_start=first[1], threads=threads
        )

    # a sum over the queries themselves: who is near whom is symmetric, so one search serves both ways
    itself = q.shape == p.shape and q.ctypes.data == p.ctypes.data and _same(*starts)
    among_points: Any = search(0) if want_q or itself else None
    among_queries: Any = among_points if itself else (search(1) if any(wanted[1:]) else None)
    empty = np.empty(0, p.dtype)
    by_q = by_p = by_a = by_m = by_rho = empty
    way: dict[str, Any] = {"threads": threads, "backend": options.backend}
    if want_q:
        by_q = pull_lists(among_points, q, p, y, weighted, h, kernel, code, swapped=False, **way)
    if want_p:
        by_p = pull_lists(among_queries, p, q, weighted, y, h, kernel, code, swapped=True, **way)
    if want_a or want_m or want_rho:
        back = Quantity.DIVERGENCE if code == Quantity.GRADIENT else code
        factor = scale(kernel, h, p.shape[1], code.order, p.dtype)
        # grad W is odd: seen from the particle it has the other sign
        sign = -1.0 if code == Quantity.GRADIENT else 1.0
        unit = sum_lists(among_queries, p, q, y, h, sign * factor, kernel, back, **way)
        by_a = cells[:, None] * unit if want_a else empty
        by_volume = (a * unit).sum(axis=1)
        by_m = by_volume / rho if want_m else empty
        by_rho = -by_volume * cells / rho if want_rho else empty
    return tuple(torch.from_numpy(array) for array in (by_q, by_p, by_a, by_m, by_rho))


@_sum_backward.register_fake
def _(cotangent: Any, queries: Any, points: Any, values: Any, mass: Any, density: Any, *rest: Any) -> tuple[Any, ...]:
    tensors = (queries, points, values, mass, density)
    return tuple(t.new_empty(t.shape if wanted else (0,)) for t, wanted in zip(tensors, rest[-1]))


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    ctx.save_for_backward(*inputs[:7])
    ctx.options = inputs[7:]


def _backward(ctx: Any, cotangent: Any) -> tuple[Any, ...]:
    wanted = list(ctx.needs_input_grad[:5])
    by = torch.ops.deep_contact.sph_sum_backward(cotangent, *ctx.saved_tensors, *ctx.options, wanted)
    return *(gradient if want else None for gradient, want in zip(by, wanted)), *(None,) * 8


_sum.register_autograd(_backward, setup_context=_setup)


def _refuse_second(ctx: Any, *cotangents: Any) -> Any:
    raise NotImplementedError("a derivative of sph_sum_torch or sph_density_torch cannot be differentiated again")


_sum_backward.register_autograd(_refuse_second)


# ------------------------------------------------------------------ checks


def _same(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is b if a is None or b is None else np.array_equal(a, b)
