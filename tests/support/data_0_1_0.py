"""A data folder of version 0.1.0 with its examples, made by that version's own code.

`make_data_0_1_0.py` at ff825056 made it. It has a scanner of 192 cells, a second calibration, one that failed, one that
was cancelled, and a plan that waits; uploads and some large files are left out.
"""

from pathlib import Path

ARCHIVE = Path(__file__).with_name("data_0_1_0.tar.xz")
