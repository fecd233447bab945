"""Paths in the file of a reconstructed volume: NXtomoproc's, and our own.

Layout: manual.nexusformat.org, application definition NXtomoproc.
"""

DEFINITION = "NXtomoproc"
ENTRY = "entry"
# The volume with its axes x, y and z (or slice), where NXtomoproc expects it.
PLOT = f"{ENTRY}/data"
# Origin of the volume, with the volume and its axes linked; NXtomoproc requires this group under the name PROCESS.
RECONSTRUCTION = f"{ENTRY}/reconstruction"
PROCESS = f"{ENTRY}/process"
# Names in both groups: the volume, and the standard deviation of each pixel.
VALUES = "data"
DEVIATION = "data_errors"
# Curve from which Tikhonov's alpha was chosen: a column each.
ALPHA_CURVE = f"{RECONSTRUCTION}/alpha_curve"
ALPHA_COLUMNS = ("alphas", "residual_norms", "solution_norms", "alpha", "gcv")
# Densest values seen from the side: `side_view` for each axis.
SIDE_VIEWS = f"{ENTRY}/side_view"


def side_view(along: str) -> str:
    """Return the group of the side view along x or y."""
    return f"{SIDE_VIEWS}/along_{along}"
