"""C++ of the kernels without a compiler's optimizations, which a user debugs."""

import numpy as np
import pytest
import warp as wp

from dc_kernels._warp.native import native_code
from dc_kernels.solve.rows import LANES


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_vectors_may_lie_anywhere_in_a_debug_build(dtype):
    """What takes a reference to one as `auto&` forgets so, and crashes where the compiler leaves it in memory."""
    vec4 = wp.types.vector(4, wp.dtype_from_numpy(np.dtype(dtype)))
    move = """
    int to[LANES], from[LANES];
    for (int i = 0; i < LANES; ++i) {
        from[i] = i;
        to[i] = 2 * LANES - 1 - i;
    }
    store_bodies(to, load_bodies(from));
    """.replace("LANES", str(LANES))

    @wp.func_native(native_code("prelude.h", "solve/bodies.h", dtype=dtype, LANES=LANES) + move)
    def reverse(bodies: wp.array(dtype=vec4)): ...

    @wp.kernel(module="unique", module_options={"mode": "debug"}, enable_backward=False)
    def reverse_all(bodies: wp.array(dtype=vec4)):
        reverse(bodies)

    bodies = np.arange(8.0 * LANES, dtype=dtype).reshape(2 * LANES, 4)
    wp.launch(reverse_all, dim=1, inputs=[wp.array(bodies, dtype=vec4, device="cpu", copy=False)], device="cpu")
    np.testing.assert_array_equal(bodies[LANES:], bodies[LANES - 1 :: -1])
