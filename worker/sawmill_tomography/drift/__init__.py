"""Drift: what moved since a calibration, from scans of ordinary logs.

Others call `detector_fit.detector_fit` on a sinogram, `change.drift_change` with the fit and a calibration, and `chart`
with the results of many scans; what a log does not show is a `change.DriftError`. Rays and pairs are the inside.
"""
