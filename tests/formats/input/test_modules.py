"""NXdetector_module groups, written from where the cells of a bent detector are."""

import math
from functools import partial
from itertools import pairwise

import h5py
import numpy as np
import pytest
from tests.support.exact_chords import Detector

from sawmill_formats.input.reading import reading_scan
from sawmill_formats.output.scan_reader import open_scan
from sawmill_formats.output.scan_writer import new_scan
from sawmill_vocabulary import DetectorModule, SourceFrame

CELLS, PITCH_MM, VIEWS = 40, 1.5, 4
FRAME = SourceFrame(0.3, 917.1, 1619.3, -7.1, -0.083)
MODULES = (DetectorModule(9, 0.4, 0.02), DetectorModule(18, -0.1, -0.01), DetectorModule(31, 1.3, 0.03))


def write(path, modules, *, mirrored=False, change=lambda _detector: None):
    """Write line integrals by NXtomo, with the modules where the cells' borders are in the laboratory."""
    fine = Detector(CELLS, PITCH_MM, modules).points(FRAME, 1000)
    first, last = fine[:, 0], fine[:, -1]
    first_cells = [0, *(module.first_cell for module in modules), CELLS]
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry["definition"] = "NXtomo"
        detector = entry.create_group("instrument/detector")
        detector["data"] = np.random.default_rng(1).random((VIEWS, 1, CELLS)).astype(np.float32)
        detector["image_key"] = np.zeros(VIEWS, int)
        detector["x_pixel_size"] = PITCH_MM
        detector["x_pixel_size"].attrs["units"] = "mm"
        entry["sample/rotation_angle"] = 90.0 * np.arange(VIEWS)
        entry["sample/rotation_angle"].attrs["units"] = "deg"
        for number, (begin, end) in enumerate(pairwise(first_cells)):
            group = detector.create_group(f"some name {number}")
            group.attrs["NX_class"] = "NXdetector_module"
            group["data_origin"], group["data_size"] = [0, begin], [1, end - begin]
            # The detector stands anywhere; its cells may count from either side.
            across, along = last[begin] - first[begin]
            way = np.array([-across if mirrored else across, 0.0, along]) / math.hypot(across, along)
            at = np.array([30.0 + (-1.0 if mirrored else 1.0) * first[begin, 0], -4.0, first[begin, 1]])
            for name, length_m, vector in (
                ("module_offset", 1e-3 * np.linalg.norm(at), at / np.linalg.norm(at)),
                ("fast_pixel_direction", 1e-3 * PITCH_MM, way),
            ):
                group[name] = length_m
                group[name].attrs["units"] = "m"
                group[name].attrs["vector"] = vector
                group[name].attrs["depends_on"] = "."
        change(detector)


def values(modules):
    return np.array([(module.first_cell, module.gap_mm, module.kink_rad) for module in modules])


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("modules", [MODULES, MODULES[:1], MODULES[2:]])
def test_gaps_and_kinks_are_read_from_where_the_modules_are(tmp_path, modules, mirrored):
    write(tmp_path / "scan.nxs", modules, mirrored=mirrored)
    with reading_scan(tmp_path / "scan.nxs", counts=False) as scan:
        assert scan.remarks == ()
        # The test's borders are half of a thousandth of a cell off.
        np.testing.assert_allclose(values(scan.detector_modules), values(modules), atol=1e-3)


def test_one_module_is_a_straight_detector(tmp_path):
    write(tmp_path / "scan.nxs", ())
    with reading_scan(tmp_path / "scan.nxs", counts=False) as scan:
        assert (scan.detector_modules, scan.remarks) == ((), ())


def spoil(how, detector):  # noqa: C901 - a case for each way
    part = "some name {}/{}".format
    first, last = detector[part(1, "module_offset")], detector[part(3, "module_offset")]
    match how:
        case "shifted":
            first.attrs["vector"] = [0.0, 0.0, 1.0]
        case "behind the others":
            at = last[()] * last.attrs["vector"] + [0.0, 0.0, 2e-3]
            last[()], last.attrs["vector"] = np.linalg.norm(at), at / np.linalg.norm(at)
        case "too many":
            for number in range(1_000):
                detector.copy("some name 0", f"another name {number}")
        case "shorter":
            detector[part(3, "data_size")][1] -= 1
        case "coarser":
            detector[part(2, "fast_pixel_direction")][()] *= 2
        case "without a unit":
            del detector[part(0, "module_offset")].attrs["units"]
        case "along the beam":
            for number in range(4):
                detector[part(number, "fast_pixel_direction")].attrs["vector"] = [0.0, 0.0, 1.0]
        case "one missing":
            del detector["some name 1"]
        case "not finite":
            first[()] = np.nan
        case "of fractions":
            del detector[part(1, "data_origin")]
            detector[part(1, "data_origin")] = [0.0, 8.5]


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("shifted", "at cell 9 they are"),
        ("behind the others", "at cell 31 they are 1.99 mm out of line"),
        ("too many", "there are more than 64"),
        ("shorter", "they have 39 cells, and the images have 40"),
        ("coarser", "their cells are 3 mm apart by fast_pixel_direction, and x_pixel_size is 1.5 mm"),
        ("without a unit", "the module_offset of one is no length with a unit, along a vector"),
        ("along the beam", "their cells follow one another along z, the direction of the beam"),
        ("one missing", "one begins at cell 18, and the one before ends at cell 9"),
        ("not finite", "the module_offset of one is no finite number"),
        ("of fractions", "one begins at cell 8.5 and has 9 cells"),
    ],
)
def test_modules_that_state_no_gaps_are_ignored_and_that_is_said(tmp_path, how, said):
    write(tmp_path / "scan.nxs", MODULES, change=partial(spoil, how))
    with reading_scan(tmp_path / "scan.nxs", counts=False) as scan:
        assert scan.detector_modules == ()
        (remark,) = scan.remarks
        assert remark.startswith("The detector's modules in instrument/detector were ignored: ")
        assert said in remark


@pytest.mark.parametrize("modules", [MODULES, MODULES[:1], MODULES[2:], ()])
def test_a_scan_of_ours_keeps_its_modules(tmp_path, modules):
    path, stack = tmp_path / "scan.h5", np.ones((VIEWS, 1, CELLS), np.float32)
    angles_rad = np.deg2rad(90.0 * np.arange(VIEWS))
    about = {"detector_pitch_mm": PITCH_MM, "row_pitch_mm": None, "detector_modules": modules}
    about["detector_arc_radius_mm"] = 20.0
    with new_scan(path, stack.shape, angles_rad=angles_rad, **about) as written:
        written.data[...] = stack
        written.note(air_level=None, provenance={})
    with open_scan(path) as own, reading_scan(path, counts=False) as read:
        np.testing.assert_allclose(values(own.detector_modules), values(modules), atol=1e-12)
        np.testing.assert_allclose(values(read.detector_modules), values(modules), atol=1e-12)
        assert own.detector_arc_radius_mm == read.detector_arc_radius_mm == 20.0


@pytest.mark.parametrize(
    ("radius", "unit", "why"), [(1.9, "cm", "it is 19 mm"), (-1, "m", "it is -1000"), (1, "s", "'s'")]
)
def test_an_arc_of_more_than_half_a_circle_is_ignored_and_that_is_said(tmp_path, radius, unit, why):
    def bend(detector):
        detector["arc_radius"] = radius
        detector["arc_radius"].attrs["units"] = unit

    write(tmp_path / "scan.nxs", (), change=bend)
    with reading_scan(tmp_path / "scan.nxs", counts=False) as scan:
        assert scan.detector_arc_radius_mm is None
        assert why in str(scan.remarks)
