"""The inner products of a view's derivatives are those of the forward model, whatever effects it has."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from tests.support.exact_chords import Detector, full_turn
from tests.support.exact_chords import scan as scan_of

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.joint_fit.effects import harmonics, in_the_laboratory
from sawmill_tomography.calibration.joint_fit.modules import FEWEST_CELLS, ModuleSearch, with_modules
from sawmill_tomography.calibration.joint_fit.normal_equations import WIDER, Column, ViewGrams
from sawmill_tomography.calibration.joint_fit.sample_noise import sample_noise
from sawmill_tomography.calibration.joint_fit.scan_model import WARPS, ScanModel, Series, Term, is_of_patch, term_of
from sawmill_tomography.calibration.joint_fit.selection import EffectTester
from sawmill_tomography.calibration.joint_fit.wood_patches import wood_patches
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import nearest_rays
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection._analytic_numba import project
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import DetectorModule

FRAME = SourceFrame(2.5, 917.0, 1620.0, -9.0, -0.083)
OF_THE_BEAM = {Term.SCATTER: 0.02, Term.SCATTER_WIDE: 0.03, Term.LAG: 0.04}
EFFECTS = {
    Term.HARDENING: -1e-3,
    Term.HARDENING_CUBIC: 1e-6,
    Term.GRADIENT_X: 1e-3,
    Term.GRADIENT_Y: -2e-3,
    Term.ASPECT: 0.01,
    Term.SHEAR: 0.003,
    Term.CORNERS: 4.0,
    Term.BLUR: 1.3,
    Term.EXPOSURE: 0.7,
    Term.SLOPE: 0.01,
    Term.CURVATURE: 0.02,
    Term.BOW_X: 0.7,
    Term.BOW_Y: -0.4,
    Term.TAPER_X: 0.3,
    Term.TAPER_Y: -0.6,
    Term.THIN_SKIN: 0.1,
    Term.THICK_SKIN: -0.05,
    term_of(Series.PATCH, 3): 0.2,
    term_of(Series.PATCH, 40): -0.1,
}


def scan(*, counts, effects, views=21, phantom=L_SHAPE):
    """A model and noisy data that it does not quite explain; the pose changes from view to view."""
    rng = np.random.default_rng(2801)
    cells, angles = DetectorCells(-300.0, 9.0, 70), np.sort(rng.uniform(0.0, 6.0, views))
    sinogram = 0.01 * analytic.project(phantom, cells, FRAME, angles, position_mm=(1.0, -2.0))
    sinogram += 0.01 * rng.standard_normal(70) + 0.02 * rng.standard_normal(sinogram.shape)
    weights = (rng.random(sinogram.shape) > 0.1).astype(np.float64)
    data = SinogramData(sinogram, angles, cells, weights=weights if effects else None)
    sizes = {**EFFECTS, **(OF_THE_BEAM if counts else {})} if effects else {}
    x, pose = np.concatenate([to_vector(FRAME), [1.0, -2.0]]), 1e-3 * rng.standard_normal((views, 3))
    return ScanModel(phantom, data, counts, x, np.full((views, 1), 0.01), np.full((views, 1), 0.001), pose, sizes)


def patches(model):
    """The bodies that the wood's patches are, deformed and bent as the model's wood is."""
    bow, taper = (tuple(map(model.size, terms)) for terms in (WARPS[:2], WARPS[2:]))
    for shapes in wood_patches(model.drawing):
        deformed = replace(model.drawing, shapes=shapes).deformed(model.size(Term.ASPECT), model.size(Term.SHEAR))
        yield deformed.warped(bow, taper, model.drawing.radius_mm)


def turned(model, angle):
    return replace(model, data=replace(model.data, angles_rad=model.data.angles_rad + angle))


def of_line_integrals(model):
    """Derivatives of the line integrals before exposure by the terms before the corners, (terms, views, cells)."""
    raw, length, size = model.deformations, model.deformations[7], model.size
    chain = model.gain * (1.0 + 2.0 * size(Term.HARDENING) * length + 3.0 * size(Term.HARDENING_CUBIC) * length**2)
    of_pose, of_shape = raw[:7] * chain, raw[10:12] * chain
    of_level = (model.sharp - model.offset) / model.gain, np.ones_like(length)
    return np.stack([*of_pose, *of_level, *(model.gain * [length**2, length**3, *raw[8:10]]), *of_shape])


def derivatives(model):
    """Of the prediction by every term and every patch's density, in whole arrays: (terms, views, cells).

    What patches of other densities change in the derivatives by other terms is left out.
    """
    uniform = replace(model, sizes={term: size for term, size in model.sizes.items() if not is_of_patch(term)})
    length, size = uniform.deformations[7], model.size
    chain = model.gain * (1.0 + 2.0 * size(Term.HARDENING) * length + 3.0 * size(Term.HARDENING_CUBIC) * length**2)
    across = np.broadcast_to(model.across, length.shape)
    of_corners = (model.corner_edges, np.empty((0, 4)), *model.kernel_arguments[2:])
    by_corners = np.empty_like(length)
    project(*of_corners, by_corners)
    m, padded = model.blurred, np.pad(model.blurred, ((0, 0), (1, 1)), mode="edge")
    first, second = 0.5 * (padded[:, 2:] - padded[:, :-2]), 0.5 * (padded[:, 2:] - 2.0 * m + padded[:, :-2])
    turns = [(turned(uniform, angle), weight) for angle, weight in model.turns_while_exposed]
    shares = [weight * (np.exp(-one.sharp) if model.from_counts else 1.0) for one, weight in turns]
    rows = [
        *(sum(share * of_line_integrals(one) for (one, _), share in zip(turns, shares, strict=True)) / sum(shares)),
        by_corners * chain,
        second - 0.5 * first**2 if model.from_counts else second,
        model.exposure,
        across,
        across**2,
        *(np.zeros((3, *length.shape))),
        *model.by_wood,
        *(chain * model.project(body) for body in patches(model)),
    ]
    intensity = np.exp(-model.exposed) if model.from_counts else np.ones_like(length)
    if model.taps.size:
        soft = correlate1d(intensity, model.taps, axis=1)
        blurred = set(range(len(rows))) - {Term.OFFSET, Term.BLUR} - set(range(Term.SLOPE, len(Term)))
        for term in blurred:
            rows[term] = correlate1d(rows[term] * intensity, model.taps, axis=1) / soft
    if model.from_counts:
        rows[: Term.SLOPE] = [row / (1.0 + model.added) for row in rows[: Term.SLOPE]]
        rows[len(Term) :] = [row / (1.0 + model.added) for row in rows[len(Term) :]]
        rows[Term.SCATTER : Term.BOW_X] = [-row / (1.0 + model.added) for row in (*model.halos, model.lagging)]
    return np.stack(rows)


@pytest.mark.parametrize("counts", [False, True])
def test_an_exposure_is_the_mean_over_its_turn(counts):
    model = replace(scan(counts=counts, effects=False), sizes={Term.EXPOSURE: 0.7, Term.HARDENING: -1e-3})

    def exposed(square):
        half = 0.5 * np.sqrt(square) * model.step_rad
        lines = np.stack([turned(model, half * at).sharp for at in np.linspace(-1.0, 1.0, 401)[1::2]])
        return -np.log(np.exp(-lines).mean(axis=0)) if counts else lines.mean(axis=0)

    # Points a cell apart where edges are fastest: 0.5 % of the deepest shadow, where an edge lies along the rays.
    assert np.abs(model.exposed - exposed(0.7)).max() < 0.005 * model.exposed.max()
    slope = (exposed(0.75) - exposed(0.65)) / 0.1
    assert np.linalg.norm(model.exposure - slope) < 0.05 * np.linalg.norm(slope)


@pytest.mark.slow
def test_views_exposed_over_most_of_their_steps_give_the_rays():
    """With two points for an exposure, and from 60 views on only, the rays were 0.4 mm off."""
    detector, angles, rng = Detector(640, 1.26), full_turn(16), np.random.default_rng(16)
    turn = 0.9 * angles[1] * ((np.arange(80) + 0.5) / 80 - 0.5)
    shapes = RECTANGLE_WITH_HOLE.moved(8.0, -9.0).of_density(0.004).shapes
    seen = np.mean([scan_of(shapes, detector, FRAME, angles + part, rays=3) for part in turn], axis=0)
    lines = -np.log(seen) + 0.005 * rng.standard_normal(seen.shape)
    scanner = Scanner(FRAME.source_distance_mm, detector.cells, detector.pitch_mm)
    found = calibrate(CalibrationTask(scanner, RECTANGLE_WITH_HOLE, lines, angles, from_counts=True))
    off = nearest_rays(detector.points(FRAME, 1)[:, 0], FRAME, found.scanner, found.frame).rms_mm
    assert off < found.findings.error_bars.predicted_ray_error.upper_95_mm < 0.1
    assert "rotation-during-exposure" in {code for each in found.adjustments for code in each.codes}


@pytest.mark.parametrize("counts", [False, True])
@pytest.mark.parametrize("effects", [False, True])
@pytest.mark.parametrize("phantom", [L_SHAPE, RECTANGLE_WITH_HOLE])
def test_inner_products_are_those_of_whole_arrays(counts, effects, phantom):
    model = scan(counts=counts, effects=effects, phantom=phantom)
    grams, rows = ViewGrams(model, of_wood=True, of_patches=True), derivatives(model)
    weighted = rows * grams.weights
    rest = model.residual - (0.0 if grams.log_bias is None else grams.log_bias) - grams.stripes
    # By Cauchy and Schwarz: products that are small by cancellation keep the rounding of their terms.
    norm = np.sqrt(np.einsum("tkm,tkm->kt", weighted, rows)) + 1e-300
    expected = np.einsum("pkm,qkm->kpq", weighted, rows)
    assert (np.abs(grams.grams - expected) <= 1e-12 * norm[:, :, None] * norm[:, None]).all()
    score, power = np.einsum("tkm,km->kt", weighted, rest), (grams.weights * rest**2).sum(axis=1)
    assert (np.abs(grams.scores - score) <= 1e-12 * norm * np.sqrt(power)[:, None]).all()
    across_views = np.cos(model.data.angles_rad)
    columns = [*(Column.of(term) for term in Term), Column(((Term.T_X, across_views), (Term.T_Y, -across_views)))]
    sums = weighted.sum(axis=1)
    sums = np.concatenate([sums[: len(Term)], [across_views @ (weighted[Term.T_X] - weighted[Term.T_Y])]])
    moves = (rows[Term.T_X] - rows[Term.T_Y]) * across_views[:, None]
    every = np.concatenate([rows[: len(Term)], moves[None]])
    normal = np.einsum("pkm,km,qkm->pq", every, grams.weights, every) - (sums * grams.stripe_shares) @ sums.T
    size = np.sqrt(np.einsum("pkm,km,pkm->p", every, grams.weights, every)) + 1e-300
    found = ViewGrams(model, of_wood=True).system(columns).normal
    assert (np.abs(found - normal) <= 1e-12 * np.outer(size, size)).all()


def test_the_densities_of_patches_are_eliminated_with_their_prior():
    """As one large system of equations with all densities, whose prior adds to the diagonal, and whose mean is 1."""
    model = scan(counts=False, effects=True)
    columns = [Column.of(term) for term in (Term.R, Term.U_C, Term.T_X, Term.GAIN)]
    grams, rows = ViewGrams(model, of_patches=True), derivatives(model)
    own = [*(column.term for column in columns), *range(len(Term), len(rows))]
    weighted = rows[own] * grams.weights
    sums, rest = weighted.sum(axis=1), model.residual - grams.stripes
    normal = np.einsum("pkm,qkm->pq", weighted, rows[own]) - (sums * grams.stripe_shares) @ sums.T
    score, number = np.einsum("pkm,km->p", weighted, rest), len(columns)
    variation = grams.vary_densities(columns)
    noise = grams.power - score @ np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ score
    precision = noise / (grams.samples - len(own)) / (WIDER * variation.deviation) ** 2
    densities = np.array([model.size(term) for term in model.patch_terms])
    prior = precision * np.eye(len(densities)) + np.trace(normal[number:, number:])
    normal[number:, number:] += prior
    score[number:] -= prior @ densities
    system, best = grams.system(columns), np.linalg.solve(normal, score)
    change = system.inverse(range(number)) @ system.score
    _, found = system.with_patches(change)
    assert np.abs(found - best).max() < 1e-6 * np.abs(best).max()
    assert abs((densities + found[number:]).mean()) < 1e-3 * np.abs(densities + found[number:]).max()
    assert np.allclose(system.inverse(range(number)), np.linalg.inv(normal)[:number, :number], rtol=1e-6)
    power = grams.power + densities @ prior @ densities
    assert system.remaining(range(number)) == pytest.approx(power - score @ best, rel=1e-6)


@pytest.mark.parametrize("of_patches", [False, True])
def test_the_search_for_modules_finds_what_the_test_of_a_module_at_each_cell_finds(of_patches):
    """Gains of the views are projected out, and the pose changes from view to view."""
    model = scan(counts=False, effects=False)

    def system_of(at):
        grams = ViewGrams(at, of_patches=of_patches)
        grams.project_out([Term.GAIN, Term.OFFSET], 0.0)
        base = [Column.of(term) for term in Term if term < Term.GAIN]
        base += in_the_laboratory(at, harmonics(at, 1))
        if of_patches:
            grams.vary_densities(base)
        modules = [Column.of(term) for term in at.module_terms]
        return grams, grams.system([*base, *modules]), list(range(len(base)))

    def power(cell):
        _, system, base = system_of(with_modules(model, [DetectorModule(cell)]))
        tester = EffectTester(system, base)
        return max(tester.tested([len(base) + kind]).power for kind in range(2))

    grams, system, base = system_of(model)
    (found,) = ModuleSearch(model, grams, system, base, ()).likeliest(0.0, 1)
    cells = range(FEWEST_CELLS, 70 - FEWEST_CELLS + 1)
    # What the gains take of the stripes is counted to first order.
    assert power(found) > 0.5 * max(map(power, cells))


@pytest.mark.parametrize(
    "steps", [[[Term.GAIN, Term.OFFSET]], [[Term.GAIN], [Term.OFFSET]]], ids=["together", "in turn"]
)
@pytest.mark.parametrize("precision", [0.0, 3.0])
def test_unknowns_of_each_view_are_eliminated_from_its_derivatives(steps, precision):
    """The derivatives less what those by the view's gain and offset explain of them, in whole arrays."""
    model = scan(counts=False, effects=False)
    grams, rows = ViewGrams(model), derivatives(model)[[Term.R, Term.U_C, Term.GAIN, Term.OFFSET]]
    weighted, rest, power = rows * grams.weights, model.residual - grams.stripes, grams.power
    of_view = np.einsum("pkm,qkm->kpq", weighted, rows) + np.diag([0.0, 0.0, precision, precision])
    explained = np.linalg.solve(of_view[:, 2:, 2:], of_view[:, 2:, :2])
    left = weighted[:2] - np.einsum("kpq,pkm->qkm", explained, weighted[2:])
    for terms in steps:
        grams.project_out(terms, precision)
    system, sums = grams.system([Column.of(Term.R), Column.of(Term.U_C)]), left.sum(axis=1)
    normal = np.einsum("pkm,qkm->pq", left, rows[:2]) - (sums * grams.stripe_shares) @ sums.T
    np.testing.assert_allclose(system.normal, normal, rtol=1e-9)
    np.testing.assert_allclose(system.score, np.einsum("pkm,km->p", left, rest), rtol=1e-9)
    of_rest = np.einsum("pkm,km->kp", weighted[2:], rest)
    taken = np.einsum("kp,kp->", of_rest, np.linalg.solve(of_view[:, 2:, 2:], of_rest[..., None])[..., 0])
    assert grams.power == pytest.approx(power - taken, rel=1e-9)


@pytest.mark.parametrize(("views", "electronics", "most"), [(12, 0.0, 0.05), (180, 0.5, 0.06)])
def test_samples_weigh_by_photon_noise_and_by_other_noise_that_many_samples_show(views, electronics, most):
    """Eight levels that are each measured alone are 0.065 off (RMS of the logarithm) in 12 views."""
    off = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        half_width = rng.uniform(0.3, 0.5, (views, 1))
        lines = 2.4 * np.sqrt(np.maximum(1.0 - (np.linspace(-1.0, 1.0, 768) / half_width) ** 2, 0.0))
        variance = 1e-4 * np.exp(lines + electronics * np.maximum(lines - 1.2, 0.0))
        data = SinogramData(lines, np.zeros(views), DetectorCells(-1.0, 1.0, 768))
        noise = np.sqrt(variance) * rng.standard_normal(lines.shape)
        off.append(float(np.log(sample_noise(data, noise, lines).weights * variance).std()))
    assert np.mean(off) < most
