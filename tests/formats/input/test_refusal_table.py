"""A table of half-right files; the sentences that refuse them are in refusals.txt, none asks for what the file has."""

import io
import stat
from pathlib import Path
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZipFile, ZipInfo

import h5py
import numpy as np
import scipy.io
import tifffile
from PIL import Image
from scan_files import each_refusal, hdf5, mat, npy, npz, refusal, zipped

from sawmill_formats.input.angles import AngleList, AngleSteps

STACK = np.random.default_rng(20261122).integers(100, 60_000, (6, 3, 8)).astype(np.uint16)
VALUES = STACK.astype(np.float64)
COLOURS = np.ones((8, 8, 3), np.uint8)
COUNTS = {"counts": True}
NO_ANGLES = {"angles_deg": None}
STORED, BEHIND = "/entry/instrument/detector/data", "/entry/instrument/detector/b"


def raw(data):
    return lambda path: path.write_bytes(data)


def png(path):
    Image.fromarray(STACK[0].astype(np.uint8)).save(path, "PNG")


def npy_header(shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return stream.getvalue()


def put(place, value):
    changed = VALUES.copy()
    changed[place] = value
    return changed


def nested(depth):
    return {"s": nested(depth - 1)} if depth else VALUES[:, 0]


def created(shape, dtype="f4", *, written=None, **options):
    """A dataset `data` of which these places were written."""

    def write(path):
        with h5py.File(path, "w") as file:
            data = file.create_dataset("data", shape, dtype, **options)
            if written is not None:
                data[written] = 1

    return write


def nxtomo(*, unit="deg", **parts):
    """An entry of six views with their angles in degrees; a part of None is left out."""
    detector = "entry/instrument/detector/"
    angles, size = "entry/sample/rotation_angle", detector + "x_pixel_size"
    members = {
        "entry/definition": "NXtomo",
        detector + "data": parts.pop("data", VALUES),
        detector + "image_key": parts.pop("image_key", [0] * 6),
        angles: parts.pop("angles", 60.0 * np.arange(6)),
        size: parts.pop("size", 1.5),
    } | {detector + name: value for name, value in parts.pop("more", {}).items()}
    there = {name: value for name, value in members.items() if value is not None or name == parts.get("group")}
    return hdf5(there, [(angles, "units", unit)] * (unit is not None) + [(size, "units", "mm")])


def exchange(attributes=(), **parts):
    return hdf5({f"exchange/{name}": value for name, value in ({"data": VALUES} | parts).items()}, attributes)


def shuffled_late(path):
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk(VALUES.shape)
    layout.set_deflate(1)
    layout.set_shuffle()
    with h5py.File(path, "w") as file:
        h5py.h5d.create(file.id, b"data", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple(VALUES.shape), layout)
        file["data"][()] = VALUES


def matlab(members):
    def write(path):
        hdf5(members)(path)
        path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + path.read_bytes())

    return write


def symbolic_link(path):
    entry = ZipInfo("data.npy")
    entry.create_system, entry.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    with ZipFile(path, "w") as archive:
        archive.writestr(entry, "/etc/hostname")


OME = (
    '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1"><Image ID="Image:0"><Pixels '
    'ID="Pixels:0" DimensionOrder="XYCZT" Type="float" SizeX="8" SizeY="1" SizeC="1" SizeZ="6" SizeT="1">'
    '<TiffData><UUID FileName="other.tif">urn:uuid:2</UUID></TiffData></Pixels></Image></OME>'
)


def text_in_chunks(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("entry/definition", (1,), h5py.string_dtype(), chunks=(1,))[0] = "NXtomo"


def tiff(*pages, **options):
    def write(path):
        with tifffile.TiffWriter(path) as file:
            for page in pages:
                file.write(page, contiguous=False, metadata=None, **options)

    return write


# Each with what is given beside it.
TABLE = {
    "text": (raw(b"angle,value\n0,1\n"), {}),
    "a picture": (png, {}),
    "npy: 1 axis": (npy(VALUES.ravel()), {}),
    "npy: 4 axes": (npy(VALUES[..., None]), {}),
    "npy: no views": (npy(VALUES[:0]), {}),
    "npy: no rows": (npy(VALUES[:, :0]), {}),
    "npy: 2 views": (npy(VALUES[:2]), {}),
    "npy: 1 cell": (npy(VALUES[..., :1]), {}),
    "npy: complex": (npy(VALUES + 0j), {}),
    "npy: bool": (npy(VALUES > 5.0), {}),
    "npy: text": (npy(VALUES.astype("U9")), {}),
    "npy: records": (npy(np.ones((6, 8), [("a", "f4")])), {}),
    "npy: objects": (npy(np.full((6, 8), None)), {}),
    "npy: dates": (npy(np.zeros((6, 8), "M8[s]")), {}),
    "npy: named": (npy(VALUES), {"dataset": "data"}),
    "npy: header of nonsense": (raw(b"\x93NUMPY\1\0\x10\0" + b"x" * 16), {}),
    "npy: header without shape": (raw(b"\x93NUMPY\1\0\x10\0{'descr':'<f4'} \n"), {}),
    "npz: only flats": (npz(flats=VALUES), {}),
    "npz: only darks and angles": (npz(darks=VALUES, angles_deg=np.arange(6.0)), {}),
    "npz: 2 views": (npz(data=VALUES[:2]), {}),
    "npz: complex": (npz(data=VALUES + 0j), {}),
    "npz: nothing": (npz(), {}),
    "npz: two of them": (npz(a=VALUES, b=VALUES), {}),
    "npz: named text": (npz(a=VALUES.astype("U9")), {"dataset": "a"}),
    "npz: named with 4 axes": (npz(a=VALUES[None]), {"dataset": "a"}),
    "npz: another name": (npz(a=VALUES), {"dataset": "b"}),
    "flats: fewer cells": (npz(data=VALUES, flats=VALUES[:2, :, :7]), COUNTS),
    "flats: fewer rows": (npz(data=VALUES, flats=VALUES[:2, :2]), COUNTS),
    "flats: no rows": (npz(data=VALUES, flats=VALUES[:, 0]), COUNTS),
    "flats: 1 axis": (npz(data=VALUES, flats=VALUES[0, 0]), COUNTS),
    "flats: of a sinogram": (npz(data=VALUES[:, 0], flats=VALUES), COUNTS),
    "flats: none of them": (npz(data=VALUES, flats=VALUES[:0]), COUNTS),
    "flats: another name": (npz(data=VALUES, lamp=VALUES[:1]), COUNTS),
    "flats: text": (npz(data=VALUES, flats=VALUES.astype("U9")), COUNTS),
    "darks: 4 axes": (npz(data=VALUES, flats=VALUES[:1], darks=VALUES[None]), COUNTS),
    "angles: 2 axes": (npz(data=VALUES, angles_deg=np.ones((2, 3))), NO_ANGLES),
    "angles: 5 of 6": (npz(data=VALUES, angles_deg=np.arange(5.0)), NO_ANGLES),
    "angles: text": (npz(data=VALUES, angles_deg=np.array(list("abcdef"))), NO_ANGLES),
    "angles: complex": (npz(data=VALUES, angles_deg=np.arange(6) + 0j), NO_ANGLES),
    "mat: struct": (mat(scan={"a": 1.0}), {}),
    "mat: sparse": (mat(a=scipy.sparse.csc_matrix(VALUES[:, 0])), {}),
    "mat: logical": (mat(a=VALUES[:, 0] > 5.0), {}),
    "mat: char": (mat(a="some text"), {}),
    "mat: cell": (mat(a=np.array([VALUES, "b", 1.0], object)), {}),
    "mat: 2 views": (mat(data=VALUES[:2, 0]), {}),
    "hdf5: nothing": (hdf5({}), {}),
    "hdf5: 4 axes": (hdf5({"data": VALUES[None]}), {}),
    "hdf5: bool": (hdf5({"data": VALUES > 5.0}), {}),
    "hdf5: a text": (hdf5({"data": "text"}), {"dataset": "data"}),
    "hdf5: records": (hdf5({"data": np.ones((6, 8), [("a", "f4"), ("b", "f4")])}), {"dataset": "data"}),
    "hdf5: a named group": (hdf5({"data": None, "a": VALUES}), {"dataset": "data"}),
    "hdf5: only darks": (hdf5({"darks": VALUES}), {}),
    "nxtomo: data are a group": (nxtomo(data=None, group="entry/instrument/detector/data"), {}),
    "nxtomo: no data": (nxtomo(data=None), {}),
    "nxtomo: no view": (nxtomo(image_key=[1] * 6), COUNTS | NO_ANGLES),
    "nxtomo: 2 views": (nxtomo(image_key=[1] * 4 + [0] * 2), COUNTS | NO_ANGLES),
    "nxtomo: 5 keys": (nxtomo(image_key=[0] * 5), {}),
    "nxtomo: keys are a text": (nxtomo(image_key="0"), {}),
    "nxtomo: key 2.5": (nxtomo(image_key=[2.5] * 6), {}),
    "nxtomo: 4 axes": (nxtomo(data=VALUES[None]), {}),
    "nxtomo: complex": (nxtomo(data=VALUES + 0j), {}),
    "nxtomo: angles of 2 axes": (nxtomo(angles=np.ones((2, 3))), {}),
    "nxtomo: angles are a text": (nxtomo(angles="0 1 2"), {}),
    "nxtomo: 5 angles": (nxtomo(angles=np.arange(5.0)), NO_ANGLES),
    "nxtomo: sizes of 2 axes": (nxtomo(size=np.ones((2, 2))), {}),
    "nxtomo: size is a text": (nxtomo(size="1.5"), {}),
    "exchange: 1 axis": (exchange(data=VALUES[0, 0]), {}),
    "exchange: complex": (exchange(data=VALUES + 0j), {}),
    "exchange: unknown axes": (exchange([("exchange/data", "axes", "y:energy:x")]), {}),
    "exchange: flats are a group": (exchange(data_white=None), COUNTS),
    "exchange: flats of fewer cells": (exchange(data_white=VALUES[:1, :, :7]), COUNTS),
    "exchange: 5 angles": (exchange(theta=np.arange(5.0)), NO_ANGLES),
    "exchange: angles of 2 axes": (exchange(theta=np.ones((2, 3))), NO_ANGLES),
    "tiff: colours": (tiff(COLOURS), {}),
    "tiff: two sizes": (tiff(STACK[0], STACK[0, :, :7], STACK[1]), {}),
    "tiff: 2 pages": (tiff(*STACK[:2]), {}),
    "tiff: a sinogram of 2 views": (tiff(STACK[0, :2]), {}),
    "tiff: complex": (tiff(np.ones((3, 8), np.complex64)), {}),
    "tiff: named": (tiff(*STACK), {"dataset": "a"}),
    "zip: nothing": (zipped({}), {}),
    "zip: only fields": (zipped({"flat1.tif": STACK[0], "dark.tif": STACK[0], "note.txt": b"x"}), {}),
    "zip: pictures of another kind": (zipped({"a.png": b"x", "b.png": b"x"}), {}),
    "zip: two sizes": (zipped({"a.tif": STACK[0], "b.tif": STACK[0, :, :7]}), {}),
    "zip: 2 views": (zipped({"a.tif": STACK[0], "b.tif": STACK[0]}), {}),
    "zip: a text called .tif": (zipped({"a.tif": b"text"}), {}),
    "zip: colours": (zipped({"a.tif": COLOURS}), {}),
    "zip: flats of fewer rows": (
        zipped({f"{n}.tif": image for n, image in enumerate(STACK)} | {"flat.tif": STACK[0, :2]}),
        COUNTS,
    ),
    "npy: a later version": (raw(b"\x93NUMPY\3\0" + bytes(100)), {}),
    "npy: an axis without end": (
        raw(b"\x93NUMPY\1\0\x46\0{'descr':'<f4','fortran_order':False,'shape':(1152921504606846976,8)}\n"),
        {},
    ),
    "angles: 5 of 6, and others given": (npz(data=VALUES, angles_deg=np.arange(5.0)), {}),
    "mat 7.3: empty": (
        hdf5({"data": np.ones((3, 6))}, [("data", "MATLAB_class", b"double"), ("data", "MATLAB_empty", 1)]),
        {},
    ),
    "nxtomo: no values": (nxtomo(data=h5py.Empty("f4")), {}),
    "hdf5: a definition in chunks": (text_in_chunks, {}),
    "hdf5: shuffled after it was packed": (shuffled_late, {}),
    "zip: named": (zipped({"a.tif": STACK[0]}), {"dataset": "a"}),
    "hdf5: a class of 5 000 letters": (hdf5({"data": VALUES}, [("data", "MATLAB_class", "x" * 5_000)]), {}),
    "nothing": (raw(b""), {}),
    "flats: NaN": (npz(data=VALUES, flats=np.full((2, 3, 8), np.nan)), COUNTS),
    "flats: beyond the free memory": (hdf5({"data": VALUES, "flats": np.ones((7, 3, 8), "u1")}), {"free_bytes": 1282}),
    "exchange: flats beyond the free memory": (exchange(data_white=np.ones((7, 3, 8), "u1")), {"free_bytes": 1282}),
    "hdf5: chunks beyond the free memory": (
        created((6, 3, 8), maxshape=(None, None, None), chunks=(1, 1, 100), written=...),
        {"free_bytes": 800},
    ),
    "tiff: a page beyond the free memory": (tiff(VALUES[:, 0].astype("f4")), {"free_bytes": 426}),
    "tiff: a tile beyond the free memory": (
        tiff(VALUES[:, 0].astype("f4"), tile=(64, 64), compression="zlib"),
        {"free_bytes": 36408},
    ),
    "zip: an image beyond the free memory": (zipped({"0.tif": bytes(192)}), {"free_bytes": 426}),
    "values: NaN": (npy(put((4, 1, 6), np.nan)), {}),
    "values: beyond float32": (npy(put((2, 0, 3), 1e300)), {}),
    "values: more than allowed": (npy(VALUES.astype(np.float32)), {"max_bytes": 500}),
    "angles: none": (npy(VALUES), NO_ANGLES),
    "angles: 2 given": (npy(VALUES), {"angles_deg": AngleList((0, 1))}),
    "angles: one given twice": (npy(VALUES), {"angles_deg": AngleList((0, 60, 60, 120, 180, 240))}),
    "angles: whole turns": (npy(VALUES), {"angles_deg": AngleSteps(0, 360)}),
    "angles: of both units": (npz(data=VALUES, angles_deg=np.arange(6.0), angles_rad=np.arange(6.0)), NO_ANGLES),
    "counts: no flats": (npy(VALUES), COUNTS),
    "npy: cut after a header of 34 GB": (raw(npy_header((8, 1024, 1024, 1024))), {}),
    "npy: a negative length": (raw(npy_header((-6, 8)) + bytes(192)), {}),
    "npz: cut after a header of 4 MB": (zipped({"data.npy": npy_header((1000, 1000))}), {}),
    "npz: objects": (npz(data=np.full((6, 8), None)), {"dataset": "data"}),
    "nxtomo: flats of line integrals": (nxtomo(image_key=[1] + [0] * 5), NO_ANGLES),
    "nxtomo: other angles": (nxtomo(), {"angles_deg": AngleSteps(0.5, 60.0)}),
    "nxtomo: another pitch": (nxtomo(), {"detector_pitch_mm": 2.0}),
    "nxtomo: angles without a unit": (nxtomo(unit=None), NO_ANGLES),
    "nxtomo: angles in gon": (nxtomo(unit="gon"), NO_ANGLES),
    "nxtomo: behind an external link": (hdf5({"entry": h5py.ExternalLink("other.nxs", "/scan_1")}), {}),
    "nxtomo: data behind an external link": (nxtomo(data=h5py.ExternalLink("other.h5", "/data")), {}),
    "nxtomo: links in a circle": (nxtomo(data=h5py.SoftLink(BEHIND), more={"b": h5py.SoftLink(STORED)}), {}),
    "exchange: no angles": (exchange(), NO_ANGLES),
    "hdf5: data in another file": (created((6, 8), external=[("secret", 0, 192)]), {}),
    "hdf5: 400 MB that store little": (created((1000, 100, 1000), chunks=(1, 100, 100), written=(0, 0, 0)), {}),
    "hdf5: 4 TB": (created((10**5, 10**3, 10**4), chunks=(1, 10, 100)), {}),
    "hdf5: never written": (created((6, 8), chunks=(1, 8)), {}),
    "hdf5: written in part": (created((6, 3, 8), chunks=(2, 2, 8), written=slice(3)), {}),
    "hdf5: another filter": (created((6, 3, 8), chunks=(6, 3, 8), scaleoffset=2, written=...), {}),
    "hdf5: texts": (created((6, 8), h5py.string_dtype()), {"dataset": "data"}),
    "mat 7.3: behind an external link": (matlab({"data": h5py.ExternalLink("other.h5", "/data")}), {}),
    "mat: a struct by its name": (mat(scan={"a": 1}), {"dataset": "scan"}),
    "mat: a field that is not there": (mat(scan={"a": 1}), {"dataset": "scan/b"}),
    "mat: an array of structs": (
        mat(scans=np.array([(VALUES,), (VALUES,)], dtype=[("a", object)])),
        {"dataset": "scans/a"},
    ),
    "mat: a struct at depth 9": (mat(s=nested(19)), {"dataset": "s/s/s/s/s/s/s/s/s"}),
    "mat: a struct at depth 10": (mat(s=nested(19)), {"dataset": "s/s/s/s/s/s/s/s/s/s"}),
    "mat: 10 001 fields": (mat(scan={f"f{number}": 1 for number in range(10_001)}), {}),
    "mat: unpacks to more than allowed": (
        mat(packed=True, scan={"sinogram": VALUES[:, 0], "zeros": np.zeros(2**20), "last": 1}),
        {"max_bytes": 2**20},
    ),
    "tiff: packed by LZMA": (tiff(STACK[0], compression="lzma"), {}),
    "tiff: OME of pages in another file": (tiff(np.ones((1, 8), np.float32), description=OME), {}),
    "zip: a symbolic link": (symbolic_link, {}),
    "zip: unpacks to more than allowed": (zipped({"0.tif": bytes(2**26)}, ZIP_DEFLATED), {"max_bytes": 10**6}),
    "zip: packed by BZIP2": (zipped({"0.tif": b"x"}, ZIP_BZIP2), {}),
}
OUTSIDE = ["../view.tif", "/etc/view.tif", "a/../../view.tif", "..\\view.tif", "C:\\view.tif"]
TABLE |= {f"zip: {name}": (zipped({name: b""}), {}) for name in OUTSIDE}


@each_refusal(Path(__file__).with_name("refusals.txt"))
def test_the_sentence(tmp_path, name, code, sentence):
    write, options = TABLE[name]
    write(tmp_path / "upload")
    given = {"counts": False, "dataset": None, "angles_deg": AngleSteps(0.0, 60.0)} | options
    assert refusal(tmp_path / "upload", **given) == (code, sentence)
