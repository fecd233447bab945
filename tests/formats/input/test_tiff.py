"""TIFF files whose images stand where no page names them, or whose tags change what the numbers mean."""

from zipfile import ZipFile

import numpy as np
import pytest
import tifffile
from scan_files import refused
from tifffile import _imagecodecs

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.arrays import PACKBITS, Bounds
from sawmill_formats.input.reading import reading_contents, reading_scan
from sawmill_formats.input.tiff.pages import open_pages
from sawmill_vocabulary.reading_messages import ReadingMessage

STACK = np.arange(12 * 4 * 16, dtype=np.uint16).reshape(12, 4, 16)
BOUNDS = Bounds(array=2**20, piece=2**20)


def shape_of(path):
    with open_pages(path, "the file", path.stat().st_size, BOUNDS) as pages:
        return pages.shape


@pytest.mark.parametrize("dialect", [{"imagej": True}, {}], ids=["imagej", "tifffile"])
def test_images_behind_a_single_page_are_not_left_out_in_silence(tmp_path, dialect):
    tifffile.imwrite(tmp_path / "whole.tif", STACK, **dialect)
    tifffile.imwrite(tmp_path / "truncated.tif", STACK, truncate=True, **dialect)
    assert shape_of(tmp_path / "whole.tif") == STACK.shape
    with pytest.raises(UnreadableScan, match="has one page, and more images behind it"):
        shape_of(tmp_path / "truncated.tif")


def test_a_page_that_was_taken_from_a_stack_is_read_though_it_still_speaks_of_the_others(tmp_path):
    with tifffile.TiffWriter(tmp_path / "one.tif") as one:
        one.write(STACK[0], description="ImageJ=1.53\nimages=12\n", metadata=None)
    assert shape_of(tmp_path / "one.tif") == (1, 4, 16)


@pytest.mark.parametrize("counts", [1, 2], ids=["left out", "empty"])
@pytest.mark.parametrize("options", [{"rowsperstrip": 2}, {"tile": (16, 16)}], ids=["strips", "tiles"])
def test_a_page_that_lacks_a_strip_or_tile_is_refused(tmp_path, options, counts):
    stack = np.ones((4, 4, 32), np.uint16)
    tifffile.imwrite(tmp_path / "short.tif", stack, photometric="minisblack", compression="zlib", **options)
    assert shape_of(tmp_path / "short.tif") == stack.shape
    kind = "Tile" if "tile" in options else "Strip"
    with tifffile.TiffFile(tmp_path / "short.tif", mode="r+") as file:
        tags = file.pages[1].tags
        tags[f"{kind}ByteCounts"].overwrite([tags[f"{kind}ByteCounts"].value[0], 0][:counts])
        tags[f"{kind}Offsets"].overwrite([tags[f"{kind}Offsets"].value[0], 0][:counts])
    with pytest.raises(UnreadableScan, match="page 1 of the file has 1 of its 2 strips or tiles") as refusal:
        shape_of(tmp_path / "short.tif")
    assert refusal.value.code == "truncated-file"


UNPACKED, INVERTED = ReadingMessage.PIXELS_UNPACKED, ReadingMessage.WHITE_IS_ZERO


def imagej(function):
    return {"description": f"ImageJ=1.53t\nimages=12\nslices=12\n{function}vunit=Gray Value\n"}


def tag(code, kind, value):
    return {"extratags": [(code, kind, 0 if kind == 2 else 1, value, True)]}


def meant(stored, options, values, *remarks):
    """Stored numbers, options of the writer, the values that they mean, and the remarks."""
    return stored, options, values, remarks


MEANINGS = {
    "min is white": meant(65_535 - STACK, {"photometric": "miniswhite"}, STACK, INVERTED(largest=65_535)),
    "min is white, 8 bits": meant(
        (255 - STACK % 256).astype(np.uint8), {"photometric": "miniswhite"}, STACK % 256, INVERTED(largest=255)
    ),
    "min is white, floating-point": meant(
        STACK.astype(np.float32), {"photometric": "miniswhite"}, STACK, ReadingMessage.WHITE_IS_ZERO_UNUSED()
    ),
    "from the right": meant(STACK[..., ::-1], tag(274, 3, 2), STACK, ReadingMessage.ORIENTATION(orientation=2)),
    "upside down": meant(STACK[:, ::-1, ::-1], tag(274, 3, 3), STACK, ReadingMessage.ORIENTATION(orientation=3)),
    "from below": meant(STACK[:, ::-1], tag(274, 3, 4), STACK, ReadingMessage.ORIENTATION(orientation=4)),
    "as it is": meant(STACK, tag(274, 3, 1), STACK),
    "signed numbers": meant(STACK.astype(np.int16) - 300, {}, STACK - 300.0),
    "signed numbers of ImageJ": meant(
        STACK + 32_768,
        imagej("cf=0\nc0=-32768.0\nc1=1.0\n"),
        STACK,
        UNPACKED(names="ImageJ (c1, c0)", scale="1", offset="-32768"),
    ),
    "signed numbers of ImageJ, min is white": meant(
        65_535 - STACK,
        imagej("cf=0\nc0=-7\nc1=0.5\n") | {"photometric": "miniswhite"},
        STACK / 2 - 7.0,
        INVERTED(largest=65_535),
        UNPACKED(names="ImageJ (c1, c0)", scale="0.5", offset="-7"),
    ),
    "32-bit numbers of ImageJ": meant(STACK.astype(np.float32), imagej("cf=0\nc0=5\nc1=2\n"), STACK),
    "no function of ImageJ": meant(STACK, imagej("min=0\nmax=9\n"), STACK),
}


def paged(path, stack, options):
    with tifffile.TiffWriter(path) as file:
        for image in stack:
            file.write(image, contiguous=False, metadata=None, **{"photometric": "minisblack"} | options)


@pytest.mark.parametrize(("stored", "options", "values", "remarks"), MEANINGS.values(), ids=MEANINGS)
def test_tags_and_descriptions_that_change_the_values_are_followed(tmp_path, stored, options, values, remarks):
    paged(tmp_path / "scan.tif", stored, options)
    with reading_contents(tmp_path / "scan.tif") as contents:
        np.testing.assert_array_equal(contents.projections.read(slice(0, 12), slice(1, 3)), values[:, 1:3])
        assert [(each.message, each.values) for each in contents.remarks] == [
            (each.message, each.values) for each in remarks
        ]


def test_fields_of_another_convention_are_read_by_their_own_tags(tmp_path):
    paged(tmp_path / "scan.tif", STACK, {})
    paged(tmp_path / "flats.tif", 65_535 - STACK[:, ::-1], {"photometric": "miniswhite"} | tag(274, 3, 4))
    with reading_contents(tmp_path / "scan.tif", flats=tmp_path / "flats.tif") as contents:
        np.testing.assert_array_equal(contents.flats, STACK)
    with ZipFile(tmp_path / "scan.zip", "w") as archive:
        for n, image in enumerate(STACK):
            paged(tmp_path / "view.tif", 65_535 - image[np.newaxis], {"photometric": "miniswhite"})
            archive.write(tmp_path / "view.tif", f"view_{n}.tif")
    with reading_contents(tmp_path / "scan.zip") as contents:
        np.testing.assert_array_equal(contents.projections.read(slice(0, 12), slice(0, 4)), STACK)
        assert [(each.message, each.values) for each in contents.remarks] == [(INVERTED, {"largest": 65_535})]


COLOURS = {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)}
REFUSED = {
    "palette": (COLOURS, "wrong-type", "PhotometricInterpretation 3"),
    "colour filter": ({"photometric": 32803}, "wrong-type", "PhotometricInterpretation 32803"),
    "rows as columns": (tag(274, 3, 6), "unsupported-storage", "Orientation 6"),
    "a curve of ImageJ": (imagej("cf=3\nc0=1\nc1=1\n"), "unsupported-storage", "function '3' of ImageJ"),
    "no number of ImageJ": (imagej("cf=0\nc0=NaN\nc1=1\n"), "unsupported-storage", "'NaN'"),
}


@pytest.mark.parametrize(("options", "code", "named"), REFUSED.values(), ids=REFUSED)
def test_numbers_whose_meaning_cannot_be_followed_are_refused_by_their_tag(tmp_path, options, code, named):
    paged(tmp_path / "scan.tif", STACK.astype(np.uint8), options)
    with pytest.raises(UnreadableScan) as refusal:
        shape_of(tmp_path / "scan.tif")
    assert refusal.value.code == code
    assert named in str(refusal.value)


def test_the_walk_through_packbits_ends_with_any_bytes_and_where_it_is_too_much():
    rng = np.random.default_rng(4)
    for _ in range(50):
        packed = rng.bytes(200) + bytes(130)  # whatever comes last, its data follow
        assert abs(PACKBITS.unpacked(packed, 10**9) - len(_imagecodecs.packbits_decode(packed))) <= 128
    packed = b"\x81\0" * 10_000
    assert 1000 < PACKBITS.unpacked(packed, 1000) < 1300
    assert PACKBITS.unpacked(packed, 10**9) == 1_280_000


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
