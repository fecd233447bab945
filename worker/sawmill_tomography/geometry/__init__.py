"""Geometry: theta, the source frame, rays, the image's pixels, and how far two geometries differ."""
