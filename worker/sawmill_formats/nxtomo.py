"""NXtomo's names and keys, with which scans are written and read.

Layout: manual.nexusformat.org, application definition NXtomo. Paths are below the entry.
"""

DEFINITION = "NXtomo"
DETECTOR = "instrument/detector"
DATA = f"{DETECTOR}/data"
IMAGE_KEY = f"{DETECTOR}/image_key"
# Distances between cells and between rows.
CELL_PITCH = f"{DETECTOR}/x_pixel_size"
ROW_PITCH = f"{DETECTOR}/y_pixel_size"
ANGLES = "sample/rotation_angle"

# Kind of an image of the stack, by its image key.
PROJECTION, FLAT, DARK, INVALID = 0, 1, 2, 3
