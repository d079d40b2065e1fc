"""The arrays and numbers that the kernels of the SPH sums take in groups."""

from __future__ import annotations

from dc_kernels.model.fields import field_table

SUM = field_table(
    ("kernel", "launch", "int32", "1", "code of the smoothing kernel (``smoothing.KERNELS``)"),
    ("quantity", "launch", "int32", "1", "Quantity"),
    ("swapped", "launch", "int32", "1", "1: the queries are the particles of the sum, the neighbours its queries"),
    ("h", "launch", "real", "m", "support radius"),
    ("scale", "launch", "real", "1", "what each sum is multiplied with; its unit follows from the quantity"),
)

LISTS = field_table(
    ("start", "query+1", "int64", "1", "first entry of each query's list and the end of the last"),
    ("index", "entry", "int32", "1", "the neighbours"),
)
