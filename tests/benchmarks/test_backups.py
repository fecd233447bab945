"""The price of backups: a small study that measures everything, and the bound for many small files."""

import json

import backups
import pytest


def study(folder, *arguments):
    backups.main(["--results", str(folder), "--folder", str(folder), *arguments], reference=lambda: 1.0)
    return json.loads((folder / "backups.json").read_text())["values"]


@pytest.mark.nightly
def test_a_small_study_measures_everything(tmp_path):
    values = study(tmp_path, "--files", "20", "--file-bytes", "1000")
    parts = {f"{part}_{kind}_s" for part in backups.PARTS for kind in ("processor", "clock")}
    assert "| `restore` |" in values.pop("table")
    assert values.keys() == {"files", "file_bytes", *parts}
    assert min(values.values()) > 0.0


@pytest.mark.nightly
def test_58_000_small_files_take_a_minute_of_processor_at_most_and_unchanged_ones_a_tenth(tmp_path):
    values = study(tmp_path)
    assert values["first_processor_s"] < 60.0
    assert values["unchanged_processor_s"] < 6.0
