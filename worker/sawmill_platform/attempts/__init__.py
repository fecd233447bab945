"""Attempts: each attempt at a job runs in a process of its own, under a supervisor."""
