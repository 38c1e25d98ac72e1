"""Colours and scales of pictures and pages: safe for colour-blind readers, and never the only sign.

A shape, a dash, a number or a word repeats the meaning of each colour. The qualitative colours are those of
Okabe and Ito; potentials use matplotlib's viridis, whose lightness rises all the way.
"""

import math

BLUE, VERMILLION, GREEN, AMBER = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE = "#56B4E9", "#AA4499"
INK, GREY = "#1B1F24", "#6B7280"

POTENTIAL_MAP = "viridis"
POTENTIAL_LOW_MV, POTENTIAL_HIGH_MV = -90.0, 0.0
"""Range of all potentials; colours mean the same in every picture."""

_RING_FROM_S, _RING_INNER, _RING_DECADE = 1e-4, 34.0, 6.0


def ring_radius(tau_s: float) -> float:
    """Return the radius of a time constant's ring, in the units of `layout`: a decade is 6 wide."""
    decades = math.log10(max(tau_s, _RING_FROM_S) / _RING_FROM_S)
    return _RING_INNER + _RING_DECADE * decades
