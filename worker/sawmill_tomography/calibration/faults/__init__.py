"""Faults of a scan: each with its evidence, the sentence that reports it, and what is done about it."""
