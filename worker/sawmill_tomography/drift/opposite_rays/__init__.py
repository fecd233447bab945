"""Opposite rays of a full turn: each line through the log is measured from both sides."""
