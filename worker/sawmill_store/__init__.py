"""The rows of a mill: scanners, phantoms, scans, calibrations, drift checks, schedules and alarms."""
