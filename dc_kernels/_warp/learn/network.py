"""A ContactNet in lanes: image, trunk and head of a world that is read, in native code for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.groups import struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT, Answer, Output
from dc_kernels.learn.groups import NETWORK, READING
from dc_kernels.learn.layers import CHUNK, LANES, MOST_SCALES

HEADERS = (
    "prelude.h",
    "grid/axis.h",
    "learn/layers.h",
    "learn/maps.h",
    "learn/image.h",
    "learn/trunk.h",
    "learn/head.h",
)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``answer_contacts``: a thread each world that is asked for."""
    real = scalar_types(dtype).real
    Network, Reading = struct_type("network", dtype, NETWORK), struct_type("reading", dtype, READING)
    sizes = {"CHANNELS": len(IMAGE), "LOCAL": len(LOCAL), "OUTPUT": len(OUTPUT), "STEPS": int(Output.FREE_N)}
    code = native_code(*HEADERS, dtype=dtype, LANES=LANES, SCALES=MOST_SCALES, CHUNK=CHUNK, **sizes)

    @wp.func_native(code)
    def answer_world(
        k: wp.int32, slot: wp.int32, network: Network, reading: Reading, output: wp.array(dtype=real, ndim=2)
    ): ...

    @wp.kernel(module=kernel_module("network", dtype), enable_backward=False)
    def answer_contacts(
        world_offset: int,
        network: Network,
        reading: Reading,
        # out:
        output: wp.array2d(dtype=real),
    ):
        """Answer with a correction for each contact of the worlds that were read (columns ``Output``)."""
        k = wp.tid() + world_offset
        if reading.answer[k] == Answer.NETWORK and reading.packed_start[k + 1] > reading.packed_start[k]:
            answer_world(k, world_offset, network, reading, output)

    return {"answer_contacts": answer_contacts}
