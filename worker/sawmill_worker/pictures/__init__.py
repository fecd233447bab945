"""Contracts and arrays to PNG and SVG."""
