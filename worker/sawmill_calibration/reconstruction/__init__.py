"""Reconstruction of a volume, block by block."""
