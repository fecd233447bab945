"""Calibration: the default method, the published one, and what both answer."""
