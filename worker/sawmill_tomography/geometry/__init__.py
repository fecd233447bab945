"""Geometry: theta, the source frame, rays, the image's pixels, and the distance between two geometries."""
