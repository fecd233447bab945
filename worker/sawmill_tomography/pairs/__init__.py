"""Scanners of several fixed pairs: calibrated from passages of one board, nothing turning.

Others use `calibrate.calibrate_pairs`, and `ray_errors.PairRays`, the distance in mm that the verdict is about.
"""
