"""Splat and gather: points -> grid and back, and the gradients of both.

A world, or a tile of a large image, belongs to one thread, which adds its points in the order of their index: nothing
is added concurrently, and the bits are the same for any number of threads and with or without tiles.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.grid.stencil import WEIGHTS, grid_code
from dc_kernels._warp.native import native_code

_MODULES = ("splat", "gather", "gradient")  # apart: a stencil for each takes seconds to compile


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``splat_worlds``, ``gather_points``, ``gather_gradient``, ``divide_image``."""
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    image_type = wp.array(dtype=real, ndim=4)
    value_type = wp.array(dtype=real, ndim=2)
    integers = wp.array(dtype=wp.int32)
    vectors = wp.array(dtype=vec2)
    splat_module, gather_module, gradient_module = (kernel_module(f"transfer_{n}", dtype) for n in _MODULES)

    @wp.func_native(grid_code(dtype, "grid/world.h", "grid/points.h", "grid/add.h", *WEIGHTS, "grid/splat_world.h"))
    def splat_world(
        world: wp.int32,
        stencil: wp.int32,
        normalize: wp.int32,
        nearest: wp.int32,
        spacing: real,
        h: real,
        bins: wp.int32,
        channel_offset: wp.int32,
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        value: value_type,
        point_bin: integers,
        touched: wp.array(dtype=wp.int32, ndim=2),
        missed: integers,
        image: image_type,
    ): ...

    @wp.kernel(module=splat_module, enable_backward=False)
    def splat_worlds(
        world_offset: int,
        stencil: int,
        normalize: int,
        nearest: int,
        spacing: real,
        h: real,
        bins: int,
        channel_offset: int,
        # Points in:
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        value: value_type,
        point_bin: integers,
        # Image in, out:
        touched: wp.array(dtype=wp.int32, ndim=2),
        missed: integers,
        image: image_type,
    ):
        """Clear what the call before touched in these channels, then add the points of a world."""
        splat_world(
            wp.tid() + world_offset,
            stencil,
            normalize,
            nearest,
            spacing,
            h,
            bins,
            channel_offset,
            grid_origin,
            point_start,
            point_count,
            point,
            value,
            point_bin,
            touched,
            missed,
            image,
        )

    @wp.func_native(grid_code(dtype, "grid/chunk.h", "grid/points.h", *WEIGHTS, "grid/gather.h"))
    def gather_chunk(
        world: wp.int32,
        chunk: wp.int32,
        stencil: wp.int32,
        normalize: wp.int32,
        nearest: wp.int32,
        spacing: real,
        h: real,
        bins: wp.int32,
        channel_offset: wp.int32,
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        point_bin: integers,
        image: image_type,
        value: value_type,
    ): ...

    @wp.kernel(module=gather_module, enable_backward=False)
    def gather_points(
        world_offset: int,
        chunks: int,
        stencil: int,
        normalize: int,
        nearest: int,
        spacing: real,
        h: real,
        bins: int,
        channel_offset: int,
        # Points in:
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        point_bin: integers,
        image: image_type,
        # Out:
        value: value_type,
    ):
        """The image at points: the transpose of the splat with the same stencil."""
        i = wp.tid()
        gather_chunk(
            world_offset + i // chunks,
            i % chunks,
            stencil,
            normalize,
            nearest,
            spacing,
            h,
            bins,
            channel_offset,
            grid_origin,
            point_start,
            point_count,
            point,
            point_bin,
            image,
            value,
        )

    @wp.func_native(grid_code(dtype, "grid/chunk.h", "grid/points.h", *WEIGHTS, "grid/gradient.h"))
    def gradient_chunk(
        world: wp.int32,
        chunk: wp.int32,
        stencil: wp.int32,
        normalize: wp.int32,
        nearest: wp.int32,
        spacing: real,
        h: real,
        bins: wp.int32,
        channel_offset: wp.int32,
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        point_bin: integers,
        image: image_type,
        value: value_type,
        gradient_out: vectors,
    ): ...

    @wp.kernel(module=gradient_module, enable_backward=False)
    def gather_gradient(
        world_offset: int,
        chunks: int,
        stencil: int,
        normalize: int,
        nearest: int,
        spacing: real,
        h: real,
        bins: int,
        channel_offset: int,
        # Points in:
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        point_bin: integers,
        image: image_type,
        value: value_type,
        # Out:
        gradient: vectors,
    ):
        """Gradient of value . gathered image by the place of each point: the adjoint of splat and gather by places."""
        i = wp.tid()
        gradient_chunk(
            world_offset + i // chunks,
            i % chunks,
            stencil,
            normalize,
            nearest,
            spacing,
            h,
            bins,
            channel_offset,
            grid_origin,
            point_start,
            point_count,
            point,
            point_bin,
            image,
            value,
            gradient,
        )

    @wp.func_native(native_code("grid/divide.h", dtype=dtype))
    def divide_world(world: wp.int32, weight: image_type, image: image_type): ...

    @wp.kernel(module=splat_module, enable_backward=False)
    def divide_image(
        world_offset: int,
        weight: image_type,
        # In, out:
        image: image_type,
    ):
        """Shepard: an image by the weights that it was added with, 0 where there are none."""
        divide_world(wp.tid() + world_offset, weight, image)

    return {
        "splat_worlds": splat_worlds,
        "gather_points": gather_points,
        "gather_gradient": gather_gradient,
        "divide_image": divide_image,
    }
