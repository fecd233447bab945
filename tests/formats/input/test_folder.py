"""Folders of TIFF files: their order, what is missing from it, and what is not guessed."""

import numpy as np
import pytest
import tifffile
from scan_files import refused

from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.reading import reading_scan
from sawmill_vocabulary.reading_messages import ReadingMessage

STEPS = AngleSteps(0.0, 30.0)
GIVEN = {"counts": False, "angles_deg": STEPS}


@pytest.fixture
def folder(tmp_path, rng):
    """Twelve views, whose numbers are written without zeros before them, and the stack that they make."""
    images = rng.integers(1_000, 60_000, (12, 3, 8)).astype(np.uint16)
    (tmp_path / "views").mkdir()
    for index, image in enumerate(images):
        tifffile.imwrite(tmp_path / f"views/view_{index}.tif", image)
    return tmp_path / "views", images


def read(path):
    with reading_scan(path, **GIVEN) as scan:
        stack = np.full(scan.shape, np.nan, np.float32)
        for block in scan.blocks(1_000):
            stack[block.views, block.rows] = block.samples
        return stack, scan


def test_views_come_in_natural_order_in_blocks(folder):
    path, images = folder
    stack, scan = read(path)
    np.testing.assert_array_equal(stack, images)
    assert (scan.format, scan.remarks) == ("folder-of-tiffs", ())
    assert [each.name for each in scan.others] == [f"view_{index}.tif" for index in range(12)]
    assert scan.block_shape(1_000)[1] == 3  # whole images, a few at a time


def test_a_gap_in_the_numbers_is_reported(folder):
    path, images = folder
    for index in (3, 7):
        (path / f"view_{index}.tif").unlink()
    stack, scan = read(path)
    np.testing.assert_array_equal(stack, np.delete(images, (3, 7), axis=0))
    remark, turn = scan.remarks
    assert "leave out 3, 7 (2 of 12)" in remark
    assert (turn.message, turn.values["covered_deg"]) == (ReadingMessage.NO_WHOLE_TURN, "300")


def test_numbers_that_count_in_steps_have_no_gap(folder):
    path, _ = folder
    for index in range(11, -1, -1):
        (path / f"view_{index}.tif").rename(path / f"view_at_{30 * index:05}_of_turn_1.tif")
    assert read(path)[1].remarks == ()


def test_other_files_subfolders_and_forms_are_reported(folder):
    path, images = folder
    (path / "flats").mkdir()
    (path / "scan.log").write_text("at 120 kV")
    (path / "view_11.tif").rename(path / "last.tif")
    stack, scan = read(path)
    np.testing.assert_array_equal(stack, images[:11])
    assert scan.remarks[:3] == (
        "1 subfolders were not looked into (flats).",
        "1 files that are no TIFFs were ignored (scan.log).",
        ReadingMessage.IMAGES_LEFT_OUT(images=1, names="last.tif"),
    )


def test_fields_are_recognised_by_their_names_unless_they_are_given(folder):
    path, images = folder
    for name, image in (("io_0.tif", 60_000), ("dark_0.tif", 100)):
        tifffile.imwrite(path / name, np.full_like(images[0], image))
    for given in ({}, {"flats": path / "io_0.tif"}):
        with reading_scan(path, counts=True, angles_deg=STEPS, **given) as scan:
            assert (scan.shape, scan.flats.max(), scan.darks.max(), scan.remarks) == ((12, 3, 8), 60_000, 100, ())
    refused(path, "contradiction", "--darks", counts=True, angles_deg=STEPS, darks=path)


@pytest.mark.parametrize(
    ("text", "scale"), [(b'{"scale": 0.5, "offset": 1000}', 0.5), (b'{"scale": 0}', None), (b"", None)]
)
def test_images_that_were_packed_with_a_scale_and_an_offset_beside_them_are_unpacked(folder, text, scale):
    path, images = folder
    (path / "scaleoffset.json").write_bytes(text)
    if scale is None:
        refused(path, "unsupported-storage", "'scaleoffset.json'", **GIVEN)
        return
    stack, scan = read(path)
    np.testing.assert_allclose(stack, (images - 1000.0) / 0.5, rtol=1e-6)
    [remark] = scan.remarks
    assert remark == ReadingMessage.PIXELS_UNPACKED(names="scaleoffset.json", scale="2", offset="-2000")


@pytest.mark.parametrize(("image", "code"), [(np.zeros((4, 8), np.uint16), "wrong-shape"), (None, "broken-file")])
def test_the_file_that_differs_or_is_broken_is_named(folder, image, code):
    path, _ = folder
    (path / "view_5.tif").write_bytes(b"no TIFF at all")
    if image is not None:
        tifffile.imwrite(path / "view_5.tif", image)
    refused(path, code, "view_5.tif", **GIVEN)


def test_a_folder_without_images_a_dataset_and_what_does_not_fit_into_the_memory_are_refused(folder, tmp_path):
    refused(tmp_path, "unknown-format", **GIVEN)
    refused(folder[0], "contradiction", **GIVEN, dataset="views")
    refused(folder[0], "too-large", "at most", **GIVEN, max_bytes=1_000)
