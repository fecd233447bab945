"""Pages of a calibration: from a file to the accepted calibration, and the report."""
