"""Position phase after the velocities (nonlinear projection, Box2D 2.3): displacements that undo overlap."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.solve.row import push_row
from dc_kernels._numpy.solve.trees import Tree
from dc_kernels._numpy.solve.world import World
from dc_kernels.solve.rows import JOINTED


def position_kernels(variant: str) -> Kernels:
    """``correct_positions`` of a row variant."""

    def correct_positions(tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, rows: Any) -> None:
        """Add to the displacements of a step what removes a share of each overlap.

        Without joints it is skipped where the step began with no overlap beyond the slop. Trees of joints follow once,
        by as much as all sweeps remove.
        """
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        if variant not in JOINTED and rows.deepest[w] >= -config.slop * model.length_scale[w]:
            return
        limit = config.max_correction * model.length_scale[w]
        world = World(w, variant, 0, config, model, motion, rows, None)
        left = motion.displacement.dtype.type(1.0)
        for _ in range(config.position_iterations):
            pushes = (push_row(row, motion.displacement, config.position_factor, limit) for row in world.own_rows)
            pushed = max(pushes, default=0.0)
            left *= 1 - left.dtype.type(config.position_factor)
            if not pushed > 0.0:
                break
        for tree in world.own_trees:
            if rows.tree_used[tree]:
                own = Tree(tree, variant, rows, motion.displacement, places=True)
                own.push(motion.displacement, 1 - left, limit)

    return {"correct_positions": correct_positions}
