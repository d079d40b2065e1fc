"""What a point reaches on a grid and with which weights: the native code that splat, gather and tiles are made of.

A radial stencil (poly6, spiky, Gaussian, cubic spline, Wendland C2) weighs the nodes within h. Weights are computed in
vectors of LANES columns, row by row, in a window of whole vectors that is slid into the row where it would leave it:
its nodes beyond h get weight 0, so no column is tested. A separable stencil (bilinear, cubic B-spline) has up to 4 x 4
nodes and fills the same window. Lengths are in spacings; q2 = r^2 / h^2; a radial function is W without its constant.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.groups import struct_type
from dc_kernels._warp.native import native_code
from dc_kernels._warp.sph.smoothing import radial_macros
from dc_kernels.grid.fields import POINTS, STENCIL, TILES
from dc_kernels.grid.layout import BAND, CHUNK, TILE_COLUMNS, TILE_ROWS
from dc_kernels.sph.smoothing import KERNELS, constant

WINDOW_ROWS = 16  # of a window that is kept in registers and the first-level cache
AHEAD = 12  # points of a tile that are fetched ahead of their use; 8 to 24 cost the same
WEIGHTS = ("sph/radial.h", "grid/weights.h")
"""The headers that define ``each_stencil``; what it calls comes before or behind them."""


def grid_code(dtype: str, *names: str) -> str:
    """The body of a native function: the common prelude, what all stencils need, and further headers in order."""
    constants = {f"{name.upper()}_CONSTANT": constant(name, 2) for name in KERNELS}
    layout = {"BAND": BAND, "CHUNK": CHUNK, "TILE_ROWS": TILE_ROWS, "TILE_COLUMNS": TILE_COLUMNS}
    macros = {**radial_macros(dtype), **constants, **layout, "WINDOW_ROWS": WINDOW_ROWS, "AHEAD": AHEAD}
    return native_code("prelude.h", "grid/axis.h", "grid/window.h", *names, dtype=dtype, **macros)


@cache
def grid_types(dtype: str) -> SimpleNamespace:
    """Types of the kernels' arguments: scalars, the structs ``Stencil``, ``Points``, ``Tiles``, values and images."""
    scalars = scalar_types(dtype)
    return SimpleNamespace(
        **vars(scalars),
        Stencil=struct_type("stencil", dtype, STENCIL),
        Points=struct_type("points", dtype, POINTS),
        Tiles=struct_type("tiles", dtype, TILES),
        values=wp.array(dtype=scalars.real, ndim=2),
        image=wp.array(dtype=scalars.real, ndim=4),
    )
