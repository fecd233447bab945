"""Faults of a scan: one finding a file, each with what it looks for, its evidence, and what it does."""
