"""Drift checks, their baselines and charts."""
