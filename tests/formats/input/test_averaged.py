"""Scans that come as the mean of line integrals over rows: what may stand beside it, and what is refused."""

import io
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.io

from sawmill_calibration.scans.averaged_rays import AveragedRays
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.averaged import AveragedRows
from sawmill_formats.input.reading import reading_scan

VIEWS, CELLS = 9, 64
# Chords of a disc in the middle of the detector.
MEAN = np.tile(np.sqrt(np.clip(1.0 - np.linspace(-1.6, 1.6, CELLS) ** 2, 0.0, None)), (VIEWS, 1)).astype(np.float32)
LAMP = np.tile(6e4 * (1.0 - np.linspace(-0.95, 0.95, CELLS) ** 2), (VIEWS, 1))
DEVIATIONS = np.full((VIEWS, CELLS), 0.01, np.float32)


def put(array, value, at=(3, 30)):
    changed = array.copy()
    changed[at] = value
    return changed


@pytest.fixture
def read(tmp_path):
    """What a file is read as: its rays (views, detector) and what stands beside them."""

    def of(content, *, rows=1000, **given):
        path = tmp_path / "mean"
        path.write_bytes(content)
        given = {"counts": False, "angles_deg": AngleSteps(0.0, 40.0), "averaged_rows": rows} | given
        with reading_scan(path, **given) as scan:
            (block,) = scan.blocks(2**20)
            return replace(scan, projections=block.samples[:, 0])

    return of


def npy(array, **options):
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def hdf5(**arrays):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, array in arrays.items():
            file[name] = array
    return buffer.getvalue()


def mat(**arrays):
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, arrays)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "stored",
    [
        MEAN,
        MEAN.astype(np.float64),
        MEAN.astype(">f4"),
        np.asfortranarray(MEAN.astype("<f8")),
        MEAN[:, None],
    ],
    ids=["float32", "float64", "big-endian", "fortran-order", "one-row"],
)
def test_any_array_of_real_numbers_is_the_same_mean(read, stored):
    scan = read(npy(stored))
    np.testing.assert_array_equal(scan.projections, MEAN)
    assert (scan.averaged.rows, scan.averaged.deviations) == (1000, None)


@pytest.mark.parametrize("written", [npz, hdf5, mat])
def test_deviations_stand_beside_the_mean_by_their_name(read, written):
    scan = read(written(mean=MEAN, deviations=DEVIATIONS))
    np.testing.assert_array_equal(scan.projections, MEAN)
    np.testing.assert_array_equal(scan.averaged.deviations, DEVIATIONS)


def test_deviations_of_one_row_have_its_shape(read):
    scan = read(npz(mean=MEAN[:, None], deviations=DEVIATIONS[:, None]))
    np.testing.assert_array_equal(scan.averaged.deviations, DEVIATIONS)


def test_a_ray_is_masked_by_nan_or_by_an_infinite_deviation(read):
    scan = read(npz(mean=put(MEAN, np.nan), deviations=put(put(DEVIATIONS, np.nan), np.inf, (5, 7))))
    assert np.argwhere(np.isnan(scan.projections)).tolist() == [[3, 30], [5, 7]]


NOT_SO = {
    "several rows": (
        npy(np.zeros((VIEWS, 3, CELLS), np.float32)),
        "wrong-shape",
        r"1000 rows were averaged, .*\(9, 3",
    ),
    "one axis": (npy(MEAN[0]), "wrong-shape", r"has the shape \(64,\)"),
    "infinite": (npy(put(MEAN, np.inf)), "not-finite", "view 3, row 0, cell 30 is inf"),
    "a view of NaN": (npy(put(MEAN, np.nan, 4)), "not-finite", "64 of 64 rays of view 4 are masked"),
    "many masked": (npy(put(MEAN, np.nan, (4, slice(13)))), "not-finite", "13 of 64 rays of view 4 .* at most 20%"),
    "objects": (npy(MEAN.astype(object)), "wrong-type", r"texts or objects"),
    "text": (npy(MEAN.astype(str)), "wrong-type", "text"),
    "complex": (npy(MEAN.astype(np.complex64)), "wrong-type", "complex numbers"),
    "huge header": (npy(MEAN).replace(b"\x76\x00{", b"\xff\xff{", 1), "too-large", "claims to have 65535 bytes"),
    "cut short": (npy(MEAN)[:-4], "truncated-file", "declares 2304 bytes of data and the file holds 2300"),
    "many values": (npy(MEAN * 1e7), "contradiction", r"reach 1e\+07 .* or in another unit"),
    "counts": (
        npy(4e4 * np.exp(-MEAN)),
        "contradiction",
        r"reach 4e\+04 .* every row first",
    ),
    "counts of a lamp that is dark at its ends": (
        npy(LAMP * np.exp(-0.3 * MEAN)),
        "contradiction",
        r"reach 4\.\d\de\+04 .* above 50, .* every row first",
    ),
    "counts turned over": (npy(65535 - 4e4 * np.exp(-MEAN)), "contradiction", r"reach 5\.08e\+04"),
    "no flat field": (
        npy(-np.log(4e4 * np.exp(-MEAN))),
        "contradiction",
        r"are -10\.6 at the detector's ends, .* not divided by the flat field",
    ),
    "transmissions": (npy(np.exp(-MEAN)), "contradiction", "-ln of a mean is not the mean of -ln"),
    "logarithms": (npy(-MEAN), "contradiction", "fall from -?0 at .* line integrals rise"),
    "deviations of a view": (npz(p=MEAN, deviations=DEVIATIONS[:, 0]), "wrong-shape", r"shape \(9,\) and .* \(9, 64\)"),
    "deviations of others": (npz(p=MEAN, deviations=DEVIATIONS[1:]), "wrong-shape", r"\(8, 64\) and .* \(9, 64\)"),
    "negative": (npz(p=MEAN, deviations=put(DEVIATIONS, -0.1)), "out-of-range", "view 3, cell 30 is -0.1; .* above 0"),
    "zero": (npz(p=MEAN, deviations=put(DEVIATIONS, 0)), "out-of-range", "view 3, cell 30 is 0; it must be above"),
    "NaN deviation": (npz(p=MEAN, deviations=put(DEVIATIONS, np.nan)), "out-of-range", "view 3, cell 30 is nan"),
    "a number for not known": (
        npz(p=MEAN, deviations=put(DEVIATIONS, 1e30)),
        "out-of-range",
        r"is 1e\+30; .* not above the largest line integral \(.*\), and infinite",
    ),
    "deviations as objects": (
        npz(p=MEAN, deviations=DEVIATIONS.astype(object)),
        "wrong-type",
        "'deviations' is of type",
    ),
    "flat fields": (npz(projections=MEAN, flats=DEVIATIONS), "contradiction", "flat or dark fields, as counts do"),
}


@pytest.mark.parametrize("what", NOT_SO)
def test_what_cannot_be_the_mean_of_line_integrals_is_refused_in_a_sentence(read, what):
    content, code, sentence = NOT_SO[what]
    with pytest.raises(UnreadableScan, match=re.compile(sentence)) as refusal:
        read(content)
    assert (refusal.value.code, str(refusal.value).count("\n")) == (code, 0)


def test_a_log_of_a_tenth_of_the_detector_is_told_from_its_transmissions(read):
    across = np.linspace(-1.0, 1.0, 768)
    thin = np.tile(0.3 * np.sqrt(np.clip(1.0 - (across / 0.1) ** 2, 0.0, None)), (VIEWS, 1))
    noisy = thin + 0.01 * np.random.default_rng(1).standard_normal(thin.shape)
    read(npy(noisy))
    with pytest.raises(UnreadableScan, match="as counts and transmissions do"):
        read(npy(np.exp(-noisy)))


def test_a_mean_is_nan_and_refused_where_nobody_says_that_it_is_one(read):
    with pytest.raises(UnreadableScan, match="every value must be a finite number"):
        read(npy(put(MEAN, np.nan)), rows=None)


def test_a_bridged_ray_is_known_no_better_than_those_that_were_measured():
    rays = np.zeros((2, 1, 40), np.float32)
    rays[0, 0, 10:14] = np.nan
    averaged = AveragedRays(AveragedRows(60, np.full((2, 40), 0.01, np.float32)), rays.shape)
    averaged.bridge(rays, 0)
    assert averaged.deviations[0, 10:14] == pytest.approx(0.01)
    assert averaged.deviations[1] == pytest.approx(0.01)
