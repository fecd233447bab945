"""Where things lie in the file of a scan of line integrals: NXtomo, and what is ours beside it."""

from sawmill_worker.files import nxtomo

ENTRY = "entry"
DATA = f"{ENTRY}/{nxtomo.DATA}"
CELL_PITCH = f"{ENTRY}/{nxtomo.CELL_PITCH}"
ROW_PITCH = f"{ENTRY}/{nxtomo.ROW_PITCH}"
ANGLES = f"{ENTRY}/{nxtomo.ANGLES}"
# (rows, detector), counts: mean flat less mean dark field.
AIR_LEVEL = f"{ENTRY}/{nxtomo.DETECTOR}/air_level"
PROVENANCE = f"{ENTRY}/provenance"
# (views,), rows: in the provenance.
ROW_SHIFTS = "row_shifts"
# The data's `long_name`: how a scan of ours differs from NXtomo files of detector counts.
LINE_INTEGRALS = "line integrals"
