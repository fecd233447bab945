"""The science: fan-beam geometry, phantoms, projection, reconstruction, calibration. Knows no files and no queue."""
