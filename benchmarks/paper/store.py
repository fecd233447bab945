"""Results on disk: one small JSON file a unit, arrays next to it, so that an interrupted command can continue."""

import json
from pathlib import Path

import numpy as np
from measurement import commit

from paper.experiment import Result, Unit


def _settings(unit: Unit) -> Result:
    """Return the settings as they are after a round trip through JSON."""
    return dict(json.loads(json.dumps(dict(unit.settings))))


def save(folder: Path, unit: Unit, result: Result) -> None:
    """Keep a unit's result; the JSON file is written last and says that all is there."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {key: value for key, value in result.items() if isinstance(value, np.ndarray)}
    plain = {key: value for key, value in result.items() if key not in arrays}
    if arrays:
        np.savez_compressed(folder / f"{unit.name}.npz", allow_pickle=False, **arrays)
    text = json.dumps({"commit": commit(), "settings": _settings(unit), "result": plain}, indent=1)
    beside = folder / f"{unit.name}.json.part"
    beside.write_text(text)
    beside.rename(folder / f"{unit.name}.json")


def load(folder: Path, unit: Unit) -> Result | None:
    """Load a unit's result, or return None where this commit has made none with its settings."""
    path = folder / f"{unit.name}.json"
    if not path.is_file():
        return None
    kept = json.loads(path.read_text())
    if (kept.get("commit"), kept["settings"]) != (commit(), _settings(unit)):
        return None
    result: Result = kept["result"]
    arrays = folder / f"{unit.name}.npz"
    if arrays.is_file():
        with np.load(arrays) as file:
            result |= {key: file[key] for key in file.files}
    return result
