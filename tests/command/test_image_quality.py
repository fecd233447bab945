"""`sawmill image-quality`: a scan of a disc on the command line, and the measured solid disc of the page."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scan_files import published_data  # noqa: F401 - fixture

import sawmill_calibration as sawmill
from sawmill_vocabulary import Theta

GEOMETRY = ("--theta", "2.55,714.7,319.9,43.7,0.281", "--source-to-cor-mm", 859.46)
FIELD = ("--data", "line-integrals", "--size", 256, "--field-mm", 200)
PAGE = Path(__file__).parents[2] / "docs/do/image-quality.md"


@pytest.fixture(scope="module")
def disc_scan(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("disc")
    shape = {"kind": "disc", "center_mm": [3.0, -2.0], "radius_mm": 80.0, "density": 1.0}
    (folder / "disc.json").write_text(json.dumps({"name": "disc", "shapes": [shape]}))
    flags = ("--data", "line-integrals", "--noise", 0.01, "--rows", 2, "--detector-pitch-mm", 1.5)
    run("simulate", folder / "disc.json", *GEOMETRY, *flags, "-o", folder / "disc.h5")
    return folder / "disc.h5"


def test_the_page_s_command_measures_a_disc_in_a_calibrated_scanner(run, result_file, disc_scan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(result_file, "result.json")
    wide = (*GEOMETRY, "--detector-pixels", 256, "--detector-pitch-mm", 4.508593749, "--data", "line-integrals")
    run("simulate", disc_scan.with_suffix(".json"), *wide, "-o", "disc.h5")
    (block,) = re.findall(r"^```sh\nsawmill (.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    radius_mm, pixel_mm = map(float, re.findall(r"\d+\.\d+", run(*block.split()).stdout.splitlines()[0]))
    assert (radius_mm, pixel_mm) == pytest.approx((80.0, 0.3906), abs=0.1)


def test_the_command_and_python_measure_the_same(run, disc_scan):
    answer = json.loads(run("image-quality", disc_scan, *GEOMETRY, *FIELD, "--json").stdout)
    scan = sawmill.read_scan(disc_scan, data="line-integrals", source_to_cor_mm=859.46)
    made = sawmill.reconstruct(scan, Theta(2.55, 714.7, 319.9, 43.7, 0.281), method="fbp", size=256, field_mm=200.0)
    quality = made.image_quality()
    assert (answer["mtf_10_per_mm"], answer["radius_mm"]) == (quality.mtf_10_per_mm, quality.radius_mm)
    assert answer["contrast_percent"] == list(quality.contrast_percent)
    assert (answer["options"]["method"], answer["options"]["filter"]) == ("fbp", "hann")
    shown = run("image-quality", disc_scan, *GEOMETRY, *FIELD).stdout
    assert f"MTF at 10 %: {quality.mtf_10_per_mm:.4g} per mm" in shown
    assert f"patches of {quality.patch_mm[1]:.3g} mm: {quality.contrast_percent[1]:.3g} %" in shown


def test_a_phantom_is_no_disc_and_a_disc_needs_a_geometry(failure, wrong_use, phantom_scan, disc_scan):
    refused = failure("image-quality", phantom_scan, *GEOMETRY, *FIELD)
    assert "no plain disc is seen" in refused["detail"]
    assert "cannot calibrate" in refused["detail"]
    assert "--calibration" in wrong_use("image-quality", disc_scan, *FIELD)


def test_the_measured_solid_disc_has_the_page_s_numbers(published_data, run, tmp_path):  # noqa: F811 - the fixture
    discs = published_data / "measured-discs/discs-90views.npz"
    if not discs.is_file():
        pytest.skip(f"the measured discs are not in {published_data}: docs/understand/measured.md has how to get them")
    held = np.load(discs)
    solid = held["sinograms"][held["names"].tolist().index("solid_disc")]
    np.savez(tmp_path / "solid-disc.npz", data=solid, angles_deg=held["angles_deg"])
    (line,) = re.findall(
        r"^sawmill image-quality solid-disc.npz (.*)$", PAGE.read_text().replace("\\\n", ""), re.MULTILINE
    )
    shown = run("image-quality", tmp_path / "solid-disc.npz", *line.split()).stdout
    (stated,) = re.findall(r"^```text\n(disc: .*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    numbers = [[float(number) for number in re.findall(r"\d+\.?\d*", text)] for text in (shown, stated)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.01)
