"""Layout of what differentiable sweeps keep: all of a contact side by side, and what its rows did in a sweep."""

from __future__ import annotations

from enum import IntEnum, IntFlag


class Column(IntEnum):
    """Columns of a packed contact, 64 bytes in float32."""

    NX = 0  # normal
    NY = 1
    NORMAL_ARM_A = 2  # arms crossed with normal and tangent [m]
    NORMAL_ARM_B = 3
    TANGENT_ARM_A = 4
    TANGENT_ARM_B = 5
    INV_MASS_A = 6  # inverse masses [1/kg]
    INV_MASS_B = 7
    NORMAL_TURN_A = 8  # inverse inertias times arms [1/(kg m)]
    NORMAL_TURN_B = 9
    TANGENT_TURN_A = 10
    TANGENT_TURN_B = 11
    EN = 12  # effective masses of normal and tangent [kg]
    ET = 13
    BIAS = 14  # [m/s]
    MU = 15  # Coulomb coefficient


class Active(IntFlag):
    """Bits of the tape: what a contact did in a sweep."""

    PRESSING = 1  # its normal pressed
    UPPER = 2  # its tangent stopped at +mu n
    LOWER = 4  # its tangent stopped at -mu n
