"""Calibration of a scanner, from plan to report."""
