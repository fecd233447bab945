"""Retention: the rules, the removal of what the rules reach, and the removal of files that no row names."""
