"""SPH sums and their derivatives by Taichi's kernels: the bits of Warp's."""

import numpy as np
import pytest
import torch

from dc_kernels.runtime.backends import argument_names, make_kernels
from dc_kernels.sph.sums import sph_density
from dc_kernels.torch_ops.sph import sph_sum_torch

pytest.importorskip("taichi")
BACKENDS = ("warp", "taichi")
# all radial functions are met once: w, f and g of the sums, k and the Hessian of derivatives
CASES = [
    ("poly6", "value", "float32", 2),
    ("gaussian", "value", "float32", 3),
    ("spiky", "laplacian", "float32", 2),
    ("cubic", "laplacian", "float64", 3),
    ("wendland", "gradient", "float32", 3),
    ("cubic", "gradient", "float32", 2),
]


def test_kernels_have_the_names_and_arguments_of_warp() -> None:
    warp, taichi = (make_kernels(backend, "sph.sums", "float32") for backend in BACKENDS)
    assert {n: argument_names(k) for n, k in taichi.items()} == {n: argument_names(k) for n, k in warp.items()}


@pytest.mark.parametrize(("kernel", "quantity", "dtype", "dim"), CASES)
def test_sums_and_derivatives_have_the_bits_of_warp(kernel: str, quantity: str, dtype: str, dim: int) -> None:
    draw = np.random.default_rng(7)
    points = draw.uniform(0.0, 1.0, (300, dim)).astype(dtype)
    queries = np.concatenate([points[:5], draw.uniform(0.0, 1.0, (60, dim)).astype(dtype)])
    values, (mass, density) = draw.normal(size=(300, 2)).astype(dtype), draw.uniform(0.5, 1.0, (2, 300)).astype(dtype)
    found = []
    for backend in BACKENDS:
        given = [torch.from_numpy(a.copy()).requires_grad_() for a in (queries, points, values, mass, density)]
        # a query has more neighbours than are added up at once
        result = sph_sum_torch(*given, 0.4, kernel=kernel, quantity=quantity, backend=backend)
        by = torch.autograd.grad((result * result).sum(), given)
        found.append([tensor.detach().numpy().tobytes() for tensor in (result, *by)])
    assert [a == b for a, b in zip(*found, strict=True)] == [True] * 6


def test_density_does_not_depend_on_threads() -> None:
    points = np.random.default_rng(8).uniform(0.0, 1.0, (1200, 2)).astype(np.float32)
    mass = np.ones(1200, np.float32)
    one, two = (sph_density(points, mass, 0.1, backend="taichi", threads=threads) for threads in (1, 2))
    assert one.tobytes() == two.tobytes() == sph_density(points, mass, 0.1).tobytes()
