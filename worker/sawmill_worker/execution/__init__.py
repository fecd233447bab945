"""Claiming jobs and running each attempt in a process of its own (DESIGN section 6)."""
