"""Generalised least squares at one point of the forward model: inner products of derivatives and residual.

Samples are weighted by their noise. Stripes, which a flat field of few frames leaves in every view alike, are noise
that a cell has in all views: a random effect of each cell (Robinson 1991), estimated and projected out in part. Angles
that scatter from view to view are a random effect too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from sawmill_tomography.calibration.covariance import scaled_inverse, unit_scale
from sawmill_tomography.calibration.joint_fit._derivatives_numba import BLOCK, combined, inner_products, without_shares
from sawmill_tomography.calibration.joint_fit.sample_noise import sample_noise
from sawmill_tomography.calibration.joint_fit.scan_model import OF_WOOD, POSE, ScanModel, Term
from sawmill_tomography.calibration.joint_fit.structure import beyond_chance
from sawmill_tomography.calibration.joint_fit.wood_patches import Variation, variation
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import robust_deviation

# Terms that may change from view to view, or be projected out of each view.
KEPT = (*POSE, Term.GAIN, Term.OFFSET)
# An eigenvalue of normal equations below this share of the largest is zero within rounding.
SINGULAR = 1e-12
# The drawing's precision changes the path of a ray by this multiple.
EDGES = 0.75
# At least this share of the structured residual remains: what a step explains is only known to first order.
UNTRUSTED = 0.1
# Densities of neighbouring patches are often alike. Other effects would explain that beside a prior of independent
# densities, so the prior is wider by this factor (benchmarks/families.py).
WIDER = 3.0
# Offsets of views scatter where their power exceeds noise by this number of standard deviations.
SCATTERS = 4.0

# A cell whose mean differs by more than ODD standard deviations has no information in its mean: the variance that the
# cell shares over the views is set to ALONE, in variances of a sample.
ODD, ALONE = 6.0, 1e6

# A part of a column: a term's derivative, in all views alike or times a shape (views,). Numbers beyond those
# of `Term` are of a `Series`.
Part = tuple[int, FloatArray | None]


@dataclass(frozen=True, eq=False)
class Column:
    """An unknown of the fit: a sum of parts."""

    parts: tuple[Part, ...]

    @classmethod
    def of(cls, term: int) -> "Column":
        """Make a column of a term that is the same in all views."""
        return cls(((term, None),))

    def every(self, step: int) -> "Column":
        """Return the column of every `step`-th view."""
        return Column(tuple((term, None if shape is None else shape[::step]) for term, shape in self.parts))

    @property
    def term(self) -> int | None:
        """The column's term, if it is the same in all views; None for a change of the pose from view to view."""
        (term, shape), *_ = self.parts
        return term if shape is None else None

    @property
    def parameter(self) -> FitParameter | None:
        """The column's parameter in the plain fit; None where the plain fit does not have it."""
        return FitParameter(self.term) if self.term is not None and self.term <= Term.T_Y else None


class ViewGrams:
    """Inner products, view by view, of the derivatives by all terms with each other and with the residual.

    The derivatives by the terms of `OF_WOOD` are among them only if `of_wood` is true, those by the densities of the
    wood's patches only if `of_patches` is.
    """

    def __init__(self, model: ScanModel, *, of_wood: bool = False, of_patches: bool = False) -> None:
        data, residual = model.data, model.residual
        noise = sample_noise(data, residual, model.prediction)
        self.weights = noise.weights
        # The logarithm of noisy counts is too large, in the mean by half the variance of the logarithm.
        self.log_bias = 0.5 * noise.variance if model.from_counts else None
        self.samples = float(data.samples)
        self._count = self.weights.sum(axis=0)
        residual = self._unbiased(residual)
        squares, products = self._squares(residual)
        self._stripes(squares, products)
        self.power = self.objective_at_model = squares - float(self.stripes @ products)
        views, cells = residual.shape
        by_column, by_wood = model.detector_rows, model.by_wood if of_wood else np.empty((0, views, cells))
        patch_edges, patches = model.patch_edges if of_patches else (np.empty((0, 5)), np.zeros(1, np.intp))
        further = (*model.detector_terms, *(OF_WOOD if of_wood else ()), *(model.patch_terms if of_patches else ()))
        rows = OF_WOOD[0] + len(further)
        self._rows = {term: OF_WOOD[0] + number for number, term in enumerate(further)}
        self.grams, self.scores = np.zeros((views, rows, rows)), np.zeros((views, rows))
        # The weighted derivatives of `KEPT` (kept, views, cells), and how much of these was taken out of each term's.
        # The last of the weighted derivatives is the one by u_c.
        weighted, self._taken = np.empty((len(KEPT) + 1, views, cells)), np.zeros((rows, len(KEPT), views))
        sums, neighbours = np.zeros((-(-views // BLOCK), rows, cells)), np.empty((views, 2))
        of_column = np.zeros((len(sums), rows + 1, cells))
        inner_products(
            model.kernel_arguments,
            model.data.angles_rad + model.pose[:, 0] + np.array([[turn] for turn, _ in model.turns_while_exposed]),
            np.array([weight for _, weight in model.turns_while_exposed]),
            model.exposure,
            model.corner_edges,
            model.gain.ravel(),
            np.array([model.size(term) for term in Term]),
            model.exposed,
            model.blurred,
            model.taps,
            (*model.halos, model.lagging, model.added) if model.from_counts else (np.empty((0, cells)),) * 4,
            self.weights,
            residual,
            self.stripes,
            np.array([*KEPT, Term.U_C]),
            by_column,
            by_wood,
            patch_edges,
            patches,
            (self.grams, self.scores, sums, of_column, weighted, neighbours),
        )
        self._weighted, self._by_column = weighted[:-1], weighted[-1]
        self._sums, self._of_column = sums.sum(axis=0), of_column.sum(axis=0)
        self._patches = tuple(map(Column.of, model.patch_terms)) if of_patches else ()
        self._densities = np.array([model.size(term) for term in model.patch_terms]) if of_patches else np.empty(0)
        self._density_precision, self._summed = 0.0, dict[Column, FloatArray]()
        # The inner products before anything is projected out, the terms that are, and the precision (views, terms,
        # terms) by which their prior draws them back, by (views, terms).
        self._whole, self._projected = (self.grams, self.scores), list[Term]()
        self._precision, self._pull = np.zeros((views, 0, 0)), np.zeros((views, 0))
        count = views * (cells - 1)
        mean, square = (neighbours.sum(axis=0) / count).tolist()
        deviation = math.sqrt(max(square - mean * mean, 0.0))
        # What a drawing that is off by its precision leaves, of each ray at two edges that it crosses at an angle. In
        # less noise, all that is left may be the steps of a drawing, which neighbouring cells need not share.
        off = EDGES * float(model.gain.mean()) * model.drawing.precision_mm
        self.of_drawing = off * off * float(self.weights[model.lengths > 0.0].sum())
        shared = beyond_chance(mean, deviation, count) * count
        self.structured = self.power if self.power <= self.of_drawing else shared
        self.correlation = mean * math.sqrt(count) / deviation if deviation > 0.0 else 0.0

    def _unbiased(self, residual: FloatArray) -> FloatArray:
        return residual if self.log_bias is None else residual - self.log_bias

    def _squares(self, residual: FloatArray) -> tuple[float, FloatArray]:
        """Compute the weighted sum of squares of a residual, and each cell's weighted sum (cells,)."""
        weighted = self.weights * residual
        return float(np.vdot(weighted, residual)), weighted.sum(axis=0)

    def _stripes(self, squares: float, products: FloatArray) -> None:
        """Estimate the stripes (cells,) beyond noise, and the stripes' share of each cell's sum."""
        seen = self._count > 0.0
        count = np.where(seen, self._count, 1.0)
        mean = products / count
        both = seen[1:] & seen[:-1]
        steps = np.diff(mean)[both]
        variance = squares / max(self.samples, 1.0)
        ratio = 0.0
        if steps.size > 8 and variance > 0.0:
            # The typical step is between cells of the air, which have less noise than the mean cell.
            noise = 0.5 * float(np.median((1.0 / count[1:] + 1.0 / count[:-1])[both]))
            ratio = max(0.5 * robust_deviation(steps - np.median(steps)) ** 2 / variance - noise, 0.0)
        ratios = np.full(count.size, ratio)
        if steps.size > 8 and variance > 0.0:
            expected = np.sqrt(variance * (ratio + 1.0 / count))
            ratios[np.abs(mean - np.median(mean[seen])) > ODD * expected] = ALONE
        self.stripe_shares = np.where(seen, ratios / (1.0 + ratios * count), 0.0)
        self.stripes = self.stripe_shares * count * mean

    def gain_evidence(self) -> tuple[float, float]:
        """Compute the power that a gain and offset of each view would explain, and the number of views that show it."""
        own = [Term.GAIN, Term.OFFSET]
        grams, scores = self.grams[:, own][:, :, own], self.scores[:, own]
        inverse = np.linalg.pinv(grams, rcond=1e-9, hermitian=True)
        return float(np.einsum("ki,kij,kj->", scores, inverse, scores)), float((grams[:, 0, 0] > 0.0).sum())

    def offset_variance(self) -> tuple[float, float]:
        """Estimate the variance of the views' offsets beyond noise, as from air levels, and a sample's variance.

        The estimate is by the method of moments (Robinson 1991); 0 where noise explains the offsets.
        """
        variance = self.power / max(self.samples, 1.0)
        own, scores = self.grams[:, Term.OFFSET, Term.OFFSET], self.scores[:, Term.OFFSET]
        excess = float((scores**2 - own * variance).sum())
        chance = SCATTERS * variance * math.sqrt(2.0 * float((own**2).sum()))
        return (excess / float((own**2).sum()) if excess > chance else 0.0), variance

    def project_out(self, terms: Sequence[Term], precision: float | FloatArray, at: FloatArray | None = None) -> None:
        """Project out unknowns of each view: terms that are free in each view (precision 0), or scatter about 0.

        `precision` is the variance of a sample divided by the variance of the unknowns, or times the inverse of their
        covariance in each view, (views, terms, terms). `at` (views, terms): the unknowns in the model.
        """
        own, before = list(terms), len(self._projected)
        precisions = np.broadcast_to(
            precision * np.eye(len(own)) if isinstance(precision, float) else precision,
            (len(self.scores), len(own), len(own)),
        )
        at = np.zeros((len(self.scores), len(own))) if at is None else at
        pull = (precisions @ at[..., None])[..., 0]
        self._projected += own
        both = np.zeros((len(self.scores), len(self._projected), len(self._projected)))
        both[:, :before, :before], both[:, before:, before:] = self._precision, precisions
        self._precision, self._pull = both, np.concatenate([self._pull, pull], axis=1)
        within = self.grams[:, own][:, :, own] + precisions
        inverse = np.linalg.pinv(within, rcond=SINGULAR, hermitian=True)
        share = self.grams[:, :, own] @ inverse
        score = self.scores[:, own] - pull
        self.power += float(np.einsum("ki,ki->", at, pull)) - float(np.einsum("ki,kij,kj->", score, inverse, score))
        rows = np.array([[float(kept is term) for kept in KEPT] for term in terms])
        self._taken = self._taken + np.einsum("kto,oek->tek", share, rows[..., None] - self._taken[own])
        self.scores = self.scores - (share @ score[..., None])[..., 0]
        self.grams = without_shares(self.grams, np.array(own), share)
        self._summed = {}

    def objective(self, residual: FloatArray) -> float:
        """Compute the objective of generalised least squares for another residual, without views' random effects."""
        squares, products = self._squares(self._unbiased(residual))
        return squares - float((self.stripe_shares * products) @ products)

    def of_columns(
        self,
        columns: Sequence[Column],
        left: FloatArray | None = None,
        at: FloatArray | None = None,
        patches: "Patches | None" = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Compute each view's inner products of these columns (views, d, d), and with the residual (views, d).

        With `left` (columns, d) of these combinations of the columns, and with `at` (columns,) where the columns have
        these sizes less. With `patches` of what the densities leave.
        """
        left = np.eye(len(columns)) if left is None else left
        both = left if at is None else np.column_stack([left, at])
        own = np.flatnonzero(both.any(axis=1)).tolist()
        parts = [(self._rows.get(term, term), shape, number) for number in own for term, shape in columns[number].parts]
        rows = sorted({row for row, _, _ in parts})
        place = {row: n for n, row in enumerate(rows)}
        densities = 0 if patches is None else len(patches.change)
        weights = np.zeros((len(self.scores), len(rows) + densities, both.shape[1]))
        for row, shape, number in parts:
            weights[:, place[row]] += both[number] if shape is None else shape[:, None] * both[number]
        if patches is not None:
            weights[:, len(rows) :] -= patches.taken @ both
        point = np.zeros(weights.shape[:2]) if at is None else weights[..., -1].copy()
        if patches is not None:
            point[:, len(rows) :] -= patches.change
            rows += range(self.scores.shape[1] - densities, self.scores.shape[1])
        of_left = np.ascontiguousarray(np.swapaxes(weights[..., : left.shape[1]], 1, 2))
        products, scores = combined(self.grams, self.scores, np.array(rows), of_left, point)
        return products, scores

    def vary_densities(self, columns: Sequence[Column]) -> Variation:
        """Estimate the variation of the patches' densities next to these columns; they are eliminated from now on."""
        whole = self._system([*columns, *self._patches])
        fixed, patches = list(range(len(columns))), slice(len(columns), None)
        taken = whole.normal[patches, fixed] @ whole.inverse(fixed)
        normal = whole.normal[patches, patches] - taken @ whole.normal[fixed, patches]
        score = whole.score[patches] - taken @ whole.score[fixed] + normal @ self._densities
        # Where the patches are hardly distinguished, what they explain together is uncertain.
        noise = max(whole.variance(fixed) - whole.structured / whole.samples, whole.variance(range(len(whole.columns))))
        found = variation(normal, score, noise)
        self._density_precision = noise / (WIDER * found.deviation) ** 2
        return found

    def by_cell(self, columns: Sequence[Column]) -> "CellProducts":
        """Compute each cell's part of the inner products of the derivative by u_c, without the part of the stripes."""
        if not self._density_precision:
            return self._by_cell(columns)
        number, products = len(columns), self._by_cell([*columns, *self._patches])
        of_columns, of_patches = products.with_columns[:number], products.with_columns[number:]
        whole = self._system([*columns, *self._patches])
        inverse, score = self._densities_alone(whole)
        values, vectors = np.linalg.eigh(inverse)
        taken = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ of_patches
        return replace(
            products,
            with_columns=of_columns - whole.normal[:number, number:] @ inverse @ of_patches,
            score=products.score - inverse @ score @ of_patches,
            taken=np.concatenate([products.taken, taken]),
            by_stripes=np.concatenate([products.by_stripes, np.zeros_like(taken)]),
        )

    def _by_cell(self, columns: Sequence[Column]) -> "CellProducts":
        of_stripes, sums = self.stripe_shares * self._sums[Term.U_C], self._sums_of(columns)
        of_kept = cache(self._of_kept)
        with_columns = np.zeros((len(columns), self._count.size))
        for number, column in enumerate(columns):
            for term, shape in column.parts:
                row = self._rows.get(term, term)
                with_columns[number] += self._of_column[row] if shape is None else shape @ of_kept(Term(term))
        with_columns -= of_stripes * sums
        own = self._of_column[Term.U_C] - of_stripes * self._sums[Term.U_C]
        score = self._of_column[-1]
        taken = by_stripes = np.empty((0, own.size))
        if self._projected:
            terms = self._projected
            grams, scores = self._whole
            within = grams[:, terms][:, :, terms] + self._precision
            values, vectors = np.linalg.eigh(within)
            kept = values > SINGULAR * values[:, -1:]
            root = np.swapaxes(vectors * np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)[:, None], 1, 2)
            taken = (root @ np.stack([of_kept(term) for term in terms], 1)).reshape(-1, own.size)
            weighted = root @ np.stack([self._weighted[KEPT.index(term)] for term in terms], 1)
            by_stripes = (weighted * of_stripes).reshape(-1, own.size)
            of_columns = root @ self._with_terms(columns, terms) - (weighted * self.stripe_shares) @ sums.T
            with_columns -= of_columns.reshape(-1, len(columns)).T @ taken
            score = score - (root @ (scores[:, terms] - self._pull)[..., None]).ravel() @ taken
        return CellProducts(with_columns, own, score, taken, by_stripes)

    def _of_kept(self, term: Term) -> FloatArray:
        """Return the weighted products (views, cells) of the derivatives by u_c and by a term of `KEPT`."""
        weights = np.where(self.weights > 0.0, self.weights, 1.0)
        return np.asarray(self._by_column * self._weighted[KEPT.index(term)] / weights)

    def _with_terms(self, columns: Sequence[Column], terms: Sequence[Term]) -> FloatArray:
        """Return the inner products (views, terms, columns) of terms and columns before anything is projected out."""
        grams = self._whole[0][:, list(terms)]
        products = np.zeros((*grams.shape[:2], len(columns)))
        for number, column in enumerate(columns):
            for term, shape in column.parts:
                of_term = grams[:, :, self._rows.get(term, term)]
                products[:, :, number] += of_term if shape is None else shape[:, None] * of_term
        return products

    def of_each_view(
        self, columns: Sequence[Column], terms: Sequence[Term]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the best change of unknowns of each view that are projected out, and what other columns change in it.

        The change (views, terms) is for columns that do not change. It is less by the second array (views, terms,
        columns) times their change; its covariance is the third (views, terms, terms) times a sample's variance.
        """
        every, own = self._projected, [self._projected.index(term) for term in terms]
        grams, scores = self._whole
        inverse = np.linalg.pinv(grams[:, every][:, :, every] + self._precision, rcond=SINGULAR, hermitian=True)[:, own]
        change = (inverse @ (scores[:, every] - self._pull)[..., None])[..., 0]
        return change, inverse @ self._with_terms(columns, every), np.asarray(inverse[:, :, own], np.float64)

    def scatter(self, columns: Sequence[Column], patches: "Patches | None") -> FloatArray:
        """Return the part (n, n) of the columns' normal equations by the scatter of random effects; the rest is noise.

        A random effect with precision L, of which `taken` compensates the columns, scatters it by taken' L taken.
        """
        every, left, densities = [*columns], np.eye(len(columns)), np.zeros((0, len(columns)))
        if patches is not None:
            every, left, densities = [*every, *self._patches], np.concatenate([left, -patches.taken]), patches.taken
        sums, taken = left.T @ self._sums_of(every), self.of_each_view(every, self._projected)[1] @ left
        by_cells = (sums * self.stripe_shares * (1.0 - self.stripe_shares * self._count)) @ sums.T
        by_cells += self._density_precision * densities.T @ densities
        return np.asarray(by_cells + np.einsum("vin,vij,vjm->nm", taken, self._precision, taken, optimize=True))

    def _densities_alone(self, whole: "System") -> tuple[FloatArray, FloatArray]:
        """Return the inverse normal matrix and the score of the densities, the last columns, with their prior."""
        count, precision = len(self._patches), self._density_precision
        normal = whole.normal[-count:, -count:]
        # The mean density is 1: the gain is what it would be.
        precisions = precision * np.eye(count) + float(np.trace(normal)) * np.ones((count, count))
        return scaled_inverse(normal + precisions), whole.score[-count:] - precisions @ self._densities

    def system(self, columns: Sequence[Column]) -> "System":
        """Compute the normal equations of these columns, the densities of patches eliminated (`vary_densities`)."""
        if not self._density_precision:
            return self._system(columns)
        number, whole = len(columns), self._system([*columns, *self._patches])
        inverse, score = self._densities_alone(whole)
        taken, densities = inverse @ whole.normal[number:, :number], inverse @ score
        # The prior's part of the power, which is the score's change by the prior, is none of the residual.
        explained = float(score @ densities) - float(self._densities @ (whole.score[number:] - score))
        return System(
            tuple(columns),
            self,
            whole.score[:number] - score @ taken,
            whole.normal[:number, :number] - whole.normal[:number, number:] @ taken,
            max(whole.power - explained, 0.0),
            max(whole.structured - explained, UNTRUSTED * whole.structured),
            whole.samples,
            Patches(whole, densities, taken, inverse, self._density_precision),
        )

    def _system(self, columns: Sequence[Column]) -> "System":
        score, normal = self._of_all_views(columns)
        if self.stripe_shares.any():
            sums = self._sums_of(columns)
            normal -= (sums * self.stripe_shares) @ sums.T
        return System(tuple(columns), self, score, normal, self.power, self.structured, self.samples)

    def _of_all_views(self, columns: Sequence[Column]) -> tuple[FloatArray, FloatArray]:
        """Compute the sums over the views of the columns' products with the residual (n,), and with each other (n, n).

        Shapes belong to few terms: the products are made term by term.
        """
        views = len(self.scores)
        of_term: dict[int, dict[int, FloatArray | float]] = {}
        for number, column in enumerate(columns):
            for term, shape in column.parts:
                of_term.setdefault(self._rows.get(term, term), {})[number] = 1.0 if shape is None else shape
        score, normal = np.zeros(len(columns)), np.zeros((len(columns), len(columns)))
        alike = {row: [*one] for row, one in of_term.items() if all(isinstance(shape, float) for shape in one.values())}
        same, places = [row for row, own in alike.items() for _ in own], [n for own in alike.values() for n in own]
        sums = self.grams.sum(axis=0)
        normal[np.ix_(places, places)], score[places] = sums[np.ix_(same, same)], self.scores.sum(axis=0)[same]
        every = np.ones(views)
        shaped = [
            (row, [*one], np.array([shape * every for shape in one.values()]))
            for row, one in of_term.items()
            if row not in alike
        ]
        for number, (row, own, shapes) in enumerate(shaped):
            score[own] += shapes @ self.scores[:, row]
            with_same = (shapes @ self.grams[:, row])[:, same]
            normal[np.ix_(own, places)] += with_same
            normal[np.ix_(places, own)] += with_same.T
            for other, others, of_other in shaped[number:]:
                between = (shapes * self.grams[:, row, other]) @ of_other.T
                normal[np.ix_(own, others)] += between
                if other != row:
                    normal[np.ix_(others, own)] += between.T
        return score, normal

    def _sums_of(self, columns: Sequence[Column]) -> FloatArray:
        """Compute the sums (columns, cells) of the weighted columns over the views; those of before are kept."""
        new = [column for column in columns if column not in self._summed]
        self._summed |= zip(new, self._new_sums(new), strict=True)
        return np.array([self._summed[column] for column in columns]).reshape(-1, self._count.size)

    def _new_sums(self, columns: Sequence[Column]) -> FloatArray:
        views = len(self.scores)
        sums, of_kept = np.zeros((len(columns), self._count.size)), np.zeros((len(columns), len(KEPT), views))
        for number, column in enumerate(columns):
            for term, shape in column.parts:
                row = self._rows.get(term, term)
                of_kept[number] -= self._taken[row] if shape is None else shape * self._taken[row]
                if shape is None:
                    sums[number] += self._sums[row]
                else:
                    of_kept[number, KEPT.index(Term(term))] += shape
        for kept, rows in enumerate(self._weighted):
            some = of_kept[:, kept].any(axis=1)
            sums[some] += of_kept[some, kept] @ rows
        return sums


@dataclass(frozen=True, eq=False)
class CellProducts:
    """Inner products of the derivative by u_c in each cell, without what the views' random effects take up."""

    with_columns: FloatArray  # (n, cells): products with n columns
    own: FloatArray  # (cells,): products with itself, and with the residual; `own` with what the random effects take up
    score: FloatArray  # (cells,)
    taken: FloatArray  # (m, cells): what the random effects take up, and its part in the stripes
    by_stripes: FloatArray  # (m, cells)

    def of_shapes(self, shapes: FloatArray) -> FloatArray:
        """Return each cell's part (n, cells) of the products with the derivative times factors (n, cells)."""
        if not (shapes.size and self.taken.size):
            return shapes * self.own
        taken, by_stripes = shapes @ self.taken.T, shapes @ self.by_stripes.T
        return shapes * self.own - (taken - by_stripes) @ self.taken + taken @ self.by_stripes


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of the wood, which are eliminated from a system."""

    whole: "System"  # the system before they are eliminated, whose last columns they are
    change: FloatArray  # (patches,): the best change of the densities where nothing else changes
    taken: FloatArray  # (patches, n): how much less it is for each unit of change of the system's columns
    inverse: FloatArray  # (patches, patches): covariance next to these columns, in variances of a sample
    precision: float  # precision of a density that the prior gives, likewise

    @property
    def log_shrinkage(self) -> float:
        """Logarithm of the determinant of that covariance times the prior's precision (`ViewGrams`)."""
        count = len(self.inverse)
        of_mean = math.log1p(count * float(np.trace(self.whole.normal[-count:, -count:])) / self.precision)
        return float(np.linalg.slogdet(self.inverse)[1]) + count * math.log(self.precision) + of_mean


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations of some columns."""

    columns: tuple[Column, ...]
    source: ViewGrams
    score: FloatArray  # (n,): sums over the views, less the part of the stripes
    normal: FloatArray  # (n, n)
    power: float  # power of the residual
    structured: float  # the part of `power` that neighbouring cells share
    samples: float
    patches: Patches | None = None  # the wood's patches; None where the model has one density
    removed: FloatArray | None = None  # (n,): sizes of columns that the model does not have any more (`without`)

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.source.scores)

    def of_views(self, left: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return each view's inner products of combinations of the columns, and with the residual after a change.

        `left` (n, d), `change` (n,); products (views, d, d), scores (views, d).
        """
        at = -change if self.removed is None else self.removed - change
        return self.source.of_columns(self.columns, left, at, self.patches)

    def with_patches(self, change: FloatArray) -> "tuple[System, FloatArray]":
        """Return the system with the patches' columns, and the change of all: of patches the best next to this one."""
        patches = self.patches
        if patches is None:
            return self, change
        return patches.whole, np.concatenate([change, patches.change - patches.taken @ change])

    def rise(self, change: FloatArray) -> float:
        """Return by how much a step raises the power of the residual, to second order."""
        return float(change @ self.normal @ change - 2.0 * change @ self.score)

    def without(self, places: Sequence[int], sizes: FloatArray) -> "System":
        """Return, to first order, the system of a model without the columns in these places, which have these sizes."""
        own = list(places)
        by, removed = self.normal[:, own] @ sizes, np.zeros(len(self.columns))
        removed[own] = sizes
        power = self.power + float(sizes @ (2.0 * self.score[own] + by[own]))
        return replace(self, score=self.score + by, power=power, removed=removed)

    @cached_property
    def scale(self) -> FloatArray:
        """Scale that makes the diagonal of `normal` one, (n,)."""
        return unit_scale(self.normal)

    def remaining(self, used: Sequence[int]) -> float:
        """Return the power of the residual that a step of some columns leaves."""
        score = self.score[used]
        return max(self.power - float(score @ self.inverse(used) @ score), 0.0)

    def variance(self, used: Sequence[int]) -> float:
        """Return the variance of a sample that a step of some columns leaves."""
        return self.remaining(used) / max(self.samples - len(used), 1.0)

    def inverse(self, used: Sequence[int]) -> FloatArray:
        """Invert the normal matrix of some columns; undetermined directions have no variance."""
        return scaled_inverse(self.normal[np.ix_(used, used)])
