"""Where things lie in the file of a reconstructed volume: NXtomoproc, and what is ours beside it.

Layout: manual.nexusformat.org, application definition NXtomoproc.
"""

DEFINITION = "NXtomoproc"
ENTRY = "entry"
# The volume with its axes x, y and z (or slice), where NXtomoproc wants it.
PLOT = f"{ENTRY}/data"
# How it was made, with the volume and its axes linked; NXtomoproc wants this group under the name PROCESS.
RECONSTRUCTION = f"{ENTRY}/reconstruction"
PROCESS = f"{ENTRY}/process"
# In both: the volume, and the standard deviation of each pixel.
VALUES = "data"
DEVIATION = "data_errors"
# Tikhonov's choice of alpha: a column each.
ALPHA_CURVE = f"{RECONSTRUCTION}/alpha_curve"
ALPHA_COLUMNS = ("alphas", "residual_norms", "solution_norms", "alpha", "gcv")
# The densest values, seen from the side: `side_view` for each axis.
SIDE_VIEWS = f"{ENTRY}/side_view"


def side_view(along: str) -> str:
    """The group of what is seen along x or y."""
    return f"{SIDE_VIEWS}/along_{along}"
