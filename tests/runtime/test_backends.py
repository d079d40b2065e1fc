"""The registry of backends: what is not there is refused, naming the backends that have it."""

import pytest

from dc_kernels.runtime.backends import BACKENDS, check_backend, has_kernels, host_threads, make_kernels


@pytest.mark.parametrize(
    ("backend", "path", "factory", "message"),
    [
        (
            "numpy",
            "grid.tiles",
            "kernels",
            r"'numpy', which has no kernels of grid.tiles; it must be one of \('warp', 'taichi'\)",
        ),
        (
            "numpy",
            "neighbors.search",
            "tree_kernels",
            r"'numpy', which has no tree_kernels of neighbors.search; it must be one of \('warp',\)",
        ),
        ("numpy", "no.such.file", "kernels", r"'numpy', which has no kernels of no.such.file; it must be one of \(\)"),
        ("nympy", "grid.tiles", "kernels", "backend is 'nympy'"),
    ],
)
def test_kernels_that_are_not_there_name_who_has_them(backend, path, factory, message):
    with pytest.raises(ValueError, match=message):
        make_kernels(backend, path, "float32", factory=factory)


def test_every_backend_is_known():
    for backend in BACKENDS:
        assert check_backend(backend) == backend
        assert has_kernels(backend, "solve.integrate", "kernels")
        assert not has_kernels(backend, "solve.integrate", "no_such_kernels")


def test_threads_are_the_hosts_or_the_backends_own():
    assert [host_threads(backend, 4) for backend in ("warp", "numpy", "taichi")] == [4, 4, 1]
