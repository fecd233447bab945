"""The order of a fit's seven unknowns, and of the terms of `analytic.gram`; no other module defines an order."""

from enum import IntEnum


class FitParameter(IntEnum):
    """An unknown of the fit; the value is the index in every vector, derivative and covariance.

    The first five are in the order of `SourceFrame.to_vector`. R and SDD are distances in mm, U_C the COR's column in
    mm, PSI and TILT (tau) angles in radians; T_X and T_Y are the phantom's position in mm.
    """

    PSI = 0
    R = 1
    SDD = 2
    U_C = 3
    TILT = 4
    T_X = 5
    T_Y = 6


# The geometry's five unknowns, and the four of the five that move the rays: psi only turns all rays together.
FRAME = slice(0, 5)
RAYS = slice(1, 5)


class GramTerm(IntEnum):
    """A term of `analytic.gram` after the seven derivatives."""

    SHADOW = 7
    ONE = 8
    DATA = 9
