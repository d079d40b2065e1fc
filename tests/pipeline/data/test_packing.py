"""Chunks of a shard as plain h5py reads them, and their checksum."""

from __future__ import annotations

import io

import h5py
import hdf5plugin  # noqa: F401  (for h5py, which reads zstd with it)
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.data import layout, packing
from tests.pipeline.data.making import FILTERS, filters


def written(values: np.ndarray, axis: int, rows: int, compression: str) -> h5py.File:
    """A file of one dataset, packed by us."""
    column = layout.DatasetSpec(values.dtype, "1", "a test", values.shape[axis + 1 :], values.shape[:axis])
    packed = packing.pack(values, axis, rows, compression)
    image = packing.file_image({"group/data": packed}, {"group/data": column}, {})
    return h5py.File(io.BytesIO(image), "r")


@given(
    st.sampled_from(["f4", "f8", "i8", "i4", "u1"]),
    st.integers(0, 40),
    st.sampled_from([(0, ()), (0, (2,)), (1, (2,)), (0, (3, 2))]),
    st.integers(1, 17),
    st.integers(0, 2**32 - 1),
    st.sampled_from(sorted(FILTERS)),
)
def test_plain_h5py_reads_what_is_packed(dtype, rows, layout, chunk, seed, compression):
    axis, rest = layout
    shape = (3, rows, *rest) if axis else (rows, *rest)
    values = np.random.default_rng(seed).integers(0, 255, (*shape, np.dtype(dtype).itemsize), np.uint8)
    values = values.view(dtype)[..., 0] if rows else np.zeros(shape, dtype)
    with written(values, axis, chunk, compression) as file:
        data = file["group/data"]
        assert data[...].tobytes() == values.tobytes()
        assert not rows or filters(data) == FILTERS[compression]


@given(st.binary(min_size=2, max_size=2000))
def test_checksum_is_that_of_hdf5(data):
    with h5py.File("checksum", "w", driver="core", backing_store=False) as file:
        values = np.frombuffer(data, np.uint8)
        found = file.create_dataset("data", data=values, chunks=values.shape, fletcher32=True)
        file.flush()
        chunk = bytes(found.id.read_direct_chunk((0,))[1])
    assert chunk == data + packing.fletcher32(data)


def test_checksum_of_multiples_of_the_modulus():
    """65535 and 0 are one residue, but not one checksum."""
    for data in (b"\xff\xff" * 7, b"\x00\x00" * 7, b"\xff\xfe\x00\x01" * 65535, b"\x00"):
        test_checksum_is_that_of_hdf5.hypothesis.inner_test(data)
