"""Scans as a mill's scanner takes them: exact chords, and every effect that `vocabulary.physics` names.

Others call `simulate.simulate_physics`, or `projection.simulate.simulate_stack` for a stack in counts. Nothing here
uses the forward model of the calibration, so that one can check the other.
"""
