"""Gather: grid -> points, and its derivative by the points' places; a thread takes a chunk of a world's points."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.grid.stencil import WEIGHTS, grid_code, grid_types


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``gather_points`` and ``gather_gradient``, in a module each: a stencil for each takes seconds to compile."""
    t = grid_types(dtype)
    Stencil, Points, values, image_type = t.Stencil, t.Points, t.values, t.image
    vectors = wp.array(dtype=t.vec2)

    @wp.func_native(grid_code(dtype, "grid/chunk.h", "grid/points.h", *WEIGHTS, "grid/gather.h"))
    def gather_chunk(
        world: wp.int32,
        chunk: wp.int32,
        stencil: Stencil,
        bins: wp.int32,
        channel_offset: wp.int32,
        points: Points,
        image: image_type,
        value: values,
    ): ...

    @wp.kernel(module=kernel_module("gather", dtype), enable_backward=False)
    def gather_points(
        world_offset: int,
        chunks: int,
        stencil: Stencil,
        bins: int,
        channel_offset: int,
        points: Points,
        image: image_type,
        # Out:
        value: values,
    ):
        """Gather the image at points: the transpose of the splat with the same stencil."""
        i = wp.tid()
        gather_chunk(world_offset + i // chunks, i % chunks, stencil, bins, channel_offset, points, image, value)

    @wp.func_native(grid_code(dtype, "grid/chunk.h", "grid/points.h", *WEIGHTS, "grid/gradient.h"))
    def gradient_chunk(
        world: wp.int32,
        chunk: wp.int32,
        stencil: Stencil,
        bins: wp.int32,
        channel_offset: wp.int32,
        points: Points,
        image: image_type,
        value: values,
        gradient_out: vectors,
    ): ...

    @wp.kernel(module=kernel_module("gather_gradient", dtype), enable_backward=False)
    def gather_gradient(
        world_offset: int,
        chunks: int,
        stencil: Stencil,
        bins: int,
        channel_offset: int,
        points: Points,
        image: image_type,
        value: values,
        # Out:
        gradient: vectors,
    ):
        """Differentiate value . gathered image by each point's place: the adjoint of splat and gather by places."""
        i = wp.tid()
        world = world_offset + i // chunks
        gradient_chunk(world, i % chunks, stencil, bins, channel_offset, points, image, value, gradient)

    return {"gather_points": gather_points, "gather_gradient": gather_gradient}
