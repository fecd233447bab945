"""The simulated mill: exact where nothing is wrong, and each effect changes what it should and nothing else."""

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from sawmill_tomography.geometry.geometry import TAU, FloatArray, GeometryError, Scanner, rotate
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError
from sawmill_tomography.physics.body import stand
from sawmill_tomography.physics.simulate import FIELDS, RAYS, MillScan, simulate_physics
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary.physics import BeamEffects, DetectorEffects, MotionEffects, Physics, WoodEffects

SCANNER = Scanner(859.46, 256, 4.5)
WOOD = RECTANGLE_WITH_HOLE.of_density(0.01).moved(4.0, -7.0)
ANGLES = (np.arange(24) + 0.5) * TAU / 24


@pytest.fixture
def scan(theta):
    frame = theta.source_frame(SCANNER.source_to_cor_mm)

    def make(phantom: Phantom = WOOD, angles: FloatArray = ANGLES, seed: int = 3, **effects: Any) -> MillScan:
        return simulate_physics(phantom, SCANNER, frame, angles, Physics(**effects), seed=seed)

    return make


@pytest.mark.parametrize("phantom", [L_SHAPE, RECTANGLE_WITH_HOLE], ids=lambda body: body.name)
def test_nothing_wrong_is_the_mean_of_the_exact_intensities(scan, phantom):
    wood = phantom.of_density(0.01).moved(5.0, -3.0)
    made = scan(wood)
    cells = DetectorCells.of(SCANNER)
    fine = DetectorCells(cells.first_border_mm, cells.width_mm / RAYS, cells.count * RAYS)
    chords = analytic.project(wood, fine, made.frame, ANGLES, rays_per_cell=1)
    np.testing.assert_allclose(
        made.signal, np.exp(-chords).reshape(24, 256, RAYS).mean(axis=2), rtol=0.0, atol=1e-11
    )  # rounding; two ways to the same chords


CHANGES = {
    "energies": ({"beam": BeamEffects(energy_spread=0.3)}, "signal"),
    "scatter": ({"beam": BeamEffects(scatter_share=0.1)}, "signal"),
    "focal spot": ({"beam": BeamEffects(focal_blur_mm=1.0)}, "signal"),
    "drift": ({"beam": BeamEffects(drift_share=0.02)}, "signal"),
    "flicker": ({"beam": BeamEffects(flicker_share=0.02)}, "signal"),
    "beam past the end": ({"beam": BeamEffects(past_end_share=0.1)}, "signal"),
    "thin row": ({"beam": BeamEffects(row_share=0.1)}, "flats"),
    "blur": ({"detector": DetectorEffects(blur_mm=1.0)}, "signal"),
    "glare": ({"detector": DetectorEffects(glare_share=0.1)}, "signal"),
    "lag": ({"detector": DetectorEffects(lag_share=0.05)}, "signal"),
    "slope": ({"detector": DetectorEffects(slope_share=0.02)}, "signal"),
    "curvature": ({"detector": DetectorEffects(curvature_share=0.02)}, "signal"),
    "gains": ({"detector": DetectorEffects(gain_spread=0.03)}, "flats"),
    "dead": ({"detector": DetectorEffects(dead_cells=4)}, "counts"),
    "hot": ({"detector": DetectorEffects(hot_cells=4)}, "counts"),
    "12 bits": ({"detector": DetectorEffects(bits=12)}, "flats darks"),
    "saturation": ({"detector": DetectorEffects(air_of_full_scale=1.05)}, "flats darks"),
    "slip": ({"motion": MotionEffects(slip_mm=1.0)}, "signal motion"),
    "turn": ({"motion": MotionEffects(slip_turn_deg=1.0)}, "signal motion"),
    "wobble": ({"motion": MotionEffects(wobble_once_mm=1.0)}, "signal motion"),
    "wobble twice": ({"motion": MotionEffects(wobble_twice_mm=1.0)}, "signal motion"),
    "creep": ({"motion": MotionEffects(creep_mm=1.0)}, "signal motion"),
    "encoder": ({"motion": MotionEffects(encoder_deg=0.5)}, "signal motion"),
    "jitter": ({"motion": MotionEffects(angle_jitter_deg=0.5)}, "signal motion"),
    "pace": ({"motion": MotionEffects(pace_percent=0.5)}, "signal motion"),
    "exposure": ({"motion": MotionEffects(exposure_steps=1.0)}, "signal"),
    "size": ({"wood": WoodEffects(size_percent=0.2)}, "signal wood"),
    "aspect": ({"wood": WoodEffects(aspect_percent=0.3)}, "signal wood"),
    "shear": ({"wood": WoodEffects(shear_percent=0.3)}, "signal wood"),
    "tilted plane": ({"wood": WoodEffects(plane_tilt_deg=4.0)}, "signal wood"),
    "corners": ({"wood": WoodEffects(corner_radius_mm=5.0)}, "signal wood"),
    "roughness": ({"wood": WoodEffects(roughness_mm=0.3)}, "signal wood"),
    "rings": ({"wood": WoodEffects(ring_contrast=0.2)}, "signal grain"),
    "knots": ({"wood": WoodEffects(knots=2)}, "signal grain"),
    "density slope": ({"wood": WoodEffects(density_slope_percent=3.0)}, "signal density"),
    "screws": ({"wood": WoodEffects(screws=2)}, "signal metal"),
}


def _parts(made: MillScan) -> dict[str, Any]:
    moved = (made.motion.angles_rad, made.motion.turn_rad, made.motion.offset_mm, made.motion.hall_mm)
    return {
        "signal": made.signal,
        "flats": made.flats,
        "darks": made.darks,
        "motion": np.concatenate([part.ravel() for part in moved]),
        "wood": np.concatenate([made.body.wood.edges.ravel(), made.body.wood.discs.ravel()]),
        "grain": made.body.grain,
        "metal": made.body.metal,
        "density": made.body.slope_per_mm,
    }


@pytest.mark.parametrize("name", CHANGES)
def test_each_effect_changes_what_it_should_and_only_that(scan, name):
    """The photons' noise comes from one stream, which brighter or darker views use up differently: fields aside."""
    effects, changed = CHANGES[name]
    before, after = _parts(scan()), _parts(scan(**effects))
    differ = {part for part in before if not np.array_equal(before[part], after[part])}
    of_noise = {"flats", "darks"} if "signal" in changed else {"darks"} if "flats" in changed else set()
    assert set(changed.split()) - {"counts"} <= differ <= set(changed.split()) | of_noise
    assert not np.array_equal(scan().counts, scan(**effects).counts)


def test_every_effect_is_tried_above():
    """A new field of the physics needs its line in CHANGES."""
    groups = [group for effects, _ in CHANGES.values() for group in effects.values()]
    tried = {
        field for group in groups for field, value in vars(group).items() if value != getattr(type(group)(), field)
    }
    of_another = {name for group in vars(Physics()).values() for name in vars(group) if name.endswith(OF_ANOTHER)}
    assert tried | of_another == {name for group in vars(Physics()).values() for name in vars(group)}


OF_ANOTHER = (
    *("_towards_deg", "_phase_deg", "_width_mm", "slip_at"),
    *("ring_spacing_mm", "knot_contrast", "screw_diameter_mm", "steel_per_mm"),
)


def test_a_seed_is_a_scan_and_rows_of_a_stack_share_wood_and_motion_and_have_noise_of_their_own(scan, theta):
    effects = {"wood": WoodEffects(knots=2, roughness_mm=0.2), "detector": DetectorEffects(gain_spread=0.03)}
    one, same, other = scan(**effects), scan(**effects), scan(**effects, seed=4)
    for part in ("counts", "flats", "darks"):
        np.testing.assert_array_equal(getattr(one, part), getattr(same, part))
        assert not np.array_equal(getattr(one, part), getattr(other, part))
    effects = Physics(wood=WoodEffects(knots=2), motion=MotionEffects(angle_jitter_deg=0.1))
    frame = theta.source_frame(SCANNER.source_to_cor_mm)
    one, two = (simulate_physics(WOOD, SCANNER, frame, ANGLES, effects, seed=3, row=row) for row in (0, 1))
    np.testing.assert_array_equal(one.signal, two.signal)
    assert not np.array_equal(one.counts, two.counts)


def test_counts_are_photons_with_their_noise(scan):
    """Of 24 views in air the mean is 30 000 and the variance as large, with 5 counts of the electronics; 1 of 5000."""
    made = scan()
    air = made.counts[:, -20:].astype(np.float64) - 200.0
    assert made.counts.dtype == np.uint16
    assert made.flats.shape == made.darks.shape == (FIELDS, 256)
    assert air.mean() == pytest.approx(30_000.0, abs=4.0 * np.sqrt(30_000.0 / air.size))
    assert air.var() == pytest.approx(30_025.0, rel=4.0 * np.sqrt(2.0 / air.size))


def test_a_slip_is_another_place_from_a_view_on(scan):
    slipped = scan(motion=MotionEffects(slip_mm=2.0, slip_towards_deg=90.0, slip_turn_deg=3.0, slip_at=0.5))
    after = WOOD.rotated(np.deg2rad(3.0)).moved(0.0, 2.0)
    assert slipped.motion.slip_view == 12
    np.testing.assert_array_equal(slipped.signal[:12], scan().signal[:12])
    np.testing.assert_allclose(slipped.signal[12:], scan(after).signal[12:], atol=1e-11)


def test_a_wobble_is_in_the_hall(scan):
    """In each view the phantom stands aside by the amplitude times the cosine, along the same line of the hall."""
    made = scan(motion=MotionEffects(wobble_twice_mm=0.7, wobble_towards_deg=30.0, wobble_phase_deg=20.0))
    for view in (0, 7):
        swing = 0.7 * np.cos(2.0 * (ANGLES[view] - np.deg2rad(20.0)))
        x, y = rotate(ANGLES[view] + made.frame.psi_rad + np.deg2rad(30.0), swing, 0.0)
        there = scan(WOOD.moved(float(x), float(y)), ANGLES[view : view + 1])
        np.testing.assert_allclose(made.signal[view], there.signal[0], atol=1e-11)


def test_an_eccentric_encoder_and_a_wrong_pace_are_other_angles(scan):
    made = scan(motion=MotionEffects(encoder_deg=0.5, encoder_phase_deg=40.0, pace_percent=0.2))
    true = ANGLES + 0.002 * (ANGLES - ANGLES[0]) + np.deg2rad(0.5) * np.cos(ANGLES - np.deg2rad(40.0))
    np.testing.assert_allclose(made.signal, scan(angles=true).signal, atol=1e-11)


def test_an_exposure_is_the_mean_of_the_views_in_it(scan):
    """Of 41 sharp views within a step; 32 rays a cell for 41 times 8 leave 0.02 at a cell of an edge."""
    angles = ANGLES[:4]
    made = scan(angles=angles, motion=MotionEffects(exposure_steps=0.2))
    times = 0.2 * (angles[1] - angles[0]) * ((np.arange(41) + 0.5) / 41 - 0.5)
    expected = np.mean([scan(angles=angles + time).signal for time in times], axis=0)
    np.testing.assert_allclose(made.signal, expected, atol=0.02)
    assert made.signal.mean() == pytest.approx(expected.mean(), abs=2e-4)


@pytest.mark.parametrize("kind", ["detector", "beam"])
def test_blur_is_a_gaussian_on_the_detector(scan, kind):
    """The spot's image is 4 mm wide for the centre alone: by a fifth more or less at the phantom's corners."""
    effects = (
        {"detector": DetectorEffects(blur_mm=4.0)} if kind == "detector" else {"beam": BeamEffects(focal_blur_mm=4.0)}
    )
    made = scan(**effects)
    fine = DetectorCells(-576.0, 4.5 / RAYS, 256 * RAYS)
    sharp = np.exp(-analytic.project(WOOD, fine, made.frame, ANGLES, rays_per_cell=1))
    soft = gaussian_filter1d(sharp, 4.0 / fine.width_mm, axis=1).reshape(24, 256, RAYS).mean(axis=2)
    largest, share = (0.02, 0.1) if kind == "detector" else (0.08, 0.35)
    np.testing.assert_allclose(made.signal, soft, atol=largest)
    assert np.sqrt(np.mean((made.signal - soft) ** 2)) < share * np.sqrt(np.mean((scan().signal - soft) ** 2))


def test_scatter_comes_from_the_wood_and_glare_from_the_light(scan):
    """Scatter brightens the air beside the shadow, glare darkens it and spares an empty beam; both fill the shadow."""
    clean = scan().signal
    scattered = scan(beam=BeamEffects(scatter_share=0.1)).signal
    glaring = scan(detector=DetectorEffects(glare_share=0.1)).signal
    shadow, beside = clean < 0.15, np.zeros_like(clean, bool)
    beside[:, 1:-1] = (clean == 1.0)[:, 1:-1] & ((clean[:, 2:] < 1.0) | (clean[:, :-2] < 1.0))
    assert (scattered[beside] > 1.0).all()
    assert (glaring[beside] < 1.0).all()
    assert (scattered[shadow] > clean[shadow]).all()
    assert glaring[shadow].mean() > clean[shadow].mean()


def test_lag_is_the_view_before_and_slope_and_curvature_are_gains_since_the_flat_fields(scan):
    clean, late = scan().signal, scan(detector=DetectorEffects(lag_share=0.05)).signal
    np.testing.assert_allclose(late[1:], 0.95 * clean[1:] + 0.05 * late[:-1], rtol=1e-12)
    np.testing.assert_allclose(late[0], clean[0], rtol=1e-12)
    place = np.linspace(-1.0, 1.0, 256)
    made = scan(detector=DetectorEffects(slope_share=0.02, curvature_share=0.01)).signal
    expected = 1.0 + 0.01 * place + 0.01 * (1.0 / 3.0 - place**2)
    np.testing.assert_allclose(made / scan().signal, np.tile(expected, (24, 1)), rtol=1e-12)


@pytest.mark.parametrize(("bits", "largest"), [(12, 4095), (16, 65535)])
def test_saturated_air_stands_at_the_converters_largest_value(scan, bits, largest):
    made = scan(detector=DetectorEffects(bits=bits, air_of_full_scale=1.1))
    assert (made.counts[:, -20:] == largest).all()
    assert (made.flats == largest).all()
    assert made.counts[made.signal < 0.5].max() < largest


def test_twelve_bits_are_coarse_and_not_saturated_and_dead_cells_show_their_dark_level(scan):
    made = scan(detector=DetectorEffects(bits=12))
    assert 0.75 * 4095 < made.flats.mean() < 0.85 * 4095
    assert made.counts.max() < 4095
    made = scan(detector=DetectorEffects(dead_cells=3))
    assert np.count_nonzero((made.counts == 200).all(axis=0)) == 3
    assert (made.flats.mean(axis=0) > 29_000).all()


def test_the_affine_change_of_the_wood():
    """x longer and y shorter by half the aspect; a plane tilted by 60 degrees doubles one direction; hole and all."""
    rng = np.random.default_rng(1)
    body = stand(WOOD, WoodEffects(size_percent=1.0, aspect_percent=2.0), rng)
    corners, drawn = np.array(body.wood.shapes[0].vertices_mm), np.array(WOOD.shapes[0].vertices_mm)
    np.testing.assert_allclose(corners, drawn * [1.01 * 1.01, 1.01 * 0.99])
    assert body.wood.shapes[1].area_mm2 == pytest.approx(WOOD.shapes[1].area_mm2 * 1.01**2 * 1.01 * 0.99, rel=1e-4)
    tilted = stand(WOOD, WoodEffects(plane_tilt_deg=60.0, plane_tilt_towards_deg=90.0), rng).wood
    np.testing.assert_allclose(np.array(tilted.shapes[0].vertices_mm), drawn * [1.0, 2.0])


def test_rounded_corners_and_rough_sides_keep_the_boards_size():
    """An arc of radius r takes (1 - pi / 4) r^2 of each of the four corners; rough sides have their mean in place."""
    rng = np.random.default_rng(2)
    whole = WOOD.shapes[0].area_mm2
    worn = stand(WOOD, WoodEffects(corner_radius_mm=8.0), rng).wood.shapes[0]
    assert whole - worn.area_mm2 == pytest.approx(4.0 * (1.0 - np.pi / 4.0) * 64.0, rel=0.02)  # twelve chords an arc
    rough = stand(WOOD, WoodEffects(roughness_mm=0.3), rng).wood.shapes[0]
    assert rough.area_mm2 == pytest.approx(whole, rel=2e-3)
    depths = np.array(rough.vertices_mm)[1:60, 1] - WOOD.shapes[0].vertices_mm[0][1]
    assert 0.15 < depths.std() < 0.45  # some ten independent depths a side


def test_nails_stand_in_a_log():
    body = stand(Phantom("log", (Disc((0.0, 0.0), 130.0, 0.018),)), WoodEffects(screws=3), np.random.default_rng(0))
    assert (np.hypot(body.metal[:, 0], body.metal[:, 1]) < 120.0).all()


def test_what_cannot_be_is_refused(scan, theta):
    with pytest.raises(GeometryError, match="touches the source"):
        scan(WOOD.scaled(6.0))
    with pytest.raises(GeometryError, match="do not fit 16 bits: 60000 in all"):
        simulate_physics(WOOD, SCANNER, theta.source_frame(859.46), ANGLES, photons=70_000.0, seed=1)
    with pytest.raises(PhantomError, match="no place for a knot or a screw"):
        stand(Phantom("stick", (Disc((0.0, 0.0), 5.0),)), WoodEffects(knots=1), np.random.default_rng(0))
