"""Scans, inspected files and phantoms."""
