"""Position phase after the velocities (nonlinear projection, Box2D 2.3): displacements that undo overlap."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.interrupts import is_cut
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.solve.bodies import body_functions
from dc_kernels._taichi.solve.lanes import lane_functions
from dc_kernels._taichi.solve.row import row_functions
from dc_kernels._taichi.solve.trees import tree_functions
from dc_kernels._taichi.solve.world import ENDS
from dc_kernels.solve.rows import COLORS, JOINTED, LANES, SERIAL_COLOR


@cache
def position_kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``correct_positions``; one thread a world."""
    t = group_types(dtype)
    push_row = row_functions(dtype, variant).push_row
    push_lanes = lane_functions(dtype, variant).push
    unknown_floor = body_functions(dtype).unknown_floor
    jointed, own = variant in JOINTED, variant == "rows"
    factor_tree = solve_tree = None
    if own:
        trees = tree_functions(dtype, variant)
        factor_tree, solve_tree = trees.factor, trees.solve

    @kernel
    def correct_positions(
        tid,
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
        w = tid + launch.world_offset
        pushed = 0.0
        if state.flags[w] == 0:
            if ti.static(jointed):
                pushed = 1.0
            elif not (rows.deepest[w] >= -config.slop * model.length_scale[w]):
                pushed = 1.0
        limit = config.max_correction * model.length_scale[w]
        factor = config.position_factor
        first = rows.color_block[w * ENDS]
        serial = rows.color_block[w * ENDS + SERIAL_COLOR]
        last = rows.color_block[w * ENDS + COLORS]
        iteration = 0
        left = 1.0
        live = pushed > 0.0
        while iteration < config.position_iterations and pushed > 0.0:
            pushed = push_lanes(rows, motion.displacement, first, serial, factor, limit, unknown_floor(config))
            for k in range(serial * LANES, last * LANES):
                pushed = ti.max(pushed, push_row(k // LANES, k % LANES, rows, motion.displacement, factor, limit))
            left = left * (1.0 - factor)
            iteration += 1
            if is_cut((last - first) * LANES, launch.cut):
                pushed = 0.0
        if ti.static(own):
            if live:
                for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
                    if rows.tree_used[tree] > 0:
                        factor_tree(tree, 1, motion.displacement, rows)
                        solve_tree(tree, 1, 1.0 - left, limit, motion.displacement, rows)

    return {"correct_positions": correct_positions}
