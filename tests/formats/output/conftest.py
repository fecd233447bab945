"""Scans to be written and read back."""

from scan_files import angles_deg, rng, stack  # noqa: F401 - fixtures
