"""Calibration: the default method, the published method, and the outcome of both.

Others call `calibrate.calibrate` or `paper.calibrate_as_published` with a `task.CalibrationTask`, and get a
`calibration.CalibrationOutcome`; `planning.plan` before a scan, `phantom_rows` on a stack, `with_log.with_log` and
`comparison.compare` after it. Faults, search and joint fit are the inside.
"""
