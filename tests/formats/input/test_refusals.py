"""Broken, hostile and contradictory files: each is refused with its code and one sentence."""

import io
import struct
import zlib
from contextlib import suppress
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from scan_files import WHOLE, read_scan, saved

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps

STEPS = AngleSteps(0.0, 60.0)
BOMB = zlib.compress(bytes(24 * 2**20), 1)


def refused(path, code, sentence, **options):
    options = {"counts": False, "angles_deg": STEPS} | options
    with pytest.raises(UnreadableScan, match=sentence) as refusal:
        read_scan(path, **options)
    assert refusal.value.code == code
    assert "\n" not in str(refusal.value)


class TestAnyFile:
    @pytest.mark.parametrize(
        "head", [b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"II*\0", b"\x93NUMPY", b"\0" * 124 + b"\0\1IM"]
    )
    def test_only_the_first_bytes_of_a_format(self, file, head):
        file.write_bytes(head)
        refused(file, "broken-file", "file is incomplete or damaged .*; export it again")

    @pytest.mark.parametrize("head", [b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"II*\0", b"\x93NUMPY\1\0"])
    def test_noise_after_the_first_bytes(self, file, head, rng):
        for _ in range(20):
            file.write_bytes(head + rng.bytes(2000))
            with pytest.raises(UnreadableScan):
                read_scan(file, counts=False, angles_deg=STEPS)

    @pytest.mark.parametrize("kind", ["nxtomo", *WHOLE])
    def test_every_truncation_is_refused_or_lost_nothing(self, nxtomo, file, kind):
        counts = kind == "nxtomo"
        whole = nxtomo().read_bytes() if counts else WHOLE[kind]
        file.write_bytes(whole)
        angles = None if counts else STEPS
        complete = read_scan(file, counts=counts, angles_deg=angles).projections
        for length in np.linspace(0, len(whole) - 1, 150).astype(int):
            file.write_bytes(whole[:length])
            with suppress(UnreadableScan):
                np.testing.assert_array_equal(read_scan(file, counts=counts, angles_deg=angles).projections, complete)
        file.write_bytes(whole[: len(whole) * 4 // 5])
        with pytest.raises(UnreadableScan):
            read_scan(file, counts=counts, angles_deg=angles)

    def test_missing_file_is_not_blamed_on_its_content(self, file):
        with pytest.raises(FileNotFoundError):
            read_scan(file, counts=False)


class TestScan:
    def test_more_than_the_free_memory_where_it_is_unpacked_as_a_whole(self, file, stack):
        # (6, 3, 8) values of 4 bytes, twice in memory, and nine tenths of what is free.
        with ZipFile(file.with_suffix(".npz"), "w") as archive:
            archive.mkdir("a folder that comes first")
            archive.writestr("data.npy", saved(np.save, stack))
        refused(file.with_suffix(".npz"), "too-large", "at most 575 ", free_bytes=1279)
        for kind in ("zip", "npy"):
            file.write_bytes(WHOLE[kind])
            assert read_scan(file, counts=False, angles_deg=STEPS, free_bytes=1279).projections.size == stack.size

    def test_frames_of_fields_beyond_the_free_memory(self, nxtomo):
        options = {"counts": True, "angles_deg": None}
        # Two flats of (3, 8), of ten images in all.
        refused(
            nxtomo(), "too-large", "image_key 1 needs 192 bytes as float32 and at most 191 ", free_bytes=426, **options
        )
        assert read_scan(nxtomo(), free_bytes=428, **options).flats.nbytes == 192

    def test_pieces_larger_than_the_free_memory(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", data=stack, chunks=(4, 3, 4))
        refused(file, "too-large", "in pieces of 384 bytes, where pieces of 383 fit .* smaller chunks", free_bytes=853)
        assert read_scan(file, counts=False, angles_deg=STEPS, free_bytes=854).projections.nbytes == 576


class TestHdf5:
    def test_truncated(self, nxtomo, file):
        whole = nxtomo().read_bytes()
        file.write_bytes(whole[: len(whole) // 2])
        refused(file, "truncated-file", "HDF5 file is incomplete or damaged .*truncated file", counts=True)


class TestZip:
    def pack(self, file, name, data, method=ZIP_STORED):
        with ZipFile(file, "w", method) as archive:
            archive.writestr(name, data)
        return file

    def test_bomb_by_its_ratio(self, file):
        self.pack(file, "view.tif", bytes(65 * 2**20), ZIP_DEFLATED)
        refused(file, "too-large", "declares 68157440 bytes and stores .*; no scan packs so well")

    def test_bomb_that_lies_about_its_size(self, file):
        packed = bytearray(self.pack(file, "view.tif", bytes(64 * 2**20), ZIP_DEFLATED).read_bytes())
        directory = packed.rindex(b"PK\x01\x02")
        packed[directory + 24 : directory + 28] = struct.pack("<I", 1000)
        file.write_bytes(packed)
        refused(file, "broken-file", "ZIP file is incomplete or damaged .*CRC")

    def test_encrypted(self, file):
        packed = bytearray(self.pack(file, "view.tif", b"x").read_bytes())
        packed[packed.rindex(b"PK\x01\x02") + 8] |= 1
        file.write_bytes(packed)
        refused(file, "unsafe-archive", "'view.tif' is encrypted; pack the archive without a password")


class TestTiff:
    def test_truncated_within_the_data(self, file, stack):
        tifffile.imwrite(file, stack[:, 0])
        file.write_bytes(file.read_bytes()[:-20])
        refused(file, "truncated-file", "page 0 of the file declares more data than the file of .* bytes holds")

    def test_truncated_between_two_pages(self, file):
        whole = WHOLE["tiff page by page"]
        with tifffile.TiffFile(io.BytesIO(whole)) as tiff:
            fifth = tiff.pages[4].offset
        file.write_bytes(whole[:fifth])
        refused(file, "truncated-file", "the file ends before its last page; export it again")

    def test_a_strip_that_unpacks_to_more_than_it_declares(self, file):
        with tifffile.TiffWriter(file) as tiff:
            tiff.write(iter([BOMB]), shape=(6, 8), dtype="f4", compression="zlib", rowsperstrip=6)
        refused(file, "too-large", "a strip or tile of page 0 of the file declares 192 bytes .* stores [0-9]+ for them")


class TestMat:
    def test_a_packed_variable_with_a_wrong_checksum(self, file):
        whole = bytearray(WHOLE["packed mat"])
        whole[-1] ^= 0xFF
        file.write_bytes(whole)
        refused(file, "broken-file", "incorrect data check", dataset="scan/sinogram")

    @pytest.mark.parametrize(
        ("offset", "forged", "sentence"),
        [
            (128, 13, "a variable of type 13 claims"),
            (132, 2**32 - 1, "a variable of type 14 claims 4294967295 bytes"),
            (140, 2**31, "a name or shape of 2147483648 bytes"),
            (160, -6, r"the shape \(-6, 8\) is declared"),
            (160, 5, r"\(5, 8\) values are declared and 384 bytes stored"),
            (160, 7, r"\(7, 8\) values are declared and 48 stored"),
            (164, 2**31 - 1, "at most .* are allowed or free|while the file stores only"),
            (168, (8 << 16) | 1, "an element of 4 bytes claims 8"),
            (176, 99, "numbers are stored as type 99"),
            (180, 2**31, "values are declared and 2147483648 bytes stored"),
        ],
    )
    def test_forged_words(self, file, offset, forged, sentence):
        """Each word of the head of one variable in turn: type, length, flags, shape, name, type and length of data."""
        scipy.io.savemat(file, {"arr": np.ones((6, 8))}, appendmat=False)
        whole = bytearray(file.read_bytes())
        whole[offset : offset + 4] = struct.pack("<q", forged)[:4]
        file.write_bytes(whole)
        refused(file, "too-large" if "allowed" in sentence else "broken-file", sentence)
