"""Scanners of a mill: their history, alarms and overviews."""
