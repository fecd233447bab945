"""Scans as a mill's scanner takes them: exact chords, and every effect that `vocabulary.physics` names.

Nothing here uses the forward model of the calibration, so that one can check the other.
"""
