"""Write the files of the examples of a new data folder, service/sawmill_command/example_files, again.

    python docs/tools/example_files.py

A nightly test compares them with what the simulator makes.
"""

import io
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from sawmill_calibration.calibration.fixed_pairs import read_paired_scanner
from sawmill_calibration.simulation import write_passages
from sawmill_command import examples, seeding
from sawmill_contracts.fixed_pairs import DECLARATION
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_vocabulary import PairedScanner

# Two passages of a board that lies well apart in them, and one of a log whose nails two pairs place.
PAIR_ROWS, PAIR_LOG_ROWS, PHOTONS, PAIR_SEED = 16, 32, 30_000.0, 5


def record(folder: Path) -> None:
    """Write the files of the examples of a new data folder."""
    examples.write_mill_stack(folder / seeding.STACK_FILE, 120, examples.mill_slices())
    # A scan of the phantom alone, small enough to be tried from a browser.
    views = 60
    stack = examples.mill_stack(views, examples.mill_slices()[:1])
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        projections=stack.counts,
        flats=stack.flats,
        darks=stack.darks,
        angles_deg=np.rad2deg(examples.full_turn(views)),
    )
    (folder / seeding.PHANTOM_FILE).write_bytes(buffer.getvalue())
    pairs = TypeAdapter(PairedScanner).validate_python({"pairs": DECLARATION.to_ask.example["body"]["pairs"]})
    passed = partial(write_passages, row_pitch_mm=seeding.ROW_PITCH_MM, photons=PHOTONS, seed=PAIR_SEED)
    board, true = L_SHAPE.of_density(SAPWOOD_PER_MM), folder / "pairs-true.json"
    passed(folder / "pairs.h5", board, pairs, passages=2, rows=PAIR_ROWS, off_mm=10.0)
    passed(folder / "log.h5", None, read_paired_scanner(true), passages=1, rows=PAIR_LOG_ROWS, off_mm=0.0)
    for written in (true, folder / "log-true.json", folder / "log-marks.json"):
        written.unlink()


if __name__ == "__main__":
    record(seeding.RECORDED)
