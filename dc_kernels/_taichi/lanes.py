"""Vectors of eight neighbouring numbers, loaded from and stored to any place of an array of numbers.

Taichi loads a vector only from memory that is aligned to it, and as one number after the other elsewhere. LLVM joins
those to one load where it knows that their addresses follow each other: that no index overflows, as after ``MASK``,
which leaves it as it is. An array is taken by its flat index, as ``image[0, 0, 0, at]``.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.common import scalar_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.launches import MOST
from dc_kernels.solve.rows import LANES

MASK = MOST - 1


@cache
def lane_functions(dtype: str) -> SimpleNamespace:
    """The type ``vector``, and functions of vectors: ``iota``, ``fold``, ``total``, loads and stores.

    ``load(array, at)`` and ``store(array, at, vector)`` are of arrays of four axes, ``load_row``, ``store_row`` and
    ``load_line`` of arrays of two and of one, whose numbers may be any.
    """
    vector = ti.types.vector(LANES, scalar_types(dtype).real)

    @ti.func
    def iota():
        """Number of each lane."""
        return vector(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)

    @ti.func
    def fold(v):
        """Sum of the lanes by halves."""
        return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))

    @ti.func
    def total(v):
        """Sum of the lanes by pairs of neighbours."""
        return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]))

    @ti.func
    def load(array: ti.template(), first):
        at = first & MASK
        return vector(
            array[0, 0, 0, at],
            array[0, 0, 0, at + 1],
            array[0, 0, 0, at + 2],
            array[0, 0, 0, at + 3],
            array[0, 0, 0, at + 4],
            array[0, 0, 0, at + 5],
            array[0, 0, 0, at + 6],
            array[0, 0, 0, at + 7],
        )

    @ti.func
    def load_row(array: ti.template(), first):
        at = first & MASK
        return ti.Vector(
            [
                array[0, at],
                array[0, at + 1],
                array[0, at + 2],
                array[0, at + 3],
                array[0, at + 4],
                array[0, at + 5],
                array[0, at + 6],
                array[0, at + 7],
            ]
        )

    @ti.func
    def load_line(array: ti.template(), first):
        at = first & MASK
        return ti.Vector(
            [
                array[at],
                array[at + 1],
                array[at + 2],
                array[at + 3],
                array[at + 4],
                array[at + 5],
                array[at + 6],
                array[at + 7],
            ]
        )

    @ti.func
    def store(array: ti.template(), first, v):
        at = first & MASK
        for k in ti.static(range(LANES)):
            array[0, 0, 0, at + k] = v[k]

    @ti.func
    def store_row(array: ti.template(), first, v):
        at = first & MASK
        for k in ti.static(range(LANES)):
            array[0, at + k] = v[k]

    functions = (iota, fold, total, load, load_row, load_line, store, store_row)
    return SimpleNamespace(vector=vector, **{function.__name__: function for function in functions})
