"""Folders of TIFF files: their order, what is missing from it, and what is not guessed."""

import numpy as np
import pytest
import tifffile

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.reading import reading_scan

STEPS = AngleSteps(0.0, 20.0)


@pytest.fixture
def folder(tmp_path, rng):
    """Twelve views, whose numbers are written without zeros before them, and the stack that they make."""
    images = rng.integers(1_000, 60_000, (12, 3, 8)).astype(np.uint16)
    (tmp_path / "views").mkdir()
    for index, image in enumerate(images):
        tifffile.imwrite(tmp_path / f"views/view_{index}.tif", image)
    return tmp_path / "views", images


def read(path, **given):
    with reading_scan(path, counts=False, angles_deg=STEPS, **given) as scan:
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
    [remark] = scan.remarks
    assert "leave out 3, 7 (2 of 12)" in remark


def test_numbers_that_count_in_steps_have_no_gap(folder):
    path, _ = folder
    for index in range(11, -1, -1):
        (path / f"view_{index}.tif").rename(path / f"view_at_{30 * index:05}_of_turn_1.tif")
    assert read(path)[1].remarks == ()


def test_other_files_subfolders_and_forms_are_reported(folder):
    path, _ = folder
    (path / "flats").mkdir()
    (path / "scan.log").write_text("at 120 kV")
    (path / "view_11.tif").rename(path / "last.tif")
    remarks = read(path)[1].remarks
    assert remarks[:2] == ("1 subfolders were not looked into.", "1 files that are no TIFFs were ignored.")
    assert "2 forms (last.tif, view_#.tif)" in remarks[2]


def test_fields_are_not_guessed_from_names(folder):
    path, images = folder
    tifffile.imwrite(path / "flat_0.tif", images[0])
    code, sentence = refusal(path)
    assert code == "contradiction"
    assert "'flat_0.tif'" in sentence
    assert "--flats" in sentence


@pytest.mark.parametrize(("image", "code"), [(np.zeros((4, 8), np.uint16), "wrong-shape"), (None, "broken-file")])
def test_the_file_that_differs_or_is_broken_is_named(folder, image, code):
    path, _ = folder
    (path / "view_5.tif").write_bytes(b"no TIFF at all")
    if image is not None:
        tifffile.imwrite(path / "view_5.tif", image)
    refused, sentence = refusal(path)
    assert refused == code
    assert "view_5.tif" in sentence


def test_a_folder_without_images_and_a_dataset_are_refused(folder, tmp_path):
    assert refusal(tmp_path)[0] == "unknown-format"
    assert refusal(folder[0], dataset="views")[0] == "contradiction"


def test_what_does_not_fit_into_the_memory_is_refused(folder):
    code, sentence = refusal(folder[0], max_bytes=1_000)
    assert code == "too-large"
    assert "at most" in sentence


def refusal(path, **given):
    with pytest.raises(UnreadableScan) as refused:
        read(path, **given)
    return refused.value.code, str(refused.value)
