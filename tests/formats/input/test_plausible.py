"""Values that no scanner writes: refused with the value, its place and the range; cells at fault are not the scan's."""

import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleList, AngleSteps, parse_angles
from sawmill_formats.input.reading import reading_scan

STEPS = AngleSteps(0.0, 18.0)
VIEWS, ROWS, CELLS = 20, 3, 40
AIR, DARK = 30_000.0, 100.0


@pytest.fixture
def counts():
    """Counts of a shadow with ten flats and darks, as its user has them; noise of the darks is 3 counts."""
    rng = np.random.default_rng(20261122)
    through = np.where(np.abs(np.arange(CELLS) - 20) < 8, np.exp(-3.0), 1.0)
    return {
        "projections": rng.poisson(AIR * np.tile(through, (VIEWS, ROWS, 1))) + DARK,
        "flats": rng.poisson(AIR, (10, ROWS, CELLS)) + DARK,
        "darks": rng.normal(DARK, 3.0, (10, ROWS, CELLS)),
    }


def write(file, arrays):
    with file.open("wb") as stream:
        np.savez(stream, **arrays)
    return file


def read(file, *, counts=True, angles=STEPS, window=2**20):
    with reading_scan(file, counts=counts, angles_deg=angles) as scan:
        for _ in scan.blocks(window):
            pass
        return scan


def refused(code, *words, reading=read, **options):
    with pytest.raises(UnreadableScan) as refusal:
        reading(**options)
    assert refusal.value.code == code
    assert "\n" not in str(refusal.value)
    for word in words:
        assert word in str(refusal.value)


class TestAngles:
    @pytest.mark.parametrize("name", ["angles_deg", "angles_rad"])
    @pytest.mark.parametrize(("value", "code"), [(1e308, "out-of-range"), (-2e6, "out-of-range"), (np.nan, "not-fin")])
    def test_beyond_any_turning(self, file, counts, name, value, code):
        angles = np.arange(float(VIEWS))
        angles[4] = value
        write(file, counts | {name: angles})
        with pytest.raises(UnreadableScan, match=r"angle of view 4 is \S+ degrees; .* -1000000 and 1000000") as refusal:
            read(file, angles=None)
        # In radians 1e308 is no number of degrees any more.
        assert refusal.value.code.startswith(code) or (name, value) == ("angles_rad", 1e308)

    @pytest.mark.parametrize("text", ["0:1e308", "1e308:1", "0,-1000001,2"])
    def test_in_a_text(self, text):
        refused("angles-malformed", "between -1000000 and 1000000", reading=parse_angles, text=text)

    def test_by_many_steps(self, file, counts):
        refused("out-of-range", "view 2 is 1.8e+06", file=write(file, counts), angles=AngleSteps(0.0, 9e5 + 1.0))

    def test_all_equal(self, file, counts):
        angles = AngleList((5.0,) * VIEWS)
        refused("angles-repeated", "views 0 and 1 have the same", file=write(file, counts), angles=angles)

    def test_many_turns_are_as_good_as_one(self, file, counts):
        """At the largest angles double precision leaves 1e-10 degrees."""
        turned = 360.0 * 2_700.0 + np.arange(VIEWS) * 18.0
        angles = read(write(file, counts | {"angles_deg": turned}), angles=None).angles_rad
        np.testing.assert_allclose(np.exp(1j * angles), np.exp(1j * np.deg2rad(turned - 360.0 * 2_700.0)), atol=1e-10)


class TestCounts:
    def test_all_zero(self, file, counts):
        zero = np.zeros_like(counts["projections"])
        refused("no-signal", "all 2400 counts of the scan are 0", file=write(file, counts | {"projections": zero}))

    @pytest.mark.parametrize("window", [2**20, 0])
    @pytest.mark.parametrize(("change", "value"), [(np.negative, "-"), (lambda a: a * 1e30, "e+34 counts")])
    def test_negative_or_beyond_any_detector(self, file, counts, change, value, window):
        write(file, counts | {"projections": change(counts["projections"])})
        words = ("view 0, row 0, cell 0 is", value, "between -1", "at most 20%", "flat fields of 30")
        refused("out-of-range", *words, file=file, window=window)

    @pytest.mark.parametrize("value", [0.0, -5.0, 1e13, 1e30])
    def test_flats_of_no_beam(self, file, counts, value):
        write(file, counts | {"flats": np.full((10, ROWS, CELLS), value)})
        refused("out-of-range", f"median of the flat fields is {value:g} counts", "1e-06 and 1e+12", file=file)

    def test_darks_far_below_zero(self, file, counts):
        write(file, counts | {"darks": counts["darks"] - 1e7})
        refused("out-of-range", "dark 0, row 0, cell 0 is -9", "at least", "of 1200 samples", file=file)

    def test_cells_at_fault_are_no_fault_of_the_scan(self, file, counts):
        """Dead, wildly negative and stuck cells in the fifth that can be bridged; and a marker of bad pixels."""
        counts["projections"][..., :4] = -1e5
        counts["projections"][..., 4:6] = 3.4e38
        counts["projections"][..., 6:8] = 0.0
        assert read(write(file, counts)).shape == (VIEWS, ROWS, CELLS)

    def test_noise_below_zero_where_the_dark_was_taken_off(self, file, counts):
        """Nothing comes through, and the noise of the dark, 3 counts, is half of the time negative."""
        shadow = np.random.default_rng(1).normal(0.0, 3.0, counts["projections"].shape)
        shadow[..., :2] = AIR
        assert read(write(file, {"projections": shadow, "flats": counts["flats"] - DARK})).shape[0] == VIEWS

    def test_transmissions_are_counts_beside_flats_of_1(self, file, counts):
        read(write(file, {"projections": counts["projections"] / AIR, "flats": np.ones((1, ROWS, CELLS))}))

    def test_darks_of_zero_are_remarked(self, file, counts):
        remarks = read(write(file, counts | {"darks": np.zeros((1, ROWS, CELLS))})).remarks
        assert "All dark fields are 0: the detector's offset was taken as zero." in remarks


class TestLineIntegrals:
    @pytest.mark.parametrize("value", [1e30, -1e30, 1.1e6])
    def test_a_single_one_that_no_unit_explains(self, file, value):
        stack = np.ones((VIEWS, ROWS, CELLS))
        stack[7, 2, 5] = value
        words = (f"view 7, row 2, cell 5 is {value:g}; it must lie between -1e+06 and 1e+06",)
        refused("out-of-range", *words, file=write(file, {"projections": stack}), counts=False)

    def test_the_published_scans_are_read(self, published_data):
        """In mm of wood, up to 160, and down to -6.3 in the noise of the air."""
        scan = read(published_data / "log-phantom" / "sinogram.npy", counts=False, angles=AngleSteps(0.5, 1.0))
        assert scan.shape == (360, 1, 768)


class TestPitch:
    @pytest.mark.parametrize("value", [-0.0015, 1e308, np.inf, 1e-300])
    def test_sizes_of_no_cell(self, nxtomo, value):
        def set_size(entry):
            entry["instrument/detector/x_pixel_size"][()] = value

        words = ("x_pixel_size is", "between 1e-06 and 1000 mm", "leave it out")
        refused("out-of-range", *words, file=nxtomo(set_size), angles=None)

    @pytest.mark.parametrize("value", [0.0, np.nan])
    def test_sizes_that_a_file_does_not_know(self, nxtomo, value):
        def set_size(entry):
            entry["instrument/detector/x_pixel_size"][()] = value

        scan = read(nxtomo(set_size), angles=None)
        assert scan.detector_pitch_mm is None
        assert f"x_pixel_size was ignored: it is {value:g} mm, which states no distance." in scan.remarks[-1]
