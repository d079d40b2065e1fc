"""The weights of grid nodes for a point: the settings that splat, gather and images share.

With the weights S_ip of point p at node i, a splat is ``image_i = sum_p S_ip value_p``, a gather its transpose
``value_p = sum_i S_ip image_i``. ``Stencil.normalize`` defines S:

- "particle": S_ip = W(|x_p - x_i|) / sum_j W(|x_p - x_j|) over the nodes in the grid: each point's weights sum to 1, at
  the border too, so a splat conserves the sum of its values and a gather reproduces constants (as in the theses);
- "sum": S_ip = W in 1/m^2, the SPH sum (Wu 2018, equation 3.7), for values m/rho A;
- "shepard" (splat only): the SPH sum divided by that of ones: a weighted average, which reproduces constants.

Stencils "bilinear" (Wu 2018, equations 3.15-3.17) and "bspline" (cubic B-spline, which smooths but reproduces linear
fields) have weights that sum to 1 by themselves, whatever ``normalize`` says; a point outside the grid is moved to its
border. With radial kernels a point outside reaches the nodes within h, if any. A point that reaches none is assigned to
its nearest node under "particle" (unless ``nearest`` is False) and contributes nothing under "sum".
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import IntEnum
from typing import Any, Literal

from dc_kernels.grid.grid import Grid
from dc_kernels.model.settings import Positive, Settings, checker
from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import KERNELS, STENCILS

SUPPORT = 2.0  # default h [spacing]
MAX_SUPPORT = 2**20  # [spacing]
FEW = 16  # nodes of a kernel's window that take as long as the four, or nine, of a point without one

KernelName = Literal["poly6", "spiky", "gaussian", "cubic", "wendland", "bilinear", "bspline"]


class Normalize(IntEnum):
    """Codes of the normalization of weights in the kernels."""

    SUM = 0
    """Nothing."""
    PARTICLE = 1
    """Their sum over the nodes that a point reaches."""


NORMALIZE = {"sum": Normalize.SUM, "particle": Normalize.PARTICLE, "shepard": Normalize.SUM}
"""What the weights of a point are divided by; those of "shepard" are divided at the nodes, after the splat."""


@dataclass(frozen=True)
class Stencil(Settings):
    """Settings of a splat or a gather: the weights of a point as a function of its distance to the nodes.

    Raises:
        ValueError: a setting, which the error names, is unknown or out of range.
    """

    kernel: KernelName = "poly6"
    """Name of the stencil: a radial smoothing kernel, "bilinear" or "bspline"."""
    _: KW_ONLY
    h: Positive | None = None
    """Support radius of a radial kernel [m]; None: 2 spacings."""
    normalize: Literal["particle", "shepard", "sum"] = "particle"
    """Normalization of the weights (see the module)."""
    nearest: bool = True
    """Whether a point that reaches no node is assigned to its nearest one, under "particle"."""

    def support(self, spacing: float) -> float:
        """Return the support radius on a grid [m].

        Raises:
            ValueError: it is more than 2^20 spacings.
        """
        if self.h is None:
            return SUPPORT * spacing
        if self.kernel in KERNELS and self.h > spacing * MAX_SUPPORT:
            raise ValueError(f"h is {self.h!r} m, {self.h / spacing:.3g} spacings; it must be at most 2^20 of them")
        return float(self.h)

    def window(self, spacing: float) -> int:
        """Return the columns of the widest window of a point: whole vectors, as the kernels place them."""
        if self.kernel not in KERNELS:
            return LANES
        return (int(2 * (self.support(spacing) / spacing)) // LANES + 1) * LANES

    def nodes(self, spacing: float) -> int:
        """Return the nodes of a point's window; without one, how many take as long as it does."""
        return self.window(spacing) ** 2 if self.kernel in KERNELS else FEW

    def arguments(self, grid: Grid) -> dict[str, Any]:
        """Return the numbers of ``grid.fields.STENCIL`` on a grid, by name.

        Raises:
            ValueError: see ``support``.
        """
        return {
            "kernel": STENCILS[self.kernel],
            "normalize": int(NORMALIZE[self.normalize]),
            "nearest": int(self.nearest),
            "spacing": grid.spacing,
            "h": self.support(grid.spacing),
        }

    def check_gather(self, reverse: bool = False) -> None:
        """Check that a gather can use this stencil.

        Raises:
            ValueError: ``normalize`` is "shepard", or not "particle" for a reversed gather.
        """
        if reverse and self.normalize != "particle":
            raise ValueError(f"normalize is {self.normalize!r}; reverse needs 'particle'")
        if self.normalize == "shepard":
            raise ValueError("normalize is 'shepard', which only a splat can be; it must be 'particle' or 'sum'")


_grid, _stencil = checker(Grid), checker(Stencil)


def check_place(grid: Any, stencil: Any) -> tuple[Grid, Stencil]:
    """Return a grid and a stencil.

    Raises:
        TypeError: naming what is none.
    """
    return _grid("grid", grid), _stencil("stencil", stencil)


check_stencil = checker(Stencil | None)
"""Returns a stencil, or None, or raises a TypeError with the name."""
POLY6 = Stencil()
"""The stencil of a splat unless another one is asked for: poly6 of 2 spacings, each point's weights of sum 1."""
BILINEAR = Stencil("bilinear")
"""The stencil of a gather unless another one is asked for."""
