"""Attempts at jobs: each runs in its own process, under a supervisor."""
