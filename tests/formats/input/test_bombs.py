"""Small files that ask for gigabytes or hours: refused at once, in little memory, with one sentence."""

import struct

import h5py
import numpy as np
import pytest
import tifffile
from hostile import MEBIBYTE, archive_of, checkers, chunk_of, deflated, deflated_twice, outcome, pages_of, tiles_of
from PIL import Image

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.picture import BYTES_A_PIXEL, read_picture
from sawmill_formats.input.reading import reading_scan

# What the refusals may take beyond the idle process. Most take a thousandth; a 64-million-pixel picture is the largest.
# `hostile` limits their processor seconds.
MOST_MEBIBYTES = 600


def refused(file, code, *words, **options):
    found = outcome(file, **options)
    assert found.code == code, found
    assert found.mebibytes < MOST_MEBIBYTES, found
    assert found.verdict in {"refused", "incomplete"}, found
    assert "\n" not in found.sentence
    assert "pickle" not in found.sentence
    for word in words:
        assert word in found.sentence, found
    return found


class TestHdf5:
    def test_a_definition_of_2_gb(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_group("entry").create_dataset("definition", (), "S2000000000")
        assert file.stat().st_size < 20_000
        refused(file, "too-large", "'definition' claims to have 2000000000 bytes", "at most")

    def test_a_definition_whose_chunk_inflates_to_2_gib(self, file):
        with h5py.File(file, "w") as h5:
            text = h5.create_group("entry").create_dataset("definition", (1,), "S8", chunks=(1,), compression=9)
            text.id.write_direct_chunk((0,), deflated(b"", 2**31))
        refused(file, "too-large", "'definition' declares 8 bytes of data while the file stores 2")

    def test_deflate_twice(self, file):
        deflated_twice(file, 2**28)
        assert file.stat().st_size < 30_000
        refused(file, "unsupported-storage", "'data' is packed twice", "(deflate, deflate)", "pack it once")

    def test_more_filters_than_anybody_needs(self, file):
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_chunk((20, 1, 768))
        for _ in range(10):
            layout.set_shuffle()
        with h5py.File(file, "w") as h5:
            data = h5py.h5d.create(h5.id, b"data", h5py.h5t.NATIVE_FLOAT, h5py.h5s.create_simple((20, 1, 768)), layout)
            data.write_direct_chunk((0, 0, 0), bytes(4 * 20 * 768))
        refused(file, "unsupported-storage", "'data' is stored with 10 filters", "at most 3")

    def test_a_chunk_stored_in_what_it_declares_that_inflates_to_4_gib(self, file):
        stored = deflated(b"", 2**32)
        chunk_of(file, stored, (20, 70, 768))
        assert len(stored) <= 4 * 20 * 70 * 768
        refused(file, "too-large", "of '/data' declares 4300800 bytes of data and holds more")

    def test_lzf_that_unpacks_to_380_mb_and_is_unpacked_88_times(self, file):
        """The library unpacks into as much as was stored, then into twice as much, each time from the beginning."""
        chunk_of(file, b"\0\0" + b"\xe0\xff\0" * 1_433_598, (20, 70, 768), packing=h5py.h5z.FILTER_LZF)
        refused(file, "too-large", "of '/data' declares 4300800 bytes of data and holds more")

    def test_lzf_whose_filter_claims_4_gib(self, file):
        chunk_of(file, bytes(1000), (20, 1, 768), packing=h5py.h5z.FILTER_LZF)
        stored = file.read_bytes()
        at = stored.index(struct.pack("<I", 4 * 20 * 768), stored.index(b"lzf\0"))
        file.write_bytes(stored[:at] + struct.pack("<I", 2**32 - 1) + stored[at + 4 :])
        refused(file, "truncated-file", "of '/data' declares 61440 bytes of data and holds less")

    def test_szip_which_only_the_library_unpacks(self, file):
        chunk_of(file, struct.pack("<I", 2**31 - 1) + bytes(1000), (20, 70, 768), packing=h5py.h5z.FILTER_SZIP)
        refused(file, "unsupported-storage", "'data' is stored with the filter szip (4); repack it with gzip")

    @pytest.mark.parametrize("packing", ["lzf", "gzip"])
    def test_large_chunks_that_unpack_to_what_they_declare_are_read(self, file, packing):
        """Beyond what is harmless however it unpacks, 0.7 MB of LZF."""
        data = np.random.default_rng(3).integers(0, 9, (20, 300, 768)).astype(np.uint16)
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", data=data, chunks=data.shape, compression=packing)
        with reading_scan(file, counts=False, angles_deg=AngleSteps(0.0, 18.0)) as scan:
            (block,) = scan.blocks(2**26)
            np.testing.assert_array_equal(block.samples, data)

    def test_flats_of_5_gb_as_float32(self, file):
        data, chunk = np.ones((20, 100, 768), np.float32), (1024, 1, 1024)
        piece = deflated(b"", MEBIBYTE)
        with h5py.File(file, "w") as h5:
            h5["data"] = data
            flats = h5.create_dataset("flats", (1024, 1200, 1024), "u1", chunks=chunk, compression=9)
            for row in range(1200):
                flats.id.write_direct_chunk((0, row, 0), piece)
        refused(file, "too-large", "'flats' needs 5033164800 bytes as float32", counts=True)

    def test_flats_of_zeros_that_fit_into_the_memory(self, file):
        with h5py.File(file, "w") as h5:
            h5["data"] = np.ones((20, 100, 768), np.float32)
            flats = h5.create_dataset("flats", (200, 1000, 1024), "u1", chunks=(200, 1, 1024), compression=9)
            piece = deflated(bytes(200 * 1024), 0)
            for row in range(1000):
                flats.id.write_direct_chunk((0, row, 0), piece)
        refused(file, "too-large", "'flats' declares 204800000 bytes", "at most 200 times as many", counts=True)

    def test_twenty_thousand_members(self, file):
        with h5py.File(file, "w", libver="latest") as h5:
            h5["data"] = np.ones((20, 1, 768), np.float32)
            for number in range(4):
                group = h5.create_group(f"group {number}")
                group["first"] = 1.0
                for link in range(5_000):
                    group.id.links.create_hard(b"%d" % link, group.id, b"first")
        refused(file, "too-large", "the file has more than 10000 groups and datasets", "leave out what is no part")

    def test_two_hundred_entries_are_refused_in_one_short_sentence(self, file):
        with h5py.File(file, "w") as h5:
            for number in range(200):
                h5[f"entry {number}/definition"] = "NXtomo"
        found = refused(file, "dataset-ambiguous", "several NXtomo entries (/entry 0, ", "the right one with dataset")
        assert len(found.sentence) < 1010

    def test_names_that_are_no_utf8_are_no_obstacle(self, file):
        with h5py.File(file, "w") as h5:
            h5["data"] = np.ones((20, 1, 768), np.float32)
            for name in (b"Holz f\xfcr S\xe4ge", b"\xff\xfe"):
                h5py.h5d.create(h5.id, name, h5py.h5t.NATIVE_FLOAT, h5py.h5s.create_simple((3,)))
        assert outcome(file).code == "read"

    def test_a_name_of_60_kb(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_group("a" * 60_000)
        refused(file, "too-large", "a name in the group '/' has 60000 bytes; at most 1024 are read")


class TestPictures:
    def test_checkers(self, file):
        picture = file.with_suffix(".png")
        checkers(picture)
        assert picture.stat().st_size < 20_000
        refused(picture, "PhantomError", "pixel sides; at most 1000000 are traced", "a clean drawing")

    @pytest.mark.slow
    def test_more_than_is_stored(self, file):
        picture = file.with_suffix(".png")
        Image.new("RGB", (8000, 8000)).save(picture)
        refused(picture, "too-large", "192008000 bytes of pixels", "at most 200 times as many")

    def test_a_large_clean_drawing_is_traced(self, file):
        drawing = Image.new("1", (4000, 4000))
        drawing.paste(1, (500, 500, 3000, 3500))
        picture = file.with_suffix(".png")
        drawing.save(picture)
        found = outcome(picture)
        assert found.code == "read"
        # With the 130 MiB of the libraries that find outlines.
        assert found.mebibytes < 150 + BYTES_A_PIXEL * 4000**2 / MEBIBYTE, found

    def test_more_than_fits_into_the_memory_is_refused_before_it_is_read(self, file):
        Image.new("1", (4000, 4000)).save(file, "PNG")
        with pytest.raises(UnreadableScan, match=r"4000 x 4000 pixels, .* needs 288000000 bytes .* 300000000 are free"):
            read_picture(file, free_bytes=300_000_000)


class TestArchives:
    @pytest.mark.parametrize(
        ("mebibytes", "words"),
        [(2_800, "2936012812 bytes"), (60, "header claims to have 62914560 bytes; at most 4096")],
    )
    def test_a_large_header_in_an_npz(self, file, mebibytes, words):
        length = mebibytes * MEBIBYTE
        head = b"\x93NUMPY\2\0" + struct.pack("<I", length)
        archive_of(file, "data.npy", deflated(head, length), len(head) + length)
        refused(file, "too-large", words)

    @pytest.mark.parametrize("shape", ["-" * 4000 + "1", "(" * 150 + ")" * 150, "9" * 4000, "1" + ",1" * 1900])
    def test_headers_that_no_parser_likes(self, file, shape):
        header = f"{{'descr':'<f4','fortran_order':False,'shape':({shape},)}}".encode()
        file.write_bytes(b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header)
        assert refused(file, outcome(file).code).code in {"broken-file", "too-large", "truncated-file", "wrong-shape"}

    def test_a_long_header_is_not_to_be_trusted(self, file):
        file.write_bytes(b"\x93NUMPY\1\0" + struct.pack("<H", 20_000) + b" " * 20_000)
        refused(file, "too-large", "header claims to have 20000 bytes")

    @pytest.mark.parametrize(
        ("count", "words"),
        [
            (3_000_000, "directory has 141000000 bytes; at most 16777216"),
            (300_000, "the archive holds 300000 files; at most 100000"),
        ],
    )
    def test_very_many_entries(self, file, count, words):
        entry = struct.pack("<4s6H3L5H2L", b"PK\1\2", 20, 20, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"
        end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, count * len(entry), 4, 0)
        file.write_bytes(b"PK\3\4" + entry * count + end)
        refused(file, "too-large", words)


class TestMat:
    def packed(self, file, shape, data_bytes, name=b"arr"):
        head = struct.pack("<4I", 6, 8, 6, 0) + struct.pack(f"<2I{len(shape)}i", 5, 4 * len(shape), *shape)
        head += struct.pack("<2H4s", 1, len(name), name) + struct.pack("<2I", 9, data_bytes)
        stored = deflated(struct.pack("<2I", 14, len(head) + data_bytes) + head, data_bytes)
        file.write_bytes(b"MATLAB 5.0".ljust(124) + b"\0\1IM" + struct.pack("<2I", 15, len(stored)) + stored)

    def test_a_length_of_3_gb_inside_a_packed_element(self, file):
        self.packed(file, (20, 3 * 2**30 // 160), 3 * 2**30 // 160 * 160)
        refused(file, "too-large", "'arr' needs 3221225440 bytes")

    def test_twenty_thousand_axes_are_refused_in_one_short_sentence(self, file):
        self.packed(file, (1,) * 20_000, 8)
        assert len(refused(file, "dataset-missing", "arr (1, 1, 1, ", "20000 axes instead of 2 or 3").sentence) < 1010

    def test_zeros_that_fit_into_the_memory(self, file):
        self.packed(file, (32, 2**21), 2**29)
        refused(file, "too-large", "'arr' declares 536870912 bytes", "at most 200 times as many")


class TestTiff:
    def test_pages_that_share_one_bomb(self, file):
        # 600 pages of 60 MB in all, below what is held against the file's size, each of which inflates 98 MiB.
        pages_of(file, deflated(b"", 98 * MEBIBYTE), (20, 5120), 600)
        refused(file, "too-large", "pages 0 to ", "share their data")

    def test_many_pages_that_share_one_small_strip(self, file):
        pages_of(file, bytes(80), (1, 40), 2_000, compression=1)
        refused(file, "too-large", "pages 0 to 1 of the file", "share their data")

    def test_a_strip_stored_in_what_it_declares_that_inflates_to_4_gib(self, file):
        pages_of(file, deflated(b"", 2**32), (2048, 2100), 1)
        refused(file, "too-large", "a strip or tile of page 0 declares 4300800 bytes of data and unpacks to more")

    def test_packbits_that_unpack_to_275_mb(self, file):
        pages_of(file, b"\x81\0" * 2_150_400, (2048, 2100), 1, compression=32773)
        refused(file, "too-large", "page 0 declares 4300800 bytes of data and unpacks to more (PackBits)")

    def test_packbits_whose_decoder_takes_nine_times_the_memory(self, file):
        pages_of(file, b"\x81\0" * 2**20, (2**14, 2**13), 1, compression=32773)
        refused(file, "too-large", "needs 1207959552 bytes while PackBits is unpacked", "use deflate")

    def test_packbits_that_unpack_to_what_they_declare_are_read(self, file):
        pages_of(file, b"\x81\7" * 1_600, (20, 10_240), 1, compression=32773)
        assert outcome(file).code == "read"

    def test_tiles_that_are_far_larger_than_their_pages(self, file):
        tiles_of(file, 4096, (2, 16), 12)
        refused(file, "too-large", "page 0 of the file has the shape (2, 16) and tiles of (4096, 4096)", "in strips")

    def test_tiles_that_unpack_to_more_in_all_than_a_file_may(self, file):
        tiles_of(file, 2048, (1024, 1024), 60)
        refused(file, "too-large", "tiles of pages 0 to 16 of the file unpack to 71303168 bytes", "at most 200 times")

    def test_small_pages_in_tiles_of_the_usual_size_are_read(self, file):
        tifffile.imwrite(file, np.ones((20, 3, 40), np.uint16), tile=(256, 256), compression="zlib")
        assert outcome(file).code == "read"

    def test_pages_that_share_a_long_text(self, file):
        pages_of(file, bytes(4 * MEBIBYTE), (2, 8), 20_000, description=4 * MEBIBYTE)
        refused(file, "too-large", "the tags of pages 0 to 1 of the file claim", "share their values")
