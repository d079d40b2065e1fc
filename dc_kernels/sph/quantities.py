"""What an SPH sum can be of, and how its queries are shared out: what host and kernels agree on."""

from __future__ import annotations

from enum import IntEnum

CHUNK = 512  # queries of a Warp thread, and the unit that Python threads share


class Quantity(IntEnum):
    """What the values of the neighbours are multiplied with before they are added."""

    VALUE = 0
    """W."""
    GRADIENT = 1
    """grad W."""
    LAPLACIAN = 2
    """lap W."""
    DIVERGENCE = 3
    """. grad W: it only serves the adjoint of the gradient."""

    @property
    def order(self) -> int:
        """How many times W is differentiated [1]."""
        return {Quantity.VALUE: 0, Quantity.LAPLACIAN: 2}.get(self, 1)


PUBLIC = {"value": Quantity.VALUE, "gradient": Quantity.GRADIENT, "laplacian": Quantity.LAPLACIAN}
"""What ``sph_sum`` offers, by name."""
