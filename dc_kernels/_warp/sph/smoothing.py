"""What the native code of smoothing kernels (``native/sph``) is compiled with: codes, constants and degrees as macros.

Scalar ``wp.func`` versions, one neighbour after the other, took 7-15 ns a neighbour in the SPH sums where these take
2-3: gathering, weighing and adding are loops of their own there, and only gathering is not in lanes.
"""

from enum import IntEnum

from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import COINCIDENT, GAUSSIAN_CUT, STENCILS

BLOCK = 64  # neighbours at a time, a multiple of LANES: their scratch stays in the L1 cache
TAYLOR = {"float32": 9, "float64": 17}  # degree of the polynomial of exp that errs below round-off


class Term(IntEnum):
    """What a neighbour can be weighed by, in w, f, g and k of ``dc_kernels.sph.smoothing``."""

    W = 0
    F = 1  # the gradient is f e
    LAPLACIAN = 2  # d f + q^2 g
    LAPLACIAN_SLOPE = 3  # (d + 2) g + q^2 k
    HESSIAN = 4  # f and g


def radial_macros(dtype: str) -> dict[str, object]:
    """Macros of ``sph/radial.h``, the codes of the stencils, and LANES."""
    codes = {name.upper(): code for name, code in STENCILS.items()}
    return {
        "LANES": LANES,
        "COINCIDENT": COINCIDENT,
        "RATE": GAUSSIAN_CUT**2,
        "TAYLOR": TAYLOR[dtype],
        **codes,
    }


def block_macros(dtype: str) -> dict[str, object]:
    """Macros of ``sph/block.h`` beside those of ``sph/radial.h``."""
    return {**radial_macros(dtype), "BLOCK": BLOCK, **{f"TERM_{term.name}": int(term) for term in Term}}
