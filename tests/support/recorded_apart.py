"""Two passages in one file for each pair, as if each had been recorded into files of its own."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np


def recorded_apart(files: Sequence[Path], folder: Path) -> list[Path]:
    """Write the first passage of each file, then the second; three and five rows of air come first."""
    return [_one(path, passage, folder / f"passage-{passage + 1}-{path.name}") for passage in (0, 1) for path in files]


def _one(path: Path, passage: int, copy: Path) -> Path:
    with h5py.File(shutil.copy(path, copy), "r+") as file:
        detector = file["entry/instrument/detector"]
        frames, key = detector["data"][()], detector["image_key"][()]
        shown, air_rows = np.flatnonzero(key == 0), 3 + 2 * passage
        frames[shown, air_rows:] = frames[shown, :-air_rows]
        frames[shown, :air_rows] = frames[key == 1].mean(axis=0)[:air_rows]
        key[np.delete(shown, passage)] = 3  # invalid
        detector["data"][...], detector["image_key"][...] = frames, key
    return copy
