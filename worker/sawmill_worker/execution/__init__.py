"""Claiming jobs and running each attempt in a process of its own (docs/architecture.md#jobs)."""
