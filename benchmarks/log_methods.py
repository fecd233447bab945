"""The methods of benchmarks/log_table.py, each with its best known settings: ours as a user gets them, and rivals."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import astra_rivals
import numpy as np
from log_scans import LogScan
from scanners import SCANNER
from scans import TRUE_THETA
from stack_total_variation import StackObjective
from whole_logs import Rows

from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_worker.tomography.iterative.cross_validation import parabola_minimum
from sawmill_worker.tomography.iterative.descent import Floats
from sawmill_worker.tomography.iterative.first_image import mean_along_rays, typical_attenuation
from sawmill_worker.tomography.iterative.support_region import SupportRegion
from sawmill_worker.tomography.total_variation import HALO, total_variation
from sawmill_worker.tomography.total_variation_weights import SMOOTHING_SHARE
from sawmill_worker.use_cases.block_solvers import COUPLED_TOGETHER, FITTED_TOGETHER
from sawmill_worker.use_cases.reconstruct import ReconstructionInput, reconstruct_in_memory
from sawmill_worker.vocabulary import Handedness, Rotation

# Candidates for the truth-tuned weight, times the wood's attenuation, and those around the best of them.
WEIGHTS, NEAR_WEIGHTS = np.geomspace(3.0, 60.0, 5), np.geomspace(0.6, 1.0 / 0.6, 5)
# Of the yardsticks: a thirtieth of what ours ends with; enough iterations from each slice's own minimum.
CONVERGED, STACK_ITERATIONS = 1e-4, 80
# Candidates for the cut-off of the filter, as a share of the Nyquist frequency.
CUT_OFFS = (0.15, 0.2, 0.3, 0.4, 0.55, 0.75, 1.0)
# A step of the search for the stack's weights, and the rows on either side of a judged one that it looks at.
WEIGHT_STEP, AXIS_STEP, AROUND = math.sqrt(2.0), 2.0, 3


@dataclass(frozen=True, eq=False)
class Outcome:
    """The images of some rows, and their price.

    Attributes
    ----------
    images : (rows, size, size) float32
        Of all rows, or of the judged ones.
    cpu_s, wall_s : float
        A slice, by processors and by the clock, the settings being chosen.
    choosing_cpu_s : float
        Once a log, by processors.
    settings : mapping of str to float
        As they were chosen or tuned.
    judged_only : bool
        Whether the images are of the judged rows alone.
    block : int
        Rows that were reconstructed side by side: between blocks there may be seams.
    """

    images: Rows
    cpu_s: float
    wall_s: float
    choosing_cpu_s: float = 0.0
    settings: Mapping[str, float] = field(default_factory=dict)
    judged_only: bool = False
    block: int = FITTED_TOGETHER


def _timed(work: Callable[[], Rows]) -> tuple[Rows, float, float]:
    """What it answers, and the seconds of processors and of the clock."""
    cpu, wall = time.process_time(), time.perf_counter()
    found = work()
    return found, time.process_time() - cpu, time.perf_counter() - wall


def _reconstruct(scan: LogScan, **options: object) -> tuple[Rows, ReconstructionResult]:
    """As the job, the command line and Python users do it."""
    grid = scan.projector.grid
    given = ReconstructionInput(
        read=lambda start, stop: np.ascontiguousarray(scan.lines[start:stop].transpose(1, 0, 2)),
        angles_rad=scan.projector.geometry.angles_rad,
        rows=(0, len(scan.lines)),
        scanner=ScannerConstants(**vars(SCANNER)),
        theta=TRUE_THETA,
        rotation=Rotation.AS_GIVEN,
        handedness=Handedness.AS_DRAWN,
        input_sha256="0" * 64,
        counts=False,
    )
    asked = ReconstructionOptions.model_validate({"size": grid.size, "field_mm": grid.field_mm, **options})
    volume = reconstruct_in_memory(given, asked, lambda _: None)
    return volume.data, volume.result


def ours_on_judged_rows(method: str) -> Callable[[LogScan], Outcome]:
    """By its own choice, of the judged rows alone; choosing included."""

    def run(scan: LogScan) -> Outcome:
        lines = scan.lines[scan.judged]
        images, cpu, wall = _timed(lambda: _reconstruct(replace(scan, lines=lines), method=method)[0])
        return Outcome(images, cpu / len(lines), wall / len(lines), judged_only=True)

    return run


def ours(method: str, open_settings: tuple[str, ...] = (), **options: object) -> Callable[[LogScan], Outcome]:
    """By its own choice; then again with the settings that it chose, which is the price of a slice."""

    def run(scan: LogScan) -> Outcome:
        result: list[ReconstructionResult] = []

        def work(**given: object) -> Rows:
            data, found = _reconstruct(scan, method=method, **{**options, **given})
            result.append(found)
            return data

        images, cpu, wall = _timed(work)
        report = result[0].method
        assert report is not None
        settings = {name: float(getattr(report, name) or 0.0) for name in open_settings}
        choosing, rows = 0.0, len(images)
        if settings:
            _, given_cpu, wall = _timed(lambda: work(**settings))
            choosing, cpu = max(cpu - given_cpu, 0.0), given_cpu
        block = COUPLED_TOGETHER - 2 * HALO if settings.get("coupling") else FITTED_TOGETHER
        return Outcome(images, cpu / rows, wall / rows, choosing, settings, block=block)

    return run


def astra_rival(algorithm: str) -> Callable[[LogScan], Outcome]:
    """Of the judged rows alone; the number of iterations by the truth."""

    def run(scan: LogScan) -> Outcome:
        judged = scan.judged
        found = astra_rivals.tuned(algorithm, scan.projector, scan.lines[judged], scan.truth[judged])
        return Outcome(
            found.images, found.cpu_s, found.wall_s, settings={"iterations": found.iterations}, judged_only=True
        )

    return run


def tuned_fbp(scan: LogScan) -> Outcome:
    """Its cut-off frequency chosen by the truth, the image clipped at 0."""

    def image(cut_off: float) -> Rows:
        data, _ = _reconstruct(scan, method="fbp", frequency_scaling=cut_off)
        return np.maximum(data, 0.0)

    cut_off = min(CUT_OFFS, key=lambda share: scan.error(image(share)[scan.judged], scan.judged))
    images, cpu, wall = _timed(lambda: image(cut_off))
    return Outcome(images, cpu / len(images), wall / len(images), settings={"frequency_scaling": cut_off})


def _wood(scan: LogScan) -> float:
    return float(np.median(typical_attenuation(mean_along_rays(scan.projector, scan.lines[scan.judged]))))


@lru_cache(maxsize=1)  # the stack's search starts from it
def tuned_in_the_plane(scan: LogScan) -> Outcome:
    """Total variation of each slice alone, converged; one weight for the log, by the truth of the judged rows."""
    judged, projector, wood = scan.judged, scan.projector, _wood(scan)

    def images(lines: Rows, weight: float) -> Rows:
        return total_variation(projector, lines, weight=weight, tolerance=CONVERGED).image

    def best(weights: Floats) -> float:
        errors = [scan.error(images(scan.lines[judged], weight), judged) for weight in weights]
        return parabola_minimum(weights, np.log(errors))[0]

    weight = best(best(WEIGHTS / wood) * NEAR_WEIGHTS)
    found, cpu, wall = _timed(lambda: images(scan.lines, weight))
    return Outcome(found, cpu / len(found), wall / len(found), settings={"weight": weight})


def tuned_along_the_axis(scan: LogScan) -> Outcome:
    """Isotropic total variation of the stack; weight and axis chosen by the truth of the rows around a judged one.

    The search starts at the weight that is best in the plane, and goes on to the best neighbour as long as it improves.
    """
    if len(scan.lines) == 1:
        return tuned_in_the_plane(scan)
    in_plane = tuned_in_the_plane(scan)
    first = max(scan.judged[0] - AROUND, 0)
    rows = list(range(len(scan.lines)))[first : first + 2 * AROUND + 1]
    smoothing, kept = SMOOTHING_SHARE * _wood(scan), rows[1:-1]
    support = SupportRegion.of(scan.projector, scan.lines)

    def minimum(of: list[int], weight: float, axis: float) -> Rows:
        objective = StackObjective(support.projector, scan.lines[of], weight, axis, smoothing)
        return support.embedded(objective.minimum(in_plane.images[of][:, *support.part], STACK_ITERATIONS))

    def weights(step: tuple[int, int]) -> tuple[float, float]:
        return in_plane.settings["weight"] * WEIGHT_STEP ** step[0], AXIS_STEP ** step[1]

    def error(step: tuple[int, int]) -> float:
        return scan.error(minimum(rows, *weights(step))[1:-1], kept)

    weight, axis = weights(lowest_neighbour(error, (-1, 0)))
    every = list(range(len(scan.lines)))
    images, cpu, wall = _timed(lambda: minimum(every, weight, axis))
    cpu, wall = cpu / len(images) + in_plane.cpu_s, wall / len(images) + in_plane.wall_s
    return Outcome(images, cpu, wall, settings={"weight": weight, "axis": axis})


def lowest_neighbour(error: Callable[[tuple[int, int]], float], start: tuple[int, int]) -> tuple[int, int]:
    """Where no neighbour of four is lower."""
    cached, at = cache(error), start
    while True:
        best = min((at, *((at[0] + i, at[1] + j) for i, j in ((0, -1), (0, 1), (-1, 0), (1, 0)))), key=cached)
        if best == at:
            return at
        at = best


METHODS: dict[str, Callable[[LogScan], Outcome]] = {
    "FBP": ours("fbp"),
    "FBP, tuned": tuned_fbp,
    "CGLS, tuned": astra_rival("CGLS"),
    "SIRT, tuned": astra_rival("SIRT"),
    "Tikhonov": ours_on_judged_rows("tikhonov"),
    "Cauchy MAP": ours_on_judged_rows("cauchy_map"),
    "total variation": ours("total_variation", ("weight",), coupling="none"),
    "total variation, coupled": ours("total_variation", ("weight", "coupling"), coupling="auto"),
    "2-D total variation, tuned": tuned_in_the_plane,
    "3-D total variation, tuned": tuned_along_the_axis,
}
