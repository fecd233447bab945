"""Calibration: the default method, the published method, and the outcome of both."""
