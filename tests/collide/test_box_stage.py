"""A broadphase on anybody's boxes: the pairs of brute force, in the memory of its owner, and in a graph."""

import itertools

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc


def boxes(count, rng, dtype=np.float32, ratio=1e4, spread=5.0):
    """Lower and upper corners; the sizes of the boxes differ by the ratio."""
    size = np.exp(rng.uniform(-np.log(ratio), 0.0, (count, 1))) * rng.uniform(0.5, 2.0, (count, 2))
    lower = rng.uniform(-spread, spread, (count, 2)) - 0.5 * size
    return lower.astype(dtype), (lower + size).astype(dtype)


def brute(lower, upper, start=None, grow=0.0, keep=lambda a, b: True, static=None):
    """Every pair of boxes of a world that overlap when each is larger by ``grow`` on each side, sorted by (A, B)."""
    lower, upper = (lower - lower.dtype.type(grow)), (upper + upper.dtype.type(grow))
    found = []
    for first, last in itertools.pairwise(start) if start is not None else [(0, len(lower))]:
        world = []
        for a in range(first, last):
            near = (lower[a + 1 : last] <= upper[a]).all(axis=1) & (upper[a + 1 : last] >= lower[a]).all(axis=1)
            world += [(a, int(b)) for b in np.flatnonzero(near) + a + 1 if keep(a, int(b))]
        found += sorted((b, a) if static is not None and static[b] else (a, b) for a, b in world)
    return np.array(found, np.int32).reshape(-1, 2)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 120),
    st.sampled_from([1.0, 100.0, 1e4]),
    st.floats(0.01, 1e3),
    st.sampled_from([0.0, 0.05, 2.0]),
)
def test_the_pairs_are_those_of_brute_force(seed, count, ratio, spread, margin):
    rng = np.random.default_rng(seed)
    lower, upper = boxes(count, rng, ratio=ratio, spread=spread)
    start = np.sort(rng.integers(0, count + 1, 4))
    start[0], start[-1] = 0, count
    broadphase = dc.Broadphase(lower, upper, start, margin=margin)
    broadphase()
    np.testing.assert_array_equal(broadphase.numpy(), brute(lower, upper, start, margin))


@pytest.mark.parametrize("count", [1, 2, 300])
@pytest.mark.parametrize("kind", ["points", "one place", "far", "lines", "huge beside tiny"])
def test_odd_boxes(kind, count):
    rng = np.random.default_rng(count)
    lower, upper = boxes(count, rng)
    if kind == "points":
        lower[: count // 2] = np.repeat(lower[: count // 4], 2, axis=0)[: count // 2] if count > 4 else 0.0
        upper = lower.copy()
    elif kind == "one place":
        lower[:], upper[:] = 0.0, 0.0
    elif kind == "far":
        lower, upper = lower + np.float32(1e6), upper + np.float32(1e6)
    elif kind == "lines":
        upper[:, 1] = lower[:, 1] = np.round(lower[:, 1])
    else:
        lower[0], upper[0] = -1e30, 1e30
        lower[1:], upper[1:] = 1e-20 * lower[1:], 1e-20 * upper[1:]
    broadphase = dc.Broadphase(lower, upper)
    broadphase()
    np.testing.assert_array_equal(broadphase.numpy(), brute(lower, upper))


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pairs_are_kept_while_no_box_leaves_its_larger_one(dtype, backend):
    rng = np.random.default_rng(1)
    lower, upper = boxes(60, rng, dtype, ratio=10.0)
    start = [0, 20, 20, 60]
    broadphase = dc.Broadphase(lower, upper, start, margin=0.25, backend=backend, threads=2)
    assert broadphase() is broadphase.count
    first = broadphase.numpy()
    np.testing.assert_array_equal(first, brute(lower, upper, start, 0.25))
    lower += dtype(0.2)
    upper += dtype(0.2)
    broadphase()
    np.testing.assert_array_equal(broadphase.numpy(), first)
    np.testing.assert_array_equal(np.asarray(broadphase.rebuilds), [1, 1, 1])
    lower[30] -= dtype(0.5)  # leaves its box in the last world alone
    broadphase()
    np.testing.assert_array_equal(np.asarray(broadphase.rebuilds), [1, 1, 2])
    inner = broadphase.numpy()
    wanted = brute(lower, upper, start)
    assert {tuple(pair) for pair in wanted} <= {tuple(pair) for pair in inner}
    np.testing.assert_array_equal(inner[inner[:, 0] < 20], first[first[:, 0] < 20])


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_filters_hold_and_what_is_written_to_them_takes_effect(backend):
    rng = np.random.default_rng(2)
    lower, upper = boxes(80, rng, ratio=10.0)
    category = (1 << rng.integers(0, 3, 80)).astype(np.uint32)
    mask = rng.integers(0, 8, 80).astype(np.uint32)
    body = np.sort(rng.integers(0, 30, 80)).astype(np.int32)
    kind = rng.choice(list(dc.BodyType), 30).astype(np.int32)

    def keep(a, b):
        dynamic = dc.BodyType.DYNAMIC in (kind[body[a]], kind[body[b]])
        return body[a] != body[b] and dynamic and category[a] & mask[b] and category[b] & mask[a]

    filters = {"category": category, "mask": mask, "shape_body": body, "body_type": kind}
    broadphase = dc.Broadphase(lower, upper, margin=0.1, backend=backend, **filters)
    seen = set()
    for name in (None, *filters):
        if name == "mask":
            mask[:] = 7
        elif name == "category":
            category[5:20] ^= 1
        elif name == "shape_body":
            body[:] = np.arange(80) // 3
        elif name == "body_type":
            kind[:10] = dc.BodyType.DYNAMIC
        broadphase()
        wanted = brute(lower, upper, grow=0.1, keep=keep, static=(kind == dc.BodyType.STATIC)[body])
        np.testing.assert_array_equal(broadphase.numpy(), wanted)
        seen.add(wanted.tobytes())
    assert len(seen) == 5


@pytest.mark.parametrize("kind", ["torch", "warp", "dlpack"])
def test_memory_of_others_is_read_where_it_lies(kind):
    class Foreign:
        """Known by the protocol alone."""

        def __init__(self, array):
            self.__dlpack__, self.__dlpack_device__ = array.__dlpack__, array.__dlpack_device__

    given = {"torch": torch.from_numpy, "warp": lambda a: wp.array(a, dtype=wp.vec2, copy=False), "dlpack": Foreign}
    lower, upper = boxes(100, np.random.default_rng(3))
    mask = np.full(100, 1, np.int32).view(np.uint32)
    broadphase = dc.Broadphase(given[kind](lower), given[kind](upper), mask=mask)
    for _ in range(2):
        lower -= np.float32(0.3)
        mask[:30] = 0
        broadphase()
        wanted = brute(lower, upper, keep=lambda a, b: mask[a] and mask[b])
        np.testing.assert_array_equal(broadphase.numpy(), wanted)


def test_threads_and_other_worlds_do_not_change_the_pairs():
    rng = np.random.default_rng(4)
    lower, upper = boxes(900, rng)
    start = np.array([0, 0, 400, 401, 700, 900])
    broadphases = [dc.Broadphase(lower, upper, start, threads=threads) for threads in (1, 3, 8)]
    for broadphase in broadphases:
        broadphase()
        np.testing.assert_array_equal(broadphase.numpy(), broadphases[0].numpy())
    alone = dc.Broadphase(lower[400:].copy(), upper[400:].copy(), start[2:] - 400)
    alone()
    pairs = broadphases[0].numpy()
    np.testing.assert_array_equal(alone.numpy(), pairs[pairs[:, 0] >= 400] - 400)


def test_room_grows_or_the_lack_of_it_is_an_error():
    lower, upper = boxes(100, np.random.default_rng(5))
    upper[:60] += np.float32(20.0)
    start = [0, 50, 100]
    wanted = brute(lower, upper, start)
    broadphase = dc.Broadphase(lower, upper, start)
    before, left = broadphase.layout_version, np.asarray(broadphase.count)
    broadphase()
    np.testing.assert_array_equal(left, -1)
    np.testing.assert_array_equal(broadphase.numpy(), wanted)
    assert broadphase.layout_version > before
    counts = np.bincount(wanted[:, 0] // 50)
    exact = dc.Broadphase(lower, upper, start, max_pairs=counts)
    exact()
    np.testing.assert_array_equal(exact.numpy(), wanted)
    counts[0] -= 1
    short = dc.Broadphase(lower, upper, start, max_pairs=counts)
    with pytest.raises(OverflowError, match=rf"world 0 has {counts[0] + 1} pairs; max_pairs is {counts[0]}"):
        short()
    np.testing.assert_array_equal(short.numpy(), wanted[wanted[:, 0] >= 50])


def test_a_broadphase_becomes_part_of_a_graph():
    lower, upper = boxes(100, np.random.default_rng(6))
    moved = lower.copy(), upper.copy()
    broadphase = dc.Broadphase(lower, upper, margin=0.05, max_pairs=3000, threads=2)
    with wp.ScopedCapture(device="cpu") as capture:
        broadphase()
    for shift in (0.0, 1.0, 3.0):
        for array, base in zip((lower, upper), moved):
            array[:] = base
            array[::2] += np.float32(shift)
        wp.capture_launch(capture.graph)
        broadphase.check()
        np.testing.assert_array_equal(broadphase.numpy(), brute(lower, upper, grow=0.05))
    upper += np.float32(30.0)
    wp.capture_launch(capture.graph)
    with pytest.raises(OverflowError, match=r"world 0 has \d+ pairs; max_pairs is 3000"):
        broadphase.check()
    assert len(broadphase.numpy()) == 0
    upper[3, 0] = np.nan
    wp.capture_launch(capture.graph)
    with pytest.raises(ValueError, match=r"upper\[3, 0\] is nan; it must be finite"):
        broadphase.check()


def test_bad_input_is_named():
    good = np.zeros((4, 2), np.float32)
    nan, high = good.copy(), good.copy()
    nan[2, 1], high[3, 0] = np.nan, 1.0
    for arguments, options, message in (
        ((np.zeros((4, 3), np.float32), good), {}, r"lower has shape \(4, 3\); it must be \(any, 2\)"),
        ((good, np.zeros((3, 2), np.float32)), {}, r"upper has shape \(3, 2\); it must be \(4, 2\)"),
        ((good, np.zeros((4, 2))), {}, r"upper has dtype float64; it must be float32"),
        ((good[::2], good), {}, r"lower has strides"),
        (([0.0], good), {}, r"lower is a list"),
        ((torch.zeros(4, 2, requires_grad=True), good), {}, r"lower requires a gradient"),
        ((nan, good), {}, r"lower\[2, 1\] is nan; it must be finite"),
        ((high, good), {}, r"lower\[3, 0\] is 1.0; it must not exceed upper, 0.0"),
        ((good, good, [0, 5]), {}, r"start\[1\] is 5; it must be the number of boxes, 4"),
        ((good, good), {"margin": -0.1}, r"margin is -0.1; it must be finite and >= 0"),
        ((good, good), {"margin": "wide"}, r"margin is 'wide'; it must be a number"),
        ((good, good), {"max_pairs": [1, 2]}, r"max_pairs has shape \(2,\)"),
        ((good, good), {"category": np.zeros(4, np.int32)}, r"category has dtype int32; it must be uint32"),
        ((good, good), {"mask": np.zeros(3, np.uint32)}, r"mask has shape \(3,\); it must be \(4,\)"),
        ((good, good), {"shape_body": np.array([0, 1, -1, 0], np.int32)}, r"shape_body\[2\] is -1; it must lie in"),
        ((good, good), {"body_type": np.zeros(3, np.int32)}, r"shape_body\[3\] is 3; it must lie in \[0, 2\]"),
        ((good, good), {"body_type": np.full(4, 9, np.int32)}, r"body_type\[0\] is 9; it must lie in \[0, 2\]"),
        ((good, good), {"threads": 0}, r"threads is 0"),
        ((good, good), {"backend": "jax"}, r"backend is 'jax'"),
    ):
        with pytest.raises(ValueError, match=message):
            dc.Broadphase(*arguments, **options)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_goes_bad_after_it_was_checked_is_named_at_the_call(backend):
    lower, upper = boxes(20, np.random.default_rng(7))
    body = np.arange(20, dtype=np.int32)
    broadphase = dc.Broadphase(lower, upper, [0, 10, 20], shape_body=body, backend=backend)
    broadphase()
    others = broadphase.numpy()
    others = others[others[:, 0] < 10]
    for array, index, bad, message in (
        (lower, (11, 0), np.inf, r"lower\[11, 0\] is inf"),
        (lower, (12, 1), 1e9, r"lower\[12, 1\] is 1000000000.0; it must not exceed"),
        (body, (13,), 20, r"shape_body\[13\] is 20; .*\[0, 19\]"),
    ):
        good, array[index] = array[index], bad
        with pytest.raises(ValueError, match=message):
            broadphase()
        np.testing.assert_array_equal(broadphase.numpy(), others)
        array[index] = good


def test_a_graph_of_before_the_room_grew_is_told_of():
    lower, upper = boxes(100, np.random.default_rng(5))
    broadphase = dc.Broadphase(lower, upper)
    broadphase()
    with wp.ScopedCapture(device="cpu") as capture:
        broadphase()
    upper += np.float32(20.0)
    broadphase()
    wp.capture_launch(capture.graph)
    with pytest.raises(RuntimeError, match=r"recorded before layout_version changed to \d+: .*; record it anew"):
        broadphase.check()
    np.testing.assert_array_equal(broadphase.numpy(), brute(lower, upper))
    broadphase.check()
    with wp.ScopedCapture(device="cpu") as capture:
        broadphase()
    wp.capture_launch(capture.graph)
    broadphase.check()
