"""The flags that prepare a scan: `--air`, `--faulty-cells`, `--rings`, `--align-rows`."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from sawmill_contracts.scans import PrepareOptions

THETA = "2.55,714.7,319.9,43.7,0.281"
SCANNER = ("--source-to-cor-mm", 859.46, "--detector-pitch-mm", 9.0)
ROWS, LOST = 40, 5


@pytest.fixture(scope="session")
def lossy(run, scans):
    """Line integrals of a log, 0.2 too high, each view without some rows at the top and the bottom; the losses."""
    whole, path = scans / "log.h5", scans / "lossy.npz"
    body = ("log", "--theta", THETA, "--data", "line-integrals", "--rows", ROWS, "--row-pitch-mm", 3, "--noise", 0.002)
    run("simulate", *body, *SCANNER, "--detector-pixels", 128, "--views", 36, "--background", 0.2, "-o", whole)
    with h5py.File(whole) as file:
        views = file["entry/instrument/detector/data"][()]
        angles = file["entry/sample/rotation_angle"][()]
    lost = np.full_like(views, np.nan)
    top, bottom = np.random.default_rng(71).integers(0, LOST, (2, len(views)))
    for view in range(len(views)):
        kept = ROWS - top[view] - bottom[view]
        lost[view, :kept] = views[view, top[view] : top[view] + kept]
    np.savez(path, projections=lost, angles_deg=angles)
    return path, top, bottom


def reconstruct(run, path, output, *flags, code=0):
    given = ("--theta", THETA, *SCANNER, "--data", "line-integrals", "--size", 32)
    return json.loads(run("reconstruct", path, *given, "-o", output, "--json", *flags, code=code).stdout)


def test_views_that_lost_rows_are_reconstructed_when_asked(run, lossy, tmp_path):
    path, top, bottom = lossy
    output = tmp_path / "out.h5"
    answer = reconstruct(run, path, output, "--align-rows", "profile", "--air", "background", "--rings", "sorting")
    rows = np.arange(ROWS)[:, None]
    views = ((rows >= top) & (rows < ROWS - bottom)).sum(axis=1)
    first, last = np.flatnonzero(views >= 18)[[0, -1]]
    # All rows that half of the 36 views have, by their own numbers.
    assert answer["rows"] == [first, last + 1]
    assert answer["shape"] == [last + 1 - first, 32, 32]
    assert answer["fewest_views"] == views[first : last + 1].min() < answer["views"]
    air, rings, aligned = answer["coded_preparation"]
    assert (air["code"], round(air["values"]["level"], 1), rings["code"]) == ("air-level", 0.2, "rings-removed")
    assert aligned["code"].startswith("rows-aligned")
    assert (aligned["values"]["first"], aligned["values"]["last"], aligned["values"]["rows"]) == (first, last + 1, 40)
    with h5py.File(output) as file:
        assert list(file["entry/process/parameters/preparation"].asstr()) == answer["preparation"]


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (("--align-rows", "profile", "--rows", "0:8"), "rows 0:8 were asked for, but too many views lost some of them"),
        ((), "(--align-rows)"),
    ],
    ids=["rows that too few views have", "views of unequal rows as they are"],
)
def test_lost_rows_are_refused_with_their_numbers_or_the_flag(run, lossy, tmp_path, flags, sentence):
    assert sentence in json.dumps(reconstruct(run, lossy[0], tmp_path / "out.h5", *flags, code=1))


def test_the_document_has_every_parameter_with_its_flag_and_values():
    page = (Path(__file__).parents[2] / "docs/understand/preparation.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| `(--[\w-]+)` \| ([^|]+) \|", page, re.MULTILINE)
    assert [(name, flag) for name, flag, _ in rows] == [
        (name, "--" + name.replace("_", "-")) for name in ("faulty_cells", "air", "rings", "align_rows")
    ]
    for name, _, values in rows:
        default = PrepareOptions.model_fields[name].default
        first, *others = re.findall(r"`([\w-]+)`", values)
        assert first == default
        assert {first, *others} == set(type(default))
