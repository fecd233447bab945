"""Gain and background that differ from view to view, as when the tube's output drifts."""

import math

from sawmill_tomography.calibration.joint_fit.normal_equations import ViewGrams

# Gains of each view are fitted when they explain more than chance by DEVIATIONS standard deviations, and more than the
# share LEAST_SHARE of the structured residual.
DEVIATIONS, LEAST_SHARE = 8.0, 0.5


def views_differ(grams: ViewGrams) -> bool:
    """Return whether a gain and an offset of each view explain far more than chance."""
    explained, views = grams.gain_evidence()
    unknowns = 2.0 * views
    variance = (grams.power - explained) / max(grams.samples - unknowns, 1.0)
    chance = unknowns + DEVIATIONS * math.sqrt(2.0 * unknowns)
    return explained > chance * variance and explained - unknowns * variance > LEAST_SHARE * grams.structured
