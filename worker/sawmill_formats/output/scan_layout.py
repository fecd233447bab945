"""Paths in the file of a scan of line integrals: NXtomo's, and our own."""

from sawmill_formats import nxtomo

ENTRY = "entry"
DATA = f"{ENTRY}/{nxtomo.DATA}"
CELL_PITCH = f"{ENTRY}/{nxtomo.CELL_PITCH}"
ROW_PITCH = f"{ENTRY}/{nxtomo.ROW_PITCH}"
ARC_RADIUS = f"{ENTRY}/{nxtomo.ARC_RADIUS}"
ANGLES = f"{ENTRY}/{nxtomo.ANGLES}"
# (rows, detector), counts: mean flat less mean dark field.
AIR_LEVEL = f"{ENTRY}/{nxtomo.DETECTOR}/air_level"
# Numbers of the views that are corrupt; only where there are some.
VIEWS_LEFT_OUT = f"{ENTRY}/{nxtomo.DETECTOR}/views_left_out"
# The share of the cells that are saturated in the flats or in the views, of counts.
SATURATED_SHARE = f"{ENTRY}/{nxtomo.DETECTOR}/saturated_share"
# (views, rows), 1 where a view has the row; only where views lack rows, which are NaN in the data. Its attribute: the
# first row that enough views have, and the one after the last.
ROWS_PRESENT, USABLE = f"{ENTRY}/{nxtomo.DETECTOR}/rows_present", "usable_rows"
# (views, rows, detector): standard deviations of the line integrals (NXdetector's name), where they came with the scan
# or rays were masked; 0 where not known.
DEVIATIONS = f"{ENTRY}/{nxtomo.DETECTOR}/data_errors"
# Groups of the modules of a detector, by their number from 0, where the scan came with them.
MODULE = f"{ENTRY}/{nxtomo.DETECTOR}/module_%d"
PROVENANCE = f"{ENTRY}/provenance"
# (views,), rows: in the provenance.
ROW_SHIFTS, ROW_SHIFT_DEVIATIONS = "row_shifts", "row_shifts_standard_deviation"
# `long_name` of the data, by which a scan of ours differs from NXtomo files of detector counts.
LINE_INTEGRALS = "line integrals"
# Drawing of the phantom as JSON, in a packed scan.
DRAWING = f"{ENTRY}/{nxtomo.GIVEN}/{nxtomo.PHANTOM_JSON}"
