"""Sources are read once, and errors in them say where they are."""

import importlib

import numpy as np
import pytest

from dc_kernels.runtime.backends import bind

pytest.importorskip("taichi")

from dc_kernels._taichi.runtime import frontend
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.frontend import reading
from dc_kernels._taichi.runtime.kernels import kernel

pytestmark = pytest.mark.skipif(ti.__name__ != "taichi", reason="Quadrants does so itself")


@ti.func
def wrong(x):
    return x + unknown_number  # noqa: F821


@kernel
def uses_wrong(i, x: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    x[i] = wrong(x[i])


def test_an_error_names_the_line_of_a_source():
    with pytest.raises(ti.TaichiNameError) as caught:
        bind(uses_wrong, 1, {"x": np.zeros(1, np.float32)}, "cpu")
    assert f'{__file__}", line 22, in wrong:\n    return x + unknown_number' in str(caught.value)


def test_the_compiler_is_put_back_and_reads_a_source_once(monkeypatch):
    module, found = importlib.import_module("taichi.lang.kernel_impl"), []
    before = [getattr(owner, name) for owner, name, _ in frontend._replacements]
    assert len(before) == 3
    whole = module.getsourcelines
    monkeypatch.setattr(module, "getsourcelines", lambda function: found.append(function) or whole(function))
    monkeypatch.setattr(frontend, "_replacements", frontend._found())
    with reading():
        one, two = (module.getsourcelines(kernel) for _ in range(2))
    assert one is two and found == [kernel]
    monkeypatch.undo()
    with reading():
        pass
    assert [getattr(owner, name) for owner, name, _ in frontend._replacements] == before
