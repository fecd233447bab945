"""TIFF files whose images stand where no page names them."""

import numpy as np
import pytest
import tifffile

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.tiff.pages import open_pages

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
