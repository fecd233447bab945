"""Pairs of views: sums over rays that any two views of one body have in common."""
