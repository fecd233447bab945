"""Every format that can be read gives back what was put into it."""

import shutil
import struct
from zipfile import ZIP_DEFLATED

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from scan_files import hdf5, read_scan, zipped

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleList, AngleSteps

STEPS = AngleSteps(0.0, 60.0)


def as_image(image):
    return image.astype(np.uint16)


def read_as(name, projections, path, **options):
    """Read a scan of this format with these projections."""
    scan = read_scan(path, **options)
    assert scan.format == name
    np.testing.assert_array_equal(scan.projections, projections)
    return scan


def test_nxtomo_gives_views_flats_darks_angles_and_pitch(nxtomo, stack, angles_deg):
    scan = read_as("hdf5-nxtomo", stack, nxtomo(), counts=True)
    assert scan.projections.dtype == np.float32
    np.testing.assert_allclose(scan.angles_rad, np.deg2rad(angles_deg), rtol=1e-15)
    assert np.all(scan.flats == 60_000)
    assert scan.flats.shape[0] == 2
    assert np.all(scan.darks == 7)
    assert (scan.detector_pitch_mm, scan.row_pitch_mm) == (pytest.approx(1.5), None)
    assert scan.remarks == ("1 images marked invalid (image_key 3) were left out.",)


def test_nxtomo_angles_in_radians(nxtomo, angles_deg):
    np.testing.assert_allclose(read_scan(nxtomo(angle_units="rad"), counts=True).angles_rad, angles_deg, rtol=1e-14)


@pytest.mark.parametrize(("unit", "value"), [("m", 0.0015), ("mm", 1.5), ("um", 1500.0), (b"micron", 1500.0)])
def test_pixel_size_in_any_unit_of_length(nxtomo, unit, value):
    def set_size(entry):
        entry["instrument/detector/x_pixel_size"][()] = value
        entry["instrument/detector/x_pixel_size"].attrs["units"] = unit

    assert read_scan(nxtomo(set_size), counts=True).detector_pitch_mm == pytest.approx(1.5)


def test_pixel_size_without_unit_is_ignored_with_a_remark(nxtomo):
    scan = read_scan(nxtomo(lambda e: e["instrument/detector/x_pixel_size"].attrs.__delitem__("units")), counts=True)
    assert scan.detector_pitch_mm is None
    assert "instrument/detector/x_pixel_size was ignored: it has no units attribute." in scan.remarks


def test_format_is_recognised_by_content_not_by_name(nxtomo, tmp_path, stack):
    disguised = shutil.copy(nxtomo(), tmp_path / "scan.tif")
    np.testing.assert_array_equal(read_scan(disguised, counts=True).projections, stack)


def test_given_angles_that_agree_are_accepted_and_win_over_angles_without_units_with_a_remark(nxtomo, angles_deg):
    scan = read_scan(nxtomo(angle_units=None), counts=True, angles_deg=STEPS)
    np.testing.assert_allclose(np.rad2deg(scan.angles_rad), np.arange(6) * 60.0)
    assert any("no units attribute" in remark for remark in scan.remarks)
    scan = read_scan(nxtomo(), counts=True, angles_deg=AngleList(tuple(angles_deg + 5e-7)), detector_pitch_mm=1.5)
    np.testing.assert_allclose(np.rad2deg(scan.angles_rad), angles_deg, atol=1e-6)


def test_single_precision_angles_agree_with_their_double_precision_source(nxtomo):
    exact = np.array([0.1, 60.1, 120.1, 180.1, 240.1, 359.1])

    def store_single(entry):
        units = entry["sample/rotation_angle"].attrs["units"]
        del entry["sample/rotation_angle"]
        entry["sample/rotation_angle"] = np.concatenate([np.zeros(4), exact]).astype(np.float32)
        entry["sample/rotation_angle"].attrs["units"] = units

    assert len(read_scan(nxtomo(store_single), counts=True, angles_deg=AngleList(tuple(exact))).angles_rad) == 6


def test_one_of_several_entries_is_chosen_by_dataset(nxtomo, stack):
    path = nxtomo(lambda entry: entry.file.copy(entry, "scan_2"))
    with pytest.raises(UnreadableScan, match=r"several NXtomo entries \(/scan_1, /scan_2\)") as refusal:
        read_scan(path, counts=True)
    assert refusal.value.code == "dataset-ambiguous"
    np.testing.assert_array_equal(read_scan(path, counts=True, dataset="scan_2").projections, stack)


@pytest.mark.parametrize("unit", [None, "degrees", "rad"])
def test_data_exchange(tmp_path, stack, angles_deg, unit):
    theta = np.deg2rad(angles_deg) if unit == "rad" else angles_deg
    parts = {"data": stack, "data_white": np.full((2, 3, 8), 50_000), "data_dark": np.full((3, 8), 9), "theta": theta}
    members = {"implements": "exchange"} | {f"exchange/{name}": value for name, value in parts.items()}
    hdf5(members, [("exchange/theta", "units", unit)] * (unit is not None))(tmp_path / "scan.h5")
    scan = read_as("hdf5-data-exchange", stack, tmp_path / "scan.h5", counts=True)
    np.testing.assert_allclose(scan.angles_rad, np.deg2rad(angles_deg), rtol=1e-14)
    assert (scan.flats.shape, scan.darks.shape) == ((2, 3, 8), (1, 3, 8))


def test_plain_hdf5_takes_the_only_candidate_or_the_named_one(tmp_path, stack):
    path = tmp_path / "scan.h5"
    hdf5({"a/first": stack, "note": "hello"})(path)
    assert read_scan(path, counts=False, angles_deg=STEPS).format == "hdf5"
    with h5py.File(path, "a") as file:
        file["b/second"] = stack + 1
    with pytest.raises(UnreadableScan, match=r"a/first \(6, 3, 8\), b/second \(6, 3, 8\)"):
        read_scan(path, counts=False, angles_deg=STEPS)
    chosen = read_scan(path, counts=False, dataset="/b/second", angles_deg=STEPS)
    np.testing.assert_array_equal(chosen.projections, stack + 1)


def test_plain_hdf5_takes_a_link_by_its_name_and_groups_that_contain_themselves_end(tmp_path, stack):
    path = tmp_path / "scan.h5"
    hdf5({"a/sino": stack, "b": stack, "z": h5py.SoftLink("/a/sino")})(path)
    np.testing.assert_array_equal(read_scan(path, counts=False, dataset="z", angles_deg=STEPS).projections, stack)
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file["group/sino"] = stack
        file["group/again"] = file["group"]
    np.testing.assert_array_equal(read_scan(path, counts=False, angles_deg=STEPS).projections, stack)


@pytest.mark.parametrize("options", [{}, {"compression": "zlib"}, {"bigtiff": True}, {"byteorder": ">"}])
def test_multi_page_tiff(tmp_path, stack, options):
    path = tmp_path / "scan.tif"
    tifffile.imwrite(path, stack.astype(np.uint16), photometric="minisblack", **options)
    read_as("tiff", stack, path, counts=False, angles_deg=STEPS)


def test_tiff_with_one_page_is_a_sinogram(tmp_path, stack):
    path = tmp_path / "sinogram.tif"
    tifffile.imwrite(path, stack[:, 0])
    scan = read_scan(path, counts=False, angles_deg=STEPS)
    np.testing.assert_array_equal(scan.projections, stack[:, :1])
    assert "sinogram of one row" in scan.remarks[0]


def test_zip_of_tiffs_sorts_naturally_and_knows_flats_and_darks(tmp_path, rng):
    views = rng.integers(0, 60_000, (12, 3, 8))
    members = {f"scan/view-{view}.tif": as_image(views[view]) for view in (11, 2, 0, 1, 10, 9, 8, 3, 4, 5, 6, 7)}
    members |= {"scan/Flats/0.tif": as_image(np.full((3, 8), 50_000)), "scan/dark_1.tif": as_image(np.full((3, 8), 5))}
    members |= {"__MACOSX/scan/view-0.tif": b"not a tiff", "scan/readme.txt": b"hello"}
    zipped(members, ZIP_DEFLATED)(tmp_path / "scan.zip")
    scan = read_as("zip-of-tiffs", views, tmp_path / "scan.zip", counts=True, angles_deg=AngleSteps(0, 30))
    assert np.all(scan.flats == 50_000)
    assert np.all(scan.darks == 5)
    assert scan.remarks == ("2 files that are no TIFFs were ignored (__MACOSX/scan/view-0.tif, scan/readme.txt).",)


@pytest.mark.parametrize("dtype", ["<f8", ">f4", "<u2", "|i1", "<f2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_of_any_real_type_and_order(tmp_path, rng, dtype, order):
    values = np.asarray(rng.integers(0, 100, (6, 3, 8)), dtype=dtype, order=order)
    np.save(tmp_path / "scan.npy", values)
    scan = read_scan(tmp_path / "scan.npy", counts=False, angles_deg=STEPS)
    np.testing.assert_array_equal(scan.projections, values)
    assert scan.projections.dtype == np.float32


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz_with_everything(tmp_path, stack, angles_deg, save):
    fields = {"flats": np.full((2, 3, 8), 9e4), "darks": np.ones((3, 8))}
    save(tmp_path / "scan.npz", projections=stack, angles_rad=np.deg2rad(angles_deg), **fields, other=stack)
    scan = read_as("npz", stack, tmp_path / "scan.npz", counts=True)
    np.testing.assert_allclose(scan.angles_rad, np.deg2rad(angles_deg), rtol=1e-15)
    assert (scan.flats.shape, scan.darks.shape) == ((2, 3, 8), (1, 3, 8))


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_v5(tmp_path, stack, angles_deg, compressed):
    contents = {"arr": stack[:, 0], "angles_deg": angles_deg, "comment": "text"}
    scipy.io.savemat(tmp_path / "scan.mat", contents, do_compression=compressed)
    scan = read_as("mat-v5", stack[:, :1], tmp_path / "scan.mat", counts=False)
    np.testing.assert_allclose(np.rad2deg(scan.angles_rad), angles_deg)


MEASURED = {"angles": np.arange(75.0, 78.0, 0.5), "distanceUnit": "mm", "distanceSourceOrigin": 410.66, "kind": "Cone"}


@pytest.mark.parametrize("compressed", [False, True])
def test_a_field_of_a_mat_v5_struct_is_named_by_its_path(tmp_path, stack, compressed):
    contents = {"before": np.eye(3), "scan": {"note": "text", "parameters": MEASURED, "sinogram": stack[:, 0]}}
    scipy.io.savemat(tmp_path / "scan.mat", contents, do_compression=compressed)
    scan = read_as(
        "mat-v5", stack[:, :1], tmp_path / "scan.mat", counts=False, dataset="scan/sinogram", angles_deg=STEPS
    )
    held = "scan/parameters/distanceUnit ('mm'), scan/parameters/distanceSourceOrigin (410.66)"
    assert scan.unused == held
    angles = "scan/parameters/angles (6 values from 75 to 77.5)"
    assert scan.remarks == (
        f"No name states meaning and unit of {held}: not used.",
        f"The angles given were used: no name states meaning and unit of {angles}.",
    )


def test_angles_of_unknown_unit_are_named_and_not_used(tmp_path, stack):
    scipy.io.savemat(tmp_path / "scan.mat", {"scan": {"sinogram": stack[:, 0], "parameters": MEASURED}})
    with pytest.raises(UnreadableScan, match=r"scan/parameters/angles \(6 values from 75 to 77.5\); give the angles"):
        read_scan(tmp_path / "scan.mat", counts=False, dataset="scan/sinogram")


def test_a_sinogram_in_the_order_of_radon_is_read_when_asked_for_and_named_by_the_refusal(tmp_path, stack, angles_deg):
    """(cells, views), with an angle for each view in a list whose name states no unit."""
    scipy.io.savemat(tmp_path / "scan.mat", {"sinogram": stack[:, 0].T, "parameters": {"anglesRad": np.arange(6.0)}})
    hint = r"8 views of 6 cells; if it holds 6 views of 8 cells, .* give transpose \(on the command line --transpose\)"
    with pytest.raises(UnreadableScan, match=rf"anglesRad \(6 values from 0 to 5\) fits the cells.* {hint}"):
        read_scan(tmp_path / "scan.mat", counts=False)
    each = AngleList(tuple(angles_deg))
    with pytest.raises(UnreadableScan, match=f"there are 6 angles, one for each cell: .* {hint}"):
        read_scan(tmp_path / "scan.mat", counts=False, angles_deg=each)
    assert "fits the cells" in read_scan(tmp_path / "scan.mat", counts=False, angles_deg=STEPS).remarks[-1]
    scan = read_scan(tmp_path / "scan.mat", counts=False, angles_deg=each, transpose=True)
    np.testing.assert_array_equal(scan.projections, stack[:, :1])
    np.save(tmp_path / "scan.npy", stack[:, 0])
    with pytest.raises(UnreadableScan, match=r"6 views of 8 cells, leave transpose out \(on the command line"):
        read_scan(tmp_path / "scan.npy", counts=False, angles_deg=each, transpose=True)


@pytest.mark.parametrize("of_flats", [np.asarray, lambda flats: flats[..., 0]])
def test_a_stack_in_the_reverse_order_has_its_fields_in_it_too(tmp_path, stack, angles_deg, of_flats):
    flats = np.full((8, 3, 2), 60_000.0, np.float32)
    np.savez(tmp_path / "scan.npz", projections=stack.T, angles_deg=angles_deg, flats=of_flats(flats))
    scan = read_scan(tmp_path / "scan.npz", counts=True, transpose=True)
    np.testing.assert_array_equal(scan.projections, stack)
    assert scan.flats.shape[1:] == (3, 8)
    with pytest.raises(UnreadableScan, match=r"the file carries 6 angles, one for each cell: .* --transpose"):
        read_scan(tmp_path / "scan.npz", counts=True)


def test_mat_v5_of_a_machine_with_the_other_byte_order(tmp_path, stack):
    """As a big-endian machine writes it: every word, and the data, the other way round."""
    values = stack[:, 0]
    parts = [
        struct.pack(">4I", 6, 8, 7, 0),  # array flags: single
        struct.pack(">2I2i", 5, 8, *values.shape),
        struct.pack(">2I8s", 1, 3, b"arr"),
        struct.pack(">2I", 7, values.nbytes) + values.T.astype(">f4").tobytes(),
    ]
    body = b"".join(parts)
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    (tmp_path / "scan.mat").write_bytes(header + struct.pack(">2I", 14, len(body)) + body)
    scan = read_scan(tmp_path / "scan.mat", counts=False, angles_deg=STEPS)
    np.testing.assert_array_equal(scan.projections, stack[:, :1])


@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_mat_v5_of_any_real_type(tmp_path, rng, dtype):
    values = rng.integers(0, 100, (6, 3, 8)).astype(dtype)
    scipy.io.savemat(tmp_path / "scan.mat", {"arr": values})
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.mat", counts=False, angles_deg=STEPS).projections, values)


def test_a_field_of_a_mat_v73_struct_is_named_by_its_path(tmp_path, stack):
    unit = np.array([[109], [109]], np.uint16)
    fields = {"scan/sinogram": stack[:, 0].T, "scan/pixelSize": np.array([[0.2]]), "scan/pixelUnit": unit}
    classes = {"scan": b"struct", "scan/sinogram": b"double", "scan/pixelSize": b"double", "scan/pixelUnit": b"char"}
    hdf5(fields, [(name, "MATLAB_class", np.bytes_(kind)) for name, kind in classes.items()])(tmp_path / "scan.mat")
    read = read_as(
        "mat-v7.3", stack[:, :1], tmp_path / "scan.mat", counts=False, dataset="scan/sinogram", angles_deg=STEPS
    )
    assert read.unused == "scan/pixelSize (0.2), scan/pixelUnit ('mm')"


def test_mat_v73_is_transposed_with_a_remark(tmp_path, stack):
    path = tmp_path / "scan.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["sinogram"] = stack[:, 0].T
        file["sinogram"].attrs["MATLAB_class"] = np.bytes_(b"single")
        file["label"] = np.zeros((8, 8), np.uint16)
        file["label"].attrs["MATLAB_class"] = np.bytes_(b"char")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert "transposed" in read_as("mat-v7.3", stack[:, :1], path, counts=False, angles_deg=STEPS).remarks[0]


def test_counts_without_darks_say_so(tmp_path, stack):
    np.savez(tmp_path / "scan.npz", data=stack, flats=np.ones((1, 3, 8)))
    scan = read_scan(tmp_path / "scan.npz", counts=True, angles_deg=STEPS)
    assert scan.darks is None
    assert scan.remarks == ("There are no dark fields: the detector's offset was taken as zero.",)


def test_closing_view_and_second_turn_are_allowed(tmp_path, stack):
    np.save(tmp_path / "scan.npy", stack)
    closing = read_scan(tmp_path / "scan.npy", counts=False, angles_deg=AngleSteps(0, 72))
    assert np.rad2deg(closing.angles_rad[-1]) == pytest.approx(360)
    assert len(read_scan(tmp_path / "scan.npy", counts=False, angles_deg=AngleSteps(0, 120)).angles_rad) == 6


@pytest.mark.parametrize(
    ("file", "shape", "kind", "median"),
    [
        ("l-phantom/sinogram.mat", (360, 1, 768), "mat-v5", 3.3477),
        ("log-phantom/sinogram.npy", (360, 1, 768), "npy", 31.4773),
        ("log-phantom/truth.mat", (256, 1, 256), "mat-v7.3", 0.2341),
        ("measured-disc/scan.mat", (181, 1, 560), "mat-v5", 1.1524),
    ],
)
def test_published_files(published_data, file, shape, kind, median):
    scan = read_scan(published_data / file, counts=False, angles_deg=AngleSteps(0.5, 1))
    assert (scan.projections.shape, scan.format) == (shape, kind)
    assert np.median(scan.projections) == pytest.approx(median, abs=1e-3)


def test_rows_of_zero_counts_are_missing_where_rows_may_be(tmp_path, stack, angles_deg):
    stack[2, 0] = 0.0
    flats = np.full((1, *stack.shape[1:]), 60_000.0, np.float32)
    np.savez(tmp_path / "scan.npz", projections=stack, flats=flats, angles_deg=angles_deg)
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.npz", counts=True).projections, stack)
    missing = read_scan(tmp_path / "scan.npz", counts=True, rows_missing=True).projections
    assert np.isnan(missing[2, 0]).all()
    assert np.isnan(missing).sum() == stack.shape[2]


def test_tiffs_that_lost_rows_are_read_as_lacking_them_at_the_bottom(tmp_path, rng):
    views = rng.integers(1, 60_000, (4, 6, 8))
    path = tmp_path / "scan.zip"
    members = {f"view-{view}.tif": as_image(views[view, :rows]) for view, rows in enumerate((6, 5, 4, 6))}
    zipped(members | {"flat.tif": as_image(np.full((6, 8), 50_000))})(path)
    scan = read_scan(path, counts=True, angles_deg=AngleSteps(0, 90), rows_missing=True)
    assert np.isnan(scan.projections).any(axis=2).sum(axis=1).tolist() == [0, 1, 2, 0]
    assert np.isnan(scan.projections[2, 4:]).all()
    np.testing.assert_array_equal(scan.projections[2, :4], views[2, :4])
    assert "Views of fewer than 6 rows were read as lacking rows at their end." in scan.remarks
    with pytest.raises(UnreadableScan, match=r"view 1, row 5 is NaN in every cell; .* ask for align_rows"):
        read_scan(path, counts=True, angles_deg=AngleSteps(0, 90))


def test_tiffs_of_half_the_height_are_no_views_of_one_log(tmp_path):
    zipped({f"view-{view}.tif": as_image(np.ones((rows, 8))) for view, rows in enumerate((6, 2, 6))})(
        tmp_path / "scan.zip"
    )
    with pytest.raises(UnreadableScan, match="all must be of one size"):
        read_scan(tmp_path / "scan.zip", counts=True, angles_deg=AngleSteps(0, 120), rows_missing=True)
