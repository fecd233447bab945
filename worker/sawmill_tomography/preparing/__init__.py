"""Preparation of a raw stack: line integrals, corrections row by row, and the alignment of views."""
