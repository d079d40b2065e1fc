"""Splat: points -> grid, one thread a world, and the division by weights.

A world, or a tile of a large image (``tiles``), belongs to one thread, which adds its points in the order of their
index: nothing is added concurrently, and the bits are the same for any number of threads and with or without tiles.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.grid.stencil import WEIGHTS, grid_code, grid_types
from dc_kernels._warp.native import native_code


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``splat_worlds``, ``mark_bands`` and ``divide_image``."""
    t = grid_types(dtype)
    Stencil, Points, values, image_type = t.Stencil, t.Points, t.values, t.image
    integers = wp.array(dtype=wp.int32)
    module = kernel_module("splat", dtype)

    @wp.func_native(grid_code(dtype, "grid/world.h", "grid/points.h", "grid/add.h", *WEIGHTS, "grid/splat_world.h"))
    def splat_world(
        world: wp.int32,
        stencil: Stencil,
        bins: wp.int32,
        channel_offset: wp.int32,
        points: Points,
        value: values,
        touched: wp.array(dtype=wp.int32, ndim=2),
        missed: integers,
        image: image_type,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def splat_worlds(
        world_offset: int,
        stencil: Stencil,
        bins: int,
        channel_offset: int,
        points: Points,
        value: values,
        # Image in, out:
        touched: wp.array(dtype=wp.int32, ndim=2),
        missed: integers,
        image: image_type,
    ):
        """Clear what the call before touched in these channels, then add the points of a world."""
        splat_world(wp.tid() + world_offset, stencil, bins, channel_offset, points, value, touched, missed, image)

    @wp.kernel(module=module, enable_backward=False)
    def mark_bands(
        world_offset: int,
        band: wp.array(dtype=wp.int32, ndim=2),
        # In, out:
        touched: wp.array(dtype=wp.int32, ndim=2),
    ):
        """Mark bands that the next splat is to clear too."""
        w = wp.tid() + world_offset
        for b in range(touched.shape[1]):
            if band[w, b] != 0:
                touched[w, b] = 1

    @wp.func_native(native_code("grid/divide.h", dtype=dtype))
    def divide_world(world: wp.int32, weight: image_type, image: image_type): ...

    @wp.kernel(module=module, enable_backward=False)
    def divide_image(
        world_offset: int,
        weight: image_type,
        # In, out:
        image: image_type,
    ):
        """Divide an image by the weights that it was added with; it is 0 where there are none."""
        divide_world(wp.tid() + world_offset, weight, image)

    return {"splat_worlds": splat_worlds, "mark_bands": mark_bands, "divide_image": divide_image}
