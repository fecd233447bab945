"""Scans that come as the mean of line integrals over rows: what may stand beside it, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scan_files import each_refusal, hdf5, mat, npy, npz

from sawmill_calibration.scans.prepare import AveragedRays
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.canonical import AveragedRows
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


def read(tmp_path, write, *, rows=1000, **given):
    """What a file is read as: its rays (views, detector) and what stands beside them."""
    path = tmp_path / "mean"
    write(path)
    given = {"counts": False, "angles_deg": AngleSteps(0.0, 40.0), "averaged_rows": rows} | given
    with reading_scan(path, **given) as scan:
        (block,) = scan.blocks(2**20)
        return replace(scan, projections=block.samples[:, 0])


def edited(write, edit):
    def write_edited(path):
        write(path)
        path.write_bytes(edit(path.read_bytes()))

    return write_edited


@pytest.mark.parametrize(
    "stored",
    [MEAN, MEAN.astype(np.float64), MEAN.astype(">f4"), np.asfortranarray(MEAN.astype("<f8")), MEAN[:, None]],
    ids=["float32", "float64", "big-endian", "fortran-order", "one-row"],
)
def test_any_array_of_real_numbers_is_the_same_mean(tmp_path, stored):
    scan = read(tmp_path, npy(stored))
    np.testing.assert_array_equal(scan.projections, MEAN)
    assert (scan.averaged.rows, scan.averaged.deviations) == (1000, None)


@pytest.mark.parametrize("written", [npz, lambda **arrays: hdf5(arrays), mat])
def test_deviations_stand_beside_the_mean_by_their_name(tmp_path, written):
    scan = read(tmp_path, written(mean=MEAN, deviations=DEVIATIONS))
    np.testing.assert_array_equal(scan.projections, MEAN)
    np.testing.assert_array_equal(scan.averaged.deviations, DEVIATIONS)


def test_deviations_of_one_row_have_its_shape_and_an_infinite_one_masks_its_ray_as_nan_does(tmp_path):
    scan = read(tmp_path, npz(mean=MEAN[:, None], deviations=DEVIATIONS[:, None]))
    np.testing.assert_array_equal(scan.averaged.deviations, DEVIATIONS)
    scan = read(tmp_path, npz(mean=put(MEAN, np.nan), deviations=put(put(DEVIATIONS, np.nan), np.inf, (5, 7))))
    assert np.argwhere(np.isnan(scan.projections)).tolist() == [[3, 30], [5, 7]]


NOT_SO = {
    "several rows": npy(np.zeros((VIEWS, 3, CELLS), np.float32)),
    "one axis": npy(MEAN[0]),
    "infinite": npy(put(MEAN, np.inf)),
    "a view of NaN": npy(put(MEAN, np.nan, 4)),
    "many masked": npy(put(MEAN, np.nan, (4, slice(13)))),
    "objects": npy(MEAN.astype(object)),
    "text": npy(MEAN.astype(str)),
    "complex": npy(MEAN.astype(np.complex64)),
    "huge header": edited(npy(MEAN), lambda data: data.replace(b"\x76\x00{", b"\xff\xff{", 1)),
    "cut short": edited(npy(MEAN), lambda data: data[:-4]),
    "many values": npy(MEAN * 1e7),
    "counts": npy(4e4 * np.exp(-MEAN)),
    "counts of a lamp that is dark at its ends": npy(LAMP * np.exp(-0.3 * MEAN)),
    "counts turned over": npy(65535 - 4e4 * np.exp(-MEAN)),
    "no flat field": npy(-np.log(4e4 * np.exp(-MEAN))),
    "transmissions": npy(np.exp(-MEAN)),
    "logarithms": npy(-MEAN),
    "deviations of a view": npz(p=MEAN, deviations=DEVIATIONS[:, 0]),
    "deviations of others": npz(p=MEAN, deviations=DEVIATIONS[1:]),
    "negative": npz(p=MEAN, deviations=put(DEVIATIONS, -0.1)),
    "zero": npz(p=MEAN, deviations=put(DEVIATIONS, 0)),
    "NaN deviation": npz(p=MEAN, deviations=put(DEVIATIONS, np.nan)),
    "a number for not known": npz(p=MEAN, deviations=put(DEVIATIONS, 1e30)),
    "deviations as objects": npz(p=MEAN, deviations=DEVIATIONS.astype(object)),
    "flat fields": npz(projections=MEAN, flats=DEVIATIONS),
}


@each_refusal(Path(__file__).with_name("averaged.txt"))
def test_what_cannot_be_the_mean_of_line_integrals_is_refused_in_a_sentence(tmp_path, name, code, sentence):
    with pytest.raises(UnreadableScan) as refusal:
        read(tmp_path, NOT_SO[name])
    assert (refusal.value.code, str(refusal.value)) == (code, sentence)


def test_a_mean_is_refused_where_it_is_nan_unnamed_or_of_transmissions(tmp_path):
    thin = np.tile(0.3 * np.sqrt(np.clip(1.0 - (np.linspace(-1.0, 1.0, 768) / 0.1) ** 2, 0.0, None)), (VIEWS, 1))
    noisy = thin + 0.01 * np.random.default_rng(1).standard_normal(thin.shape)
    read(tmp_path, npy(noisy))
    with pytest.raises(UnreadableScan, match="as counts and transmissions do"):
        read(tmp_path, npy(np.exp(-noisy)))
    with pytest.raises(UnreadableScan, match="every value must be a finite number"):
        read(tmp_path, npy(put(MEAN, np.nan)), rows=None)


def test_a_bridged_ray_is_known_no_better_than_those_that_were_measured():
    rays = np.zeros((2, 1, 40), np.float32)
    rays[0, 0, 10:14] = np.nan
    averaged = AveragedRays(AveragedRows(60, np.full((2, 40), 0.01, np.float32)), rays.shape)
    averaged.bridge(rays, 0)
    assert (averaged.deviations[0, 10:14], averaged.deviations[1]) == (pytest.approx(0.01), pytest.approx(0.01))
