"""Drift: what moved since a calibration, from scans of ordinary logs."""
