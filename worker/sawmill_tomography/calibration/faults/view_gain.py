"""Views that differ in gain or background, as when the tube's output drifts."""

import math

from sawmill_tomography.calibration.normal_equations import ViewGrams

SENTENCE = "the views differ in gain or background, so each has its own"
# What gains of each view explain counts when it is more than chance by this number of standard deviations, and than
# this share of what is no noise in the residual.
DEVIATIONS, LEAST_SHARE = 8.0, 0.5


def views_differ(grams: ViewGrams) -> bool:
    """Whether a gain and an offset of each view explain far more than chance."""
    explained, views = grams.gain_evidence()
    unknowns = 2.0 * views
    variance = (grams.power - explained) / max(grams.samples - unknowns, 1.0)
    chance = unknowns + DEVIATIONS * math.sqrt(2.0 * unknowns)
    return explained > chance * variance and explained - unknowns * variance > LEAST_SHARE * grams.structured
