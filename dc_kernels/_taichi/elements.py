"""Arrays of structs of numbers, such as ``stats.iteration``, read and written as the words of four bytes that they are.

Taichi has no type for memory in which integers and reals of a struct alternate, and must not see it as two arrays.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

from dc_kernels._taichi.groups import element_type
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.sources import define
from dc_kernels.model.dtypes import FLOATS, struct_dtype
from dc_kernels.model.fields import ITERATION

WORD = 4
TABLES = {"iteration": ITERATION}


@ti.func
def _low(value):
    return ti.bit_cast(ti.cast(value & ti.u64(0xFFFFFFFF), ti.u32), ti.i32)


@ti.func
def _high(value):
    return ti.bit_cast(ti.cast(value >> ti.u64(32), ti.u32), ti.i32)


@ti.func
def _joined(low, high):
    return (ti.cast(ti.bit_cast(high, ti.u32), ti.u64) << ti.u64(32)) | ti.cast(ti.bit_cast(low, ti.u32), ti.u64)


@cache
def element_functions(name: str, dtype: str) -> SimpleNamespace:
    """Functions ``load(words, i)``, the struct that stands at i, and ``store(words, i, value)``.

    Args:
        name: of the struct, "iteration".
        dtype: "float32" or "float64".
    """
    layout = struct_dtype(TABLES[name], FLOATS[dtype])
    loads, stores = [], []
    for field, (kind, offset, *_) in layout.fields.items():  # type: ignore[union-attr]
        scalar, count = kind.base.name, kind.shape[0] if kind.shape else 1
        if scalar not in ("int32", *FLOATS):
            raise TypeError(f"{name}.{field} has dtype {scalar}; words are read as int32, float32 and float64")
        step, parts = kind.base.itemsize // WORD, []
        for part in range(count):
            at = offset // WORD + part * step
            value = f"value.{field}[{part}]" if kind.shape else f"value.{field}"
            if scalar == "float64":
                parts.append(f"ti.bit_cast(joined(words[i, {at}], words[i, {at + 1}]), ti.f64)")
                stores += [f"words[i, {at}] = low(ti.bit_cast({value}, ti.u64))"]
                stores += [f"words[i, {at + 1}] = high(ti.bit_cast({value}, ti.u64))"]
            elif scalar == "float32":
                parts.append(f"ti.bit_cast(words[i, {at}], ti.f32)")
                stores.append(f"words[i, {at}] = ti.bit_cast({value}, ti.i32)")
            else:
                parts.append(f"words[i, {at}]")
                stores.append(f"words[i, {at}] = {value}")
        loads += [
            f"value.{field}[{k}] = {part}" if kind.shape else f"value.{field} = {part}" for k, part in enumerate(parts)
        ]
    scope: dict[str, Any] = {"ti": ti, "Element": element_type(dtype, name), "low": _low, "high": _high}
    scope |= {"joined": _joined}
    read = ["@ti.func", "def load(words: ti.template(), i):", "value = Element()", *loads, "return value"]
    write = ["@ti.func", "def store(words: ti.template(), i, value):", *stores]
    return SimpleNamespace(
        load=define("\n    ".join(read).replace("\n    def", "\ndef") + "\n", "load", dict(scope)),
        store=define("\n    ".join(write).replace("\n    def", "\ndef") + "\n", "store", dict(scope)),
    )
