"""Two passages in one file for each pair, as if each had been recorded into files of its own."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np


def recorded_apart(files: Sequence[Path], folder: Path) -> list[Path]:
    """Write the first passage of each file, then the second, whose recording began a row later."""
    return [_one(path, passage, folder / f"passage-{passage + 1}-{path.name}") for passage in (0, 1) for path in files]


def _one(path: Path, passage: int, copy: Path) -> Path:
    shutil.copy(path, copy)
    with h5py.File(copy, "r+") as file:
        detector, sample = file["entry/instrument/detector"], file["entry/sample"]
        key = detector["image_key"][()]
        kept = key > 0
        kept[np.flatnonzero(key == 0)[passage]] = True
        shown = {"data": detector["data"][()][kept][:, passage:], "image_key": key[kept]}
        for group, name, values in (
            *((detector, name, values) for name, values in shown.items()),
            (sample, "rotation_angle", sample["rotation_angle"][()][kept]),
        ):
            attributes = dict(group[name].attrs)
            del group[name]
            group[name] = values
            group[name].attrs.update(attributes)
    return copy
