"""Broken, hostile and contradictory files: each is refused with its code and one sentence."""

import io
import struct
import zlib
from contextlib import suppress
from dataclasses import replace
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_STORED, ZipFile

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleList, AngleSteps
from sawmill_formats.input.reading import reading_scan

STEPS = AngleSteps(0.0, 60.0)
BOMB = zlib.compress(bytes(24 * 2**20), 1)


def read_scan(path, **given):
    """A scan with all of its projections in memory."""
    with reading_scan(path, **given) as scan:
        (block,) = scan.blocks(2**30)
        return replace(scan, projections=block.samples)


def refused(path, code, sentence, **options):
    options = {"counts": False, "angles_deg": STEPS} | options
    with pytest.raises(UnreadableScan, match=sentence) as refusal:
        read_scan(path, **options)
    assert refusal.value.code == code
    assert "\n" not in str(refusal.value)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "upload"


def write_npy(file, stack):
    with file.open("wb") as stream:
        np.save(stream, stack)
    return file


def npy_header(shape, descr="<f4"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def saved(write, *arguments, **named):
    stream = io.BytesIO()
    write(stream, *arguments, **named)
    return stream.getvalue()


def write_pages(stream, stack):
    with tifffile.TiffWriter(stream) as tiff:
        for view in stack:
            tiff.write(view, contiguous=False, metadata=None)


def structs(stack):
    return {"scan": {"sinogram": stack[:, 0], "parameters": {"angles": np.arange(len(stack)), "note": "text"}}}


def zipped(stack):
    stream = io.BytesIO()
    with ZipFile(stream, "w") as archive:
        for view, image in enumerate(stack):
            archive.writestr(f"{view}.tif", saved(tifffile.imwrite, image))
    return stream.getvalue()


class TestAnyFile:
    def test_empty(self, file):
        file.write_bytes(b"")
        refused(file, "empty-file", "the file is empty; upload it again")

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

    # Not for HDF5: its C reader can crash on such files, so they are read in a process that may die.
    @pytest.mark.parametrize("kind", ["npy", "npz", "mat", "packed mat", "tiff", "zip"])
    def test_damaged_bytes_are_read_or_refused(self, file, stack, rng, kind):
        whole = {
            "npy": lambda: saved(np.save, stack),
            "npz": lambda: saved(np.savez_compressed, data=stack),
            "mat": lambda: saved(scipy.io.savemat, structs(stack)),
            "packed mat": lambda: saved(scipy.io.savemat, structs(stack), do_compression=True),
            "tiff": lambda: saved(tifffile.imwrite, stack),
            "zip": lambda: zipped(stack),
        }[kind]()
        for position in rng.choice(len(whole), 100, replace=False):
            damaged = bytearray(whole)
            damaged[position] ^= 0xFF
            file.write_bytes(damaged)
            with suppress(UnreadableScan):
                assert read_scan(file, counts=False, angles_deg=STEPS).projections.dtype == np.float32

    @pytest.mark.parametrize("kind", ["nxtomo", "npy", "npz", "mat", "packed mat", "tiff", "tiff page by page", "zip"])
    def test_every_truncation_is_refused_or_lost_nothing(self, nxtomo, file, stack, kind):
        whole = {
            "nxtomo": lambda: nxtomo().read_bytes(),
            "npy": lambda: saved(np.save, stack),
            "npz": lambda: saved(np.savez_compressed, data=stack),
            "mat": lambda: saved(scipy.io.savemat, {"arr": stack[:, 0]}),
            "packed mat": lambda: saved(scipy.io.savemat, structs(stack), do_compression=True),
            "tiff": lambda: saved(tifffile.imwrite, stack),
            "tiff page by page": lambda: saved(write_pages, stack),
            "zip": lambda: zipped(stack),
        }[kind]()
        file.write_bytes(whole)
        counts = kind == "nxtomo"
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
    def test_not_a_number_is_named_by_its_place(self, file, stack):
        stack[4, 1, 6] = np.nan
        refused(
            write_npy(file, stack), "not-finite", "view 4, row 1, cell 6 is nan; every value must be a finite number"
        )

    def test_beyond_single_precision(self, file, stack):
        large = stack.astype(np.float64)
        large[2, 0, 3] = 1e300
        refused(write_npy(file, large), "not-finite", "view 2, row 0, cell 3 is inf")

    def test_angles_missing(self, file, stack):
        refused(
            write_npy(file, stack),
            "angles-missing",
            r"carries no angles; give the angles as START:STEP in degrees, as in 0.5:1, .* --angles-deg",
            angles_deg=None,
        )

    def test_angles_of_another_number(self, file, stack):
        refused(
            write_npy(file, stack), "angles-mismatch", "2 angles were given for 6 views", angles_deg=AngleList((0, 1))
        )

    def test_scanner_that_stands_still(self, file, stack):
        angles = AngleList((0, 60, 60, 120, 180, 240))
        refused(
            write_npy(file, stack),
            "angles-repeated",
            r"views 1 and 2 have the same direction \(60 deg",
            angles_deg=angles,
        )

    def test_whole_turns_as_steps(self, file, stack):
        refused(write_npy(file, stack), "angles-repeated", "the same direction", angles_deg=AngleSteps(0, 360))

    def test_counts_without_flats(self, file, stack):
        refused(
            write_npy(file, stack),
            "flats-missing",
            "need at least one flat field: images with image_key 1",
            counts=True,
        )

    def test_line_integrals_with_flats(self, nxtomo):
        refused(nxtomo(), "contradiction", "declared line integrals but the file carries flat", angles_deg=None)

    def test_angles_that_contradict_the_file(self, nxtomo):
        refused(nxtomo(), "contradiction", "view 0 is at 0.5 degrees and the angles given say 0", counts=True)

    def test_pitch_that_contradicts_the_file(self, nxtomo):
        options = {"counts": True, "angles_deg": None, "detector_pitch_mm": 2.0}
        refused(nxtomo(), "contradiction", "detector_pitch_mm is 1.5 and 2 was given", **options)

    def test_larger_than_allowed(self, file, stack):
        refused(write_npy(file, stack), "too-large", "needs 576 bytes as float32 and at most 500", max_bytes=500)

    def test_more_than_the_free_memory_where_it_is_unpacked_as_a_whole(self, file, stack):
        # (6, 3, 8) values of 4 bytes, twice in memory, and nine tenths of what is free.
        with ZipFile(file.with_suffix(".npz"), "w") as archive:
            archive.mkdir("a folder that comes first")
            archive.writestr("data.npy", saved(np.save, stack))
        refused(file.with_suffix(".npz"), "too-large", "at most 575 ", free_bytes=1279)
        file.write_bytes(zipped(stack))
        for path in (file, write_npy(file.with_suffix(".npy"), stack)):
            assert read_scan(path, counts=False, angles_deg=STEPS, free_bytes=1279).projections.size == stack.size

    @pytest.mark.parametrize("layout", ["plain", "exchange"])
    def test_fields_beyond_the_free_memory(self, file, stack, layout):
        names = {"plain": ("data", "flats"), "exchange": ("exchange/data", "exchange/data_white")}[layout]
        with h5py.File(file, "w") as h5:
            h5[names[0]], h5[names[1]] = stack, np.ones((7, *stack.shape[1:]), np.uint8)
        refused(file, "too-large", f"'{names[1]}' needs 672 bytes as float32 and at most 576 ", free_bytes=1282)

    def test_frames_of_fields_beyond_the_free_memory(self, nxtomo):
        options = {"counts": True, "angles_deg": None}
        # Two flats of (3, 8), of ten images in all.
        refused(
            nxtomo(), "too-large", "image_key 1 needs 192 bytes as float32 and at most 191 ", free_bytes=426, **options
        )
        assert read_scan(nxtomo(), free_bytes=428, **options).flats.nbytes == 192

    @pytest.mark.parametrize("kind", ["tiff", "zip"])
    def test_frames_beyond_the_free_memory(self, file, stack, kind):
        page, member = saved(tifffile.imwrite, stack[:, 0], metadata=None), zipped(stack)
        file.write_bytes(page if kind == "tiff" else member)
        sentence = {"tiff": "a page of the file needs 192 ", "zip": "'0.tif' unpacks to [0-9]+ bytes and at most 191 "}
        refused(file, "too-large", sentence[kind], free_bytes=426)

    def test_pieces_larger_than_the_free_memory(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", data=stack, chunks=(4, 3, 4))
        refused(file, "too-large", "in pieces of 384 bytes, where pieces of 383 fit .* smaller chunks", free_bytes=853)
        assert read_scan(file, counts=False, angles_deg=STEPS, free_bytes=854).projections.nbytes == 576

    def test_chunks_larger_than_the_free_memory(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", data=stack, maxshape=(None, None, None), chunks=(1, 1, 100))
        refused(file, "too-large", r"'data' has chunks of \(1, 1, 100\) values; store it in smaller", free_bytes=800)


class TestHdf5:
    def test_truncated(self, nxtomo, file):
        whole = nxtomo().read_bytes()
        file.write_bytes(whole[: len(whole) // 2])
        refused(file, "truncated-file", "HDF5 file is incomplete or damaged .*truncated file", counts=True)

    def test_external_storage(self, file, tmp_path):
        secret = tmp_path / "secret"
        secret.write_bytes(b"s" * 4 * 48)
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", (6, 8), "f4", external=[(str(secret), 0, 4 * 48)])
        refused(file, "external-storage", "'data' takes its data from other files or datasets")

    def test_external_link_as_entry(self, nxtomo, file):
        with h5py.File(file, "w") as h5:
            h5["entry"] = h5py.ExternalLink(str(nxtomo()), "/scan_1")
        refused(file, "external-storage", "'entry' leads through an external link into another file", counts=True)

    def test_external_link_as_data(self, nxtomo, tmp_path, stack):
        with h5py.File(tmp_path / "other.h5", "w") as other:
            other["data"] = stack

        def relink(entry):
            del entry["instrument/detector/data"]
            entry["instrument/detector/data"] = h5py.ExternalLink("other.h5", "/data")

        refused(nxtomo(relink), "external-storage", "'instrument/detector/data' leads through an external link")

    def test_virtual_dataset(self, file, tmp_path, stack):
        with h5py.File(tmp_path / "source.h5", "w") as source:
            source["data"] = stack
        layout = h5py.VirtualLayout(stack.shape, "f4")
        layout[:] = h5py.VirtualSource(str(tmp_path / "source.h5"), "data", stack.shape)
        with h5py.File(file, "w") as h5:
            h5.create_virtual_dataset("data", layout)
        refused(file, "external-storage", "put the data themselves into it")

    def test_soft_links_in_a_circle(self, nxtomo):
        def relink(entry):
            del entry["instrument/detector/data"]
            entry["instrument/detector/data"] = h5py.SoftLink("/scan_1/b")
            entry["b"] = h5py.SoftLink("/scan_1/instrument/detector/data")

        refused(nxtomo(relink), "unsupported-storage", "links behind .* run in a circle")

    def test_declares_far_more_than_it_stores(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", (1000, 100, 1000), "f4", chunks=(1, 100, 100))[0, 0, 0] = 1
        assert file.stat().st_size < 1e5
        refused(file, "too-large", "'data' declares 400000000 bytes of data while the file stores only 40000")

    def test_declares_more_than_allowed(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", (10**5, 10**3, 10**4), "f4", chunks=(1, 10, 100))
        refused(file, "too-large", "'data' needs 4000000000000 bytes as float32 and at most 8589934592 are allowed")

    def test_never_written(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", (6, 8), "f4", chunks=(1, 8))
        refused(file, "truncated-file", "'data' was declared and never written")

    def test_half_written(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", stack.shape, "f4", chunks=(2, 2, 8))[:3] = stack[:3]
        refused(file, "truncated-file", "'data' was written in part: 4 of its 6 chunks; export the file again")

    def test_a_chunk_that_unpacks_to_more_than_it_declares(self, file, stack):
        with h5py.File(file, "w") as h5:
            data = h5.create_dataset("data", data=stack, chunks=(1, 1, 8), compression="gzip")
            data.id.write_direct_chunk((0, 0, 0), BOMB)
        refused(file, "too-large", f"a chunk of 'data' declares 32 bytes of data while the file stores {len(BOMB)} for")

    def test_unknown_filter(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", data=stack, chunks=stack.shape, scaleoffset=2)
        refused(file, "unsupported-storage", r"stored with the filter .*\(6\); repack it with gzip")

    def test_objects(self, file):
        with h5py.File(file, "w") as h5:
            h5.create_dataset("data", (6, 8), h5py.string_dtype())
        refused(file, "wrong-type", "'data' is of type object", dataset="data")

    def test_data_exchange_without_theta(self, file, stack):
        with h5py.File(file, "w") as h5:
            h5["exchange/data"] = stack
        refused(file, "angles-missing", "carries no angles; give the angles", angles_deg=None)

    def test_nxtomo_angles_without_units(self, nxtomo):
        path = nxtomo(angle_units=None)
        refused(path, "angles-missing", "no units attribute; give the .*--angles-deg", counts=True, angles_deg=None)

    def test_nxtomo_angles_in_an_unknown_unit(self, nxtomo):
        path = nxtomo(angle_units="gon")
        refused(path, "angles-missing", "unit 'gon' .* is not a known unit of angle", counts=True, angles_deg=None)


class TestNpy:
    def test_declares_far_more_than_it_holds(self, file):
        file.write_bytes(npy_header((8, 1024, 1024, 1024)))
        assert file.stat().st_size == 128
        refused(file, "truncated-file", "declares 34359738368 bytes of data and the file holds 0")

    def test_negative_shape(self, file):
        file.write_bytes(npy_header((-6, 8)) + b"\0" * 192)
        refused(file, "wrong-shape", "no length can be negative")

    def test_npz_whose_member_declares_too_much(self, file):
        with ZipFile(file, "w") as archive:
            archive.writestr("data.npy", npy_header((1000, 1000)))
        refused(file, "truncated-file", "'data' declares 4000000 bytes of data and the file holds 0")

    def test_npz_with_pickles(self, file):
        with file.open("wb") as stream:
            np.savez(stream, allow_pickle=True, data=np.full((6, 8), None))
        refused(file, "wrong-type", "'data' is of type object", dataset="data")

    def test_npz_with_two_kinds_of_angles(self, file, stack):
        with file.open("wb") as stream:
            np.savez(stream, data=stack, angles_deg=np.arange(6), angles_rad=np.arange(6))
        refused(file, "contradiction", "holds angles_deg and angles_rad")


class TestZip:
    def pack(self, file, name, data, method=ZIP_STORED):
        with ZipFile(file, "w", method) as archive:
            archive.writestr(name, data)
        return file

    def test_bomb_by_its_declared_size(self, file):
        self.pack(file, "view.tif", bytes(64 * 2**20), ZIP_DEFLATED)
        refused(file, "too-large", "the archive unpacks to 67108864 bytes and at most 1000000", max_bytes=10**6)

    def test_bomb_by_its_ratio(self, file):
        self.pack(file, "view.tif", bytes(65 * 2**20), ZIP_DEFLATED)
        refused(file, "too-large", "declares 68157440 bytes and stores .*; no scan packs so well")

    def test_bomb_that_lies_about_its_size(self, file):
        packed = bytearray(self.pack(file, "view.tif", bytes(64 * 2**20), ZIP_DEFLATED).read_bytes())
        directory = packed.rindex(b"PK\x01\x02")
        packed[directory + 24 : directory + 28] = struct.pack("<I", 1000)
        file.write_bytes(packed)
        refused(file, "broken-file", "ZIP file is incomplete or damaged .*CRC")

    @pytest.mark.parametrize(
        "name", ["../view.tif", "/etc/view.tif", "a/../../view.tif", "..\\view.tif", "C:\\view.tif"]
    )
    def test_names_that_point_outside(self, file, name):
        refused(self.pack(file, name, b""), "unsafe-archive", "points outside of it; pack plain names")

    def test_encrypted(self, file):
        packed = bytearray(self.pack(file, "view.tif", b"x").read_bytes())
        packed[packed.rindex(b"PK\x01\x02") + 8] |= 1
        file.write_bytes(packed)
        refused(file, "unsafe-archive", "'view.tif' is encrypted; pack the archive without a password")

    def test_unusual_packing(self, file):
        refused(self.pack(file, "view.tif", b"x", ZIP_BZIP2), "unsafe-archive", "packed by method 12; use deflate")


class TestTiff:
    def test_truncated_within_the_data(self, file, stack):
        tifffile.imwrite(file, stack[:, 0])
        file.write_bytes(file.read_bytes()[:-20])
        refused(file, "truncated-file", "page 0 of the file declares more data than the file of .* bytes holds")

    def test_truncated_between_two_pages(self, file, stack):
        whole = saved(write_pages, stack)
        with tifffile.TiffFile(io.BytesIO(whole)) as tiff:
            fifth = tiff.pages[4].offset
        file.write_bytes(whole[:fifth])
        refused(file, "truncated-file", "the file ends before its last page; export it again")

    def test_unreadable_compression(self, file):
        tifffile.imwrite(file, np.ones((8, 8), np.uint16), compression="lzma")
        refused(file, "unsupported-storage", "is compressed by LZMA; use deflate or no compression")

    def test_a_strip_that_unpacks_to_more_than_it_declares(self, file):
        with tifffile.TiffWriter(file) as tiff:
            tiff.write(iter([BOMB]), shape=(6, 8), dtype="f4", compression="zlib", rowsperstrip=6)
        refused(file, "too-large", "a strip or tile of page 0 of the file declares 192 bytes .* stores [0-9]+ for them")

    def test_tiles_larger_than_the_free_memory(self, file, stack):
        tifffile.imwrite(file, stack[:, 0], tile=(64, 64), compression="zlib")
        refused(file, "too-large", "tile of page 0 of the file needs 16384 bytes .* most 16383", free_bytes=36408)


class TestMat:
    def test_structure(self, file):
        scipy.io.savemat(file, {"scan": {"a": 1}}, appendmat=False)
        refused(file, "wrong-type", "'scan' is a MATLAB struct.* name a field of it by its path", dataset="scan")
        refused(file, "dataset-missing", r"no array named 'scan/b'; it holds scan \(1, 1\), scan/a", dataset="scan/b")

    def test_an_array_of_structs_is_not_entered(self, file):
        scans = np.array([(np.ones((6, 8)),), (np.ones((6, 8)),)], dtype=[("a", object)])
        scipy.io.savemat(file, {"scans": scans}, appendmat=False)
        refused(file, "dataset-missing", r"no array named 'scans/a'; it holds scans \(1, 2\)$", dataset="scans/a")

    def test_structs_in_structs_are_not_followed_for_ever(self, file):
        nested = np.ones((6, 8))
        for _ in range(20):
            nested = {"s": nested}
        scipy.io.savemat(file, nested, appendmat=False)
        refused(file, "wrong-type", "is a MATLAB struct", dataset="/".join("s" * 9))
        refused(file, "dataset-missing", "no array named", dataset="/".join("s" * 10))

    def test_more_fields_than_are_listed(self, file):
        scipy.io.savemat(file, {"scan": {f"f{number}": 1 for number in range(10_001)}}, appendmat=False)
        refused(file, "too-large", "more than 10000 variables and fields")

    def test_unpacks_to_more_than_may_be_read(self, file):
        fields = {"sinogram": np.ones((6, 8)), "zeros": np.zeros(2**20), "last": 1}
        scipy.io.savemat(file, {"scan": fields}, appendmat=False, do_compression=True)
        assert file.stat().st_size < 2**15
        refused(file, "too-large", "unpacks to more than the 1048576 bytes", max_bytes=2**20)

    def test_a_packed_variable_with_a_wrong_checksum(self, file, stack):
        scipy.io.savemat(file, structs(stack), appendmat=False, do_compression=True)
        whole = bytearray(file.read_bytes())
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

    def test_declares_far_more_than_it_stores(self, file):
        scipy.io.savemat(file, {"arr": np.ones((6, 8))}, appendmat=False)
        whole = file.read_bytes()
        assert whole[160:168] == struct.pack("<ii", 6, 8)
        file.write_bytes(whole[:160] + struct.pack("<ii", 40_000, 40_000) + whole[168:])
        refused(file, "too-large", "'arr' needs 12800000000 bytes")
