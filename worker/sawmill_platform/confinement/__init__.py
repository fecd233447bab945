"""Confinement: limits, files and system calls of an attempt's process."""
