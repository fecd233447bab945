"""NXtomo's names and keys, with which scans are written and read.

Layout: manual.nexusformat.org, application definition NXtomo. Paths are below the entry.
"""

DEFINITION = "NXtomo"
DETECTOR = "instrument/detector"
DATA = f"{DETECTOR}/data"
IMAGE_KEY = f"{DETECTOR}/image_key"
# Written by nxtomo and nxtomomill: as the image key, with -1 for images that show whether the sample has moved.
IMAGE_KEY_CONTROL = f"{DETECTOR}/image_key_control"
# Distances between cells and between rows.
CELL_PITCH = f"{DETECTOR}/x_pixel_size"
ROW_PITCH = f"{DETECTOR}/y_pixel_size"
# Our own: radius of the arc on which the cells lie.
ARC_RADIUS = f"{DETECTOR}/arc_radius"
ANGLES = "sample/rotation_angle"
# Our own group, of a packed scan: the scanner's constants that its owner gave, also in words, and the drawing as JSON.
GIVEN, PHANTOM_JSON, CONSTANTS = "given", "phantom_json", "constants"

# Kind of an image of the stack, by its image key.
PROJECTION, FLAT, DARK, INVALID, ALIGNMENT = 0, 1, 2, 3, -1
