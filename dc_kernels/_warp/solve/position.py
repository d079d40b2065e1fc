"""Position phase after the velocities (nonlinear projection, Box2D 2.3): displacements that undo overlap."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import is_set, kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.lanes import has_lanes, lane_functions
from dc_kernels._warp.solve.row import row_functions
from dc_kernels._warp.solve.trees import tree_functions
from dc_kernels._warp.solve.world import ENDS, N_COLORS, N_LANES, SERIAL
from dc_kernels.solve.rows import JOINTED, OWN


@cache
def position_kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``correct_positions``; one thread a world."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    push_row = row_functions(dtype, variant).push_row
    push_lanes = lane_functions(dtype, variant).push
    jointed, own = variant in JOINTED, variant in OWN
    if own:
        trees = tree_functions(dtype, variant)
        factor_tree, solve_tree = trees.factor, trees.solve

    @wp.kernel(module=module, enable_backward=False)
    def correct_positions(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
    ):
        """Add to the displacements of a step what removes a share of each overlap.

        Gaps are those of the narrowphase plus what the displacement changes them by to first order; it ends as soon as
        a sweep pushes nothing. Without joints it is skipped where the step began with no overlap beyond the slop: what
        an unconverged solve adds is met in the next step. Trees of joints follow once, by as much as all sweeps remove.
        """
        w = wp.tid() + launch.world_offset
        if state.flags[w] != 0:
            return
        if wp.static(not jointed):
            if rows.deepest[w] >= -config.slop * model.length_scale[w]:
                return
        limit = config.max_correction * model.length_scale[w]
        factor = config.position_factor
        serial = rows.color_block[w * ENDS + SERIAL]
        last = rows.color_block[w * ENDS + N_COLORS]
        iteration = int(0)
        pushed = real(1.0)
        left = real(1.0)
        while iteration < config.position_iterations and pushed > real(0.0):
            first = rows.color_block[w * ENDS]
            pushed = real(0.0)
            if has_lanes() == 1:
                pushed = push_lanes(
                    rows.column,
                    rows.body,
                    motion.displacement,
                    rows.color_block,
                    w * ENDS,
                    factor,
                    limit,
                    launch.team,
                )
                first = serial
            for k in range(first * N_LANES, last * N_LANES):
                pushed = wp.max(pushed, push_row(k / N_LANES, k % N_LANES, rows, motion.displacement, factor, limit))
            left = left * (real(1.0) - factor)
            iteration += 1
            if is_set(launch.cut) == 1:
                break
        if wp.static(own):
            for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
                if rows.tree_used[tree] > 0:
                    factor_tree(tree, 1, motion.displacement, rows)
                    solve_tree(tree, 1, real(1.0) - left, limit, motion.displacement, rows)

    return {"correct_positions": correct_positions}
