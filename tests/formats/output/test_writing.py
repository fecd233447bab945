"""What is written can be read back, is described in the file itself, and is never half there."""

import json
import resource
import subprocess
import sys
import textwrap
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest
from scan_files import read_scan, read_stored_scan, write_scan

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.hdf5 import whole_hdf5
from sawmill_formats.input.own import is_own_scan
from sawmill_formats.nexus import unit_of, write_mapping
from sawmill_formats.output.calibration_file import NamedArray, write_calibration
from sawmill_formats.output.scan_writer import write_raw_scan
from sawmill_formats.output.volume_writer import new_reconstruction


@pytest.fixture
def scan(stack, angles_deg):
    return {
        "line_integrals": stack,
        "angles_rad": np.deg2rad(angles_deg),
        "detector_pitch_mm": 1.502864583,
        "row_pitch_mm": 2.0,
        "air_level": np.full(stack.shape[1:], 59_993, np.float32),
        "provenance": {"input_sha256": "abc", "remarks": "none"},
    }


def test_written_scan_reads_as_an_upload(tmp_path, scan):
    write_scan(tmp_path / "scan.h5", **scan)
    read = read_scan(tmp_path / "scan.h5", counts=False, detector_pitch_mm=1.502864583, row_pitch_mm=2.0)
    np.testing.assert_array_equal(read.projections, scan["line_integrals"])
    np.testing.assert_allclose(read.angles_rad, scan["angles_rad"], rtol=1e-15)
    assert (read.detector_pitch_mm, read.row_pitch_mm) == (1.502864583, 2.0)
    assert read.remarks == ()


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        ("sample/rotation_angle", 1e308, "the angle of view 0 is 1e[+]308 degrees"),
        ("instrument/detector/x_pixel_size", -1.5, "x_pixel_size is -1.5 mm"),
        ("instrument/detector/y_pixel_size", 1e308, r"y_pixel_size is 1e[+]308 mm"),
    ],
)
def test_a_written_scan_with_absurd_values_is_not_read_as_it_is(tmp_path, scan, path, value, sentence):
    write_scan(tmp_path / "scan.h5", **scan)
    assert is_own_scan(tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5", "r+") as file:
        dataset = file[f"entry/{path}"]
        dataset[(0,) * dataset.ndim] = value
    assert not is_own_scan(tmp_path / "scan.h5")
    with pytest.raises(UnreadableScan, match=sentence):
        read_scan(tmp_path / "scan.h5", counts=False)


def test_a_stored_scan_reads_whole_and_by_rows_and_views_and_one_row_is_one_chunk(tmp_path, scan):
    write_scan(tmp_path / "scan.h5", **scan)
    stored = read_stored_scan(tmp_path / "scan.h5")
    np.testing.assert_array_equal(stored.line_integrals, scan["line_integrals"])
    np.testing.assert_array_equal(stored.air_level, scan["air_level"])
    assert (stored.detector_pitch_mm, stored.row_pitch_mm) == (1.502864583, 2.0)
    views = np.array([4, 0])
    stored = read_stored_scan(tmp_path / "scan.h5", slice(1, 3), views)
    np.testing.assert_array_equal(stored.line_integrals, scan["line_integrals"][views, 1:3])
    np.testing.assert_allclose(stored.angles_rad, scan["angles_rad"][views])
    assert stored.air_level.shape == (2, 8)
    with h5py.File(tmp_path / "scan.h5") as file:
        assert file["entry/instrument/detector/data"].chunks == (6, 1, 8)
        assert file["entry/data/data"] == file["entry/instrument/detector/data"]
        assert file["entry/provenance/input_sha256"][()] == b"abc"
        assert "row_shifts" not in file["entry/provenance"]


def test_a_scan_keeps_the_shifts_of_its_views_and_may_lack_air_level_and_row_pitch(tmp_path, scan):
    write_scan(tmp_path / "scan.h5", **scan, row_shifts=np.array([0.0, 1, 2.5, 0, 3, 1]))
    with h5py.File(tmp_path / "scan.h5") as file:
        shifts = file["entry/provenance/row_shifts"]
        assert shifts.attrs["units"] == "row"
        np.testing.assert_array_equal(shifts, [0.0, 1, 2.5, 0, 3, 1])
    write_scan(tmp_path / "scan.h5", **(scan | {"air_level": None, "row_pitch_mm": None}))
    stored = read_stored_scan(tmp_path / "scan.h5")
    assert (stored.air_level, stored.row_pitch_mm) == (None, None)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_raw_counts_round_trip(tmp_path, stack, angles_deg, dtype):
    flats, darks = np.full((2, 3, 8), 60_000, dtype), np.full((4, 3, 8), 50, dtype)
    places = {"angles_rad": np.deg2rad(angles_deg), "detector_pitch_mm": 1.5, "row_pitch_mm": 2.0}
    counts = stack.astype(dtype)
    write_raw_scan(tmp_path / "raw.h5", counts.shape, counts.dtype, counts=[counts], flats=flats, darks=darks, **places)
    scan = read_scan(tmp_path / "raw.h5", counts=True)
    np.testing.assert_array_equal(scan.projections, stack)
    np.testing.assert_array_equal(scan.flats, flats)
    np.testing.assert_array_equal(scan.darks, darks)
    np.testing.assert_allclose(scan.angles_rad, np.deg2rad(angles_deg), rtol=1e-15)


def test_shapes_that_disagree_are_wrong_use(tmp_path, scan):
    with pytest.raises(ValueError, match="one angle for each view"):
        write_scan(tmp_path / "scan.h5", **(scan | {"angles_rad": np.zeros(5)}))
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def reconstruction(tmp_path, rng):
    volume = rng.random((3, 6, 4), dtype=np.float32)
    path = tmp_path / "volume.h5"

    def write(row_pitch_mm=2.0):
        with new_reconstruction(
            path,
            volume.shape,
            pixel_mm=1.5,
            row_pitch_mm=row_pitch_mm,
            unit="1/mm",
            geometry={"theta": {"initial_angle_rad": 2.5, "detector_tilt": 0.28}},
            parameters={"filter": "hann", "size": 6, "field_mm": 9.0, "rows": None, "preparation": ["one", "größer"]},
            software_version="0.1.0",
            input_sha256="f00",
        ) as volume_file:
            volume_file.write(0, volume[:2])
            volume_file.write(2, volume[2:])
        return path, volume

    return write


def test_volume_carries_axes_units_and_origin(reconstruction):
    path, volume = reconstruction()
    with h5py.File(path) as file:
        entry = file["entry"]
        assert entry["definition"][()] == b"NXtomoproc"
        data = entry["data"]
        assert (data.attrs["NX_class"], data.attrs["signal"]) == ("NXdata", "data")
        assert list(data.attrs["axes"]) == ["z", "x", "y"]
        np.testing.assert_array_equal(data["data"], volume)
        assert (data["data"].dtype, data["data"].attrs["units"]) == (np.float32, "1/mm")
        assert (data["data"].compression, data["data"].fletcher32, data["data"].chunks) == ("gzip", True, (1, 6, 4))
        np.testing.assert_allclose(data["x"], [-3.75, -2.25, -0.75, 0.75, 2.25, 3.75])
        np.testing.assert_allclose(data["z"], [0, 2, 4])
        assert data["y"].attrs["units"] == "mm"
        assert all(entry["reconstruction"][name] == data[name] for name in ("data", "x", "y", "z"))
        assert entry["reconstruction/version"][()] == b"0.1.0"
        assert entry["reconstruction/input_sha256"][()] == b"f00"
        assert entry["reconstruction/parameters/field_mm"].attrs["units"] == "mm"
        assert entry["reconstruction/parameters/rows"].shape is None
        assert entry["geometry/theta/initial_angle_rad"][()] == 2.5
        assert entry["geometry/theta/initial_angle_rad"].attrs["units"] == "rad"
        assert "units" not in entry["geometry/theta/detector_tilt"].attrs


def test_volume_carries_what_its_definition_asks_for(reconstruction):
    path, _ = reconstruction()
    with h5py.File(path) as file:
        entry = file["entry"]
        texts = {
            "title": "Attenuation of a log, in slices 3 x 6 x 4",
            "instrument/source/type": "Fixed Tube X-ray",
            "instrument/source/name": "X-ray tube of the sawmill's scanner",
            "instrument/source/probe": "x-ray",
            "sample/name": "log",
            "process/parameters/raw_file": "sha256:f00",
        }
        assert {path: entry[path].asstr()[()] for path in texts} == texts
        groups = "instrument", "instrument/source", "sample", "process", "process/parameters"
        classes = ["NXinstrument", "NXsource", "NXsample", "NXprocess", "NXparameters"]
        assert [entry[group].attrs["NX_class"] for group in groups] == classes
        assert entry["reconstruction"] == entry["process"]
        assert abs(datetime.now(UTC) - datetime.fromisoformat(entry["process/date"].asstr()[()])) < timedelta(minutes=5)
        stored = entry["data/data"].attrs
        assert (stored["transform"], stored["offset"], stored["scaling"]) == ("none", "0", "1")


def test_texts_in_a_list_are_an_array_of_texts(reconstruction, tmp_path):
    path, _ = reconstruction()
    with h5py.File(path) as file:
        assert list(file["entry/process/parameters/preparation"].asstr()) == ["one", "größer"]
    with h5py.File(tmp_path / "none.h5", "w") as file:
        write_mapping(file, "method", {"remarks": []})
        assert list(file["method/remarks"].asstr()) == []


def test_slices_without_spacing_are_counted(reconstruction):
    path, _ = reconstruction(row_pitch_mm=None)
    with h5py.File(path) as file:
        data = file["entry/data"]
        assert list(data.attrs["axes"]) == ["slice", "x", "y"]
        np.testing.assert_array_equal(data["slice"], [0, 1, 2])
        assert data["z"] == data["slice"]
        assert "z" not in file["entry/reconstruction"]


def plot_of(group):
    """What a NeXus viewer shows of a group: the chain of `default` down to an NXdata, its signal, errors and axes."""
    while "default" in group.attrs:
        group = group[group.attrs["default"]]
    assert group.attrs["NX_class"] == "NXdata"
    signal = group[group.attrs["signal"]]
    axes = [group[name] for name in group.attrs["axes"]]
    assert signal.shape == tuple(len(axis) for axis in axes)
    return group["title"][()].decode(), signal, group.get(f"{group.attrs['signal']}_errors"), axes


@pytest.mark.parametrize(("row_pitch_mm", "along"), [(2.0, "z, along the log (mm)"), (None, "slice")])
def test_a_viewer_finds_the_volume_and_its_side_views(reconstruction, row_pitch_mm, along):
    path, volume = reconstruction(row_pitch_mm)
    with h5py.File(path) as file:
        title, signal, errors, axes = plot_of(file)
        assert (title, signal.attrs["long_name"]) == ("Attenuation of a log, in slices 3 x 6 x 4", "attenuation (1/mm)")
        assert axes[0].attrs["long_name"] == along
        assert [axis.attrs["units"] for axis in axes] == ["mm" if row_pitch_mm else "1", "mm", "mm"]
        np.testing.assert_array_equal(signal[()], volume)
        assert errors is None
        title, signal, errors, axes = plot_of(file["entry/side_view/along_x"])
        assert (title, signal.attrs["long_name"], errors) == ("Densest along x", "attenuation (1/mm)", None)
        assert axes[0].attrs["long_name"] == along


def test_calibration_keeps_its_answer_twice_and_its_arrays(tmp_path, rng):
    result = {
        "theta": {"source_shift_mm": 319.9},
        "standard_deviation": {"theta": {"source_shift_mm": None}},
        "predicted_ray_error_mm": {"rms": 0.02, "radius_mm": 150},
        "covariance": [[1.0, 0.5], [0.5, 2.0]],
        "reasons": ["the tilt is uncertain"],
        "hypotheses": [{"handedness": "as-drawn"}],
        "ragged": [[1, 2], [3]],
        "verdict": "pass",
        "converged": True,
    }
    residual = rng.random((5, 4)).astype(np.float32)
    path = tmp_path / "calibration.h5"
    field_mm = NamedArray(np.array(330.0), "mm", "side")
    arrays = {"residual": NamedArray(residual, "1", "view, detector"), "field_mm": field_mm}
    write_calibration(path, result, arrays, software_version="0.1.0", input_sha256="f00")
    with h5py.File(path) as file:
        assert json.loads(file["entry/calibration_json"][()]) == result
        group = file["entry/calibration"]
        assert group["theta/source_shift_mm"][()] == 319.9
        assert group["standard_deviation/theta/source_shift_mm"].shape is None
        assert group["predicted_ray_error_mm/rms"].attrs["units"] == "mm"
        np.testing.assert_array_equal(group["covariance"], result["covariance"])
        assert json.loads(group["hypotheses"][()]) == result["hypotheses"]
        assert json.loads(group["ragged"][()]) == result["ragged"]
        assert list(group["reasons"].asstr()) == result["reasons"]
        assert bool(group["converged"][()])
        np.testing.assert_array_equal(file["entry/arrays/residual"], residual)
        assert file["entry/arrays/residual"].attrs["axes_description"] == "view, detector"
        assert (file["entry/arrays/field_mm"][()], file["entry/arrays/field_mm"].attrs["units"]) == (330.0, "mm")


@pytest.mark.parametrize(
    ("name", "unit"),
    [("pixel_mm", "mm"), ("psi_rad", "rad"), ("attenuation_per_mm", "1/mm"), ("s", None), ("views", None)],
)
def test_unit_is_taken_from_the_name(name, unit):
    assert unit_of(name) == unit


def test_failure_leaves_nothing_and_keeps_the_older_file(tmp_path):
    path = tmp_path / "result.h5"
    path.write_bytes(b"older")
    with pytest.raises(ZeroDivisionError), whole_hdf5(path) as file:
        file["data"] = [1 // 0]
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("result.h5", b"older")]


# What was written is read again, as where a scan is prepared in two passes: what comes back then is wrong.
@pytest.mark.parametrize("then", ["pass", "[scan.data[:, row] for row in range(60)]"])
def test_full_disk_is_a_sentence_and_leaves_nothing(tmp_path, then):
    # In a process of its own: the limit on file sizes stands for a full disk, and HDF5 has crashed on one.
    program = f"""
        import resource, numpy
        from pathlib import Path
        from sawmill_formats.output.scan_writer import new_scan
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, {resource.RLIM_INFINITY}))
        stack = numpy.random.default_rng(5).random((50, 60, 4000), dtype="f4")
        new = new_scan(Path({str(tmp_path / "scan.h5")!r}), stack.shape, angles_rad=numpy.arange(50.0),
                       detector_pitch_mm=1.0, row_pitch_mm=None)
        try:
            with new as scan:
                scan.data[...] = stack
                {then}
        except OSError as error:
            print(error)
        """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "[Errno 27] scan.h5 could not be written: File too large"
    assert list(tmp_path.iterdir()) == []
