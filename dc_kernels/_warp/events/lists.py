"""Lists of pairs of shapes, sorted by both: what the kernels of events share."""

import warp as wp

INTEGERS = wp.array(dtype=wp.int32)


@wp.func
def is_before(a: int, b: int, c: int, d: int):
    """Whether the pair (a, b) stands before the pair (c, d)."""
    return a < c or (a == c and b < d)


@wp.func_native("""
int other = 0;
for (int i = start; i < start + count; ++i) other |= (a.data[i] ^ c.data[i]) | (b.data[i] ^ d.data[i]);
return other == 0;
""")
def is_same(start: int, count: int, a: INTEGERS, b: INTEGERS, c: INTEGERS, d: INTEGERS) -> int: ...


@wp.func
def copy_pairs(start: int, count: int, from_a: INTEGERS, from_b: INTEGERS, to_a: INTEGERS, to_b: INTEGERS):
    """Copy a world's list to the slots of the same numbers."""
    for i in range(start, start + count):
        to_a[i] = from_a[i]
        to_b[i] = from_b[i]


@wp.func
def list_missing(
    start: int,
    count: int,
    of_a: INTEGERS,
    of_b: INTEGERS,
    known: int,
    in_a: INTEGERS,
    in_b: INTEGERS,
    to_a: INTEGERS,
    to_b: INTEGERS,
):
    """List the pairs of one list that are not in another one; how many there are."""
    n = start
    k = start
    same = bool(False)
    if count == known:  # as it mostly is
        same = is_same(start, count, of_a, of_b, in_a, in_b) == 1
    if same:
        return 0
    for i in range(start, start + count):
        while k < start + known and is_before(in_a[k], in_b[k], of_a[i], of_b[i]):
            k += 1
        if k == start + known or is_before(of_a[i], of_b[i], in_a[k], in_b[k]):
            to_a[n] = of_a[i]
            to_b[n] = of_b[i]
            n += 1
    return n - start
