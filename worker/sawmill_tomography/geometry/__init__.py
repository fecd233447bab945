"""Geometry: theta, the source frame, rays, the image's pixels, and the distance between two geometries.

Others use `geometry.FanBeamGeometry` and `SourceFrame`, `image_grid.ImageGrid`, `modules` of a detector, `export` to
other programs, and `ray_error.ray_error`, the distance in mm that every verdict is about.
"""
