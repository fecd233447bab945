"""`sawmill simulate --physics`, and the same from Python."""

import json

import h5py
import numpy as np
import pytest

import sawmill_calibration as sawmill
from sawmill_calibration import InputError

THETA = ("--theta", "2.55,714.7,319.9,43.7,0.281")
SMALL = (*THETA, "--detector-pixels", 256, "--detector-pitch-mm", 4.508593749, "--views", 12)
SCANNER = sawmill.Scanner(859.46, 256, 4.508593749)
SLIPPED = {"motion": {"slip_mm": 20.0, "slip_at": 0.5}, "detector": {"bits": 12}}


def frames(path, key: int = 0) -> np.ndarray:
    with h5py.File(path) as file:
        detector = file["entry/instrument/detector"]
        return detector["data"][()][detector["image_key"][()] == key]


@pytest.fixture
def physics_file(tmp_path):
    def write(content: object):
        path = tmp_path / "physics.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def test_counts_show_what_the_file_names(run, tmp_path, physics_file):
    """Nothing until the slip in the middle; then 20 mm, some eight cells, at the shadow's edges. Twelve bits."""
    for name, content in (("still", {"detector": {"bits": 12}}), ("slipped", SLIPPED)):
        flags = ("--physics", physics_file(content), *SMALL, "--rows", 2)
        run("simulate", "l-shape", *flags, "-o", tmp_path / f"{name}.h5")
    still, slipped = (frames(tmp_path / f"{name}.h5").astype(float) for name in ("still", "slipped"))
    assert still.shape == slipped.shape == (12, 2, 256)
    assert np.array_equal(still[:6], slipped[:6])
    assert (np.abs(still - slipped)[6:].max(axis=(1, 2)) > 500).all()
    assert slipped.max() <= 4095
    assert len(frames(tmp_path / "slipped.h5", 1)) == 10


def test_python_reads_the_same_scan(run, tmp_path, physics_file):
    path = physics_file(SLIPPED)
    run("simulate", "l-shape", "--physics", path, *SMALL, "-o", tmp_path / "out.h5")
    read = sawmill.read_scan(tmp_path / "out.h5", data="counts", source_to_cor_mm=859.46)
    theta = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
    for physics in (SLIPPED, path):
        made = sawmill.simulate_phantom_scan("l-shape", SCANNER, theta, views=12, physics=physics)
        np.testing.assert_array_equal(made.line_integrals, read.line_integrals)
        assert made.from_counts


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"beam": {"blur": 1}}, "beam.blur: Extra inputs are not permitted"),
        ({"motion": {"slip_mm": -1}}, "motion.slip_mm: Input should be greater than or equal to 0"),
        ({"detector": {"bits": 14}}, "detector.bits: Input should be 12 or 16"),
        ("slip", "Invalid JSON"),
    ],
)
def test_what_is_no_physics_is_refused(run, tmp_path, physics_file, content, complaint):
    flags = ("--physics", physics_file(content), *SMALL, "-o", tmp_path / "out.h5")
    assert complaint in run("simulate", "l-shape", *flags, code=1).output
    assert not (tmp_path / "out.h5").exists()


def test_physics_are_of_counts(wrong_use, tmp_path, physics_file):
    flags = ("--physics", physics_file({}), "--data", "line-integrals", *SMALL, "-o", tmp_path / "out.h5")
    assert "--physics makes counts: leave --data line-integrals out." in wrong_use("simulate", "l-shape", *flags)
    theta = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
    with pytest.raises(InputError, match="give physics, or noise and background, not both"):
        sawmill.simulate_phantom_scan("l-shape", SCANNER, theta, physics={}, noise=0.1)
    with pytest.raises(InputError, match=r"wood\.rings: Extra inputs"):
        sawmill.simulate_phantom_scan("l-shape", SCANNER, theta, physics={"wood": {"rings": 3}})
