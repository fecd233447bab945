"""Scans in files of all kinds."""

from scan_files import angles_deg, file, nxtomo, published_data, rng, stack  # noqa: F401 - fixtures
