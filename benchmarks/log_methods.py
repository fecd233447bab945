"""The methods of benchmarks/log_table.py, each with its best known settings: ours as a user gets them, and rivals.

Each takes a scan and chooses its settings, or takes settings that it chose before and is only timed.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import astra_rivals
import numpy as np
from log_scans import LogScan
from scanners import SCANNER
from scans import TRUE_THETA
from whole_logs import Rows

from sawmill_calibration import Scan, reconstruct
from sawmill_calibration.reconstruction.reconstruct import SLICES_AROUND
from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import mean_along_rays, typical_attenuation
from sawmill_tomography.reconstruction.iterative.cross_validation import parabola_minimum
from sawmill_tomography.reconstruction.iterative.descent import Floats
from sawmill_tomography.reconstruction.total_variation import total_variation

# Candidates for the truth-tuned weight, times the wood's attenuation, and those around the best of them.
WEIGHTS, NEAR_WEIGHTS = np.geomspace(3.0, 60.0, 5), np.geomspace(0.6, 1.0 / 0.6, 5)
# Tolerance of the reference descent: a fiftieth of our method's.
CONVERGED = 1e-4
# Candidates for the cut-off of the filter, as a share of the Nyquist frequency.
CUT_OFFS = (0.15, 0.2, 0.3, 0.4, 0.55, 0.75, 1.0)
Settings = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The images of some rows, and their price.

    Attributes
    ----------
    images : (rows, size, size) float32
        Images of all rows, or of the judged ones.
    cpu_s, wall_s : float
        Seconds a slice, by processors and by the clock, the settings being chosen.
    choosing_cpu_s : float
        Processor seconds once a log; 0 where the truth chose, or where the settings were given.
    settings : mapping of str to float
        Chosen or tuned settings.
    judged_only : bool
        True if the images are of the judged rows alone.
    """

    images: Rows
    cpu_s: float
    wall_s: float
    choosing_cpu_s: float = 0.0
    settings: Settings = field(default_factory=dict)
    judged_only: bool = False


# Takes a scan, and settings of an earlier outcome; None: they are to be chosen.
Method = Callable[[LogScan, Settings | None], Outcome]


def _timed(work: Callable[[], Rows]) -> tuple[Rows, float, float]:
    """Return the work's rows, and the seconds of processors and of the clock, a slice."""
    cpu, wall = time.process_time(), time.perf_counter()
    found = work()
    return found, (time.process_time() - cpu) / len(found), (time.perf_counter() - wall) / len(found)


def reconstruct_rows(scan: LogScan, lines: Rows, **options: object) -> tuple[Rows, ReconstructionResult]:
    """Reconstruct some rows of a scan, as the job, the command line and Python users do it."""
    grid = scan.projector.grid
    given = Scan.from_arrays(lines.transpose(1, 0, 2), scan.projector.geometry.angles_rad, SCANNER)
    made = reconstruct(given, TRUE_THETA, size=grid.size, field_mm=grid.field_mm, **options)
    return made.volume, made.result


def ours(method: str, open_settings: tuple[str, ...] = (), *, judged_only: bool = False, **options: object) -> Method:
    """Return our method: its settings chosen as for the whole log, then the price of a slice with these settings.

    A choice is of the middle row, of a coupling also of the rows around it; so these rows are all that is
    reconstructed to learn it. Tikhonov has no choice for a log: each slice chooses.
    """
    chosen_from = SLICES_AROUND if "coupling" in open_settings else 1

    def choice(scan: LogScan) -> tuple[Settings, float, int]:
        """Choose the settings; return them, seconds of processors, and the number of slices."""
        found: list[ReconstructionResult] = []
        first = max(len(scan.lines) // 2 - chosen_from // 2, 0)
        lines = scan.lines[first : first + chosen_from]

        def work() -> Rows:
            data, result = reconstruct_rows(scan, lines, method=method, **options)
            found.append(result)
            return data

        _, cpu, _ = _timed(work)
        report = found[0].method
        assert report is not None
        return {name: float(getattr(report, name) or 0.0) for name in open_settings}, cpu, len(lines)

    def run(scan: LogScan, settings: Settings | None) -> Outcome:
        chooses = bool(open_settings) and settings is None
        chosen, dear, slices = choice(scan) if chooses else (settings or {}, 0.0, 0)
        lines = scan.lines[scan.judged] if judged_only else scan.lines
        images, cpu, wall = _timed(lambda: reconstruct_rows(scan, lines, method=method, **{**options, **chosen})[0])
        return Outcome(images, cpu, wall, slices * max(dear - cpu, 0.0), chosen, judged_only)

    return run


def astra_rival(algorithm: str) -> Method:
    """Return ASTRA's method for the judged rows alone, its number of iterations chosen by the truth."""

    def run(scan: LogScan, settings: Settings | None) -> Outcome:
        judged = scan.judged
        stops = astra_rivals.STOPS[algorithm] if settings is None else (int(settings["iterations"]),)
        found = astra_rivals.tuned(algorithm, scan.projector, scan.lines[judged], scan.truth[judged], stops)
        return Outcome(
            found.images, found.cpu_s, found.wall_s, settings={"iterations": found.iterations}, judged_only=True
        )

    return run


def tuned_fbp(scan: LogScan, settings: Settings | None) -> Outcome:
    """Return FBP with its cut-off frequency chosen by the truth of the judged rows, the image clipped at 0."""
    judged = scan.judged

    def image(lines: Rows, cut_off: float) -> Rows:
        data, _ = reconstruct_rows(scan, lines, method="fbp", frequency_scaling=cut_off)
        return np.maximum(data, 0.0)

    def cut_off() -> float:
        return min(CUT_OFFS, key=lambda share: scan.error(image(scan.lines[judged], share), judged))

    chosen = {"frequency_scaling": cut_off()} if settings is None else settings
    images, cpu, wall = _timed(lambda: image(scan.lines, chosen["frequency_scaling"]))
    return Outcome(images, cpu, wall, settings=chosen)


def _wood(scan: LogScan) -> float:
    return float(np.median(typical_attenuation(mean_along_rays(scan.projector, scan.lines[scan.judged]))))


def _in_the_plane(scan: LogScan, lines: Rows, weight: float) -> Rows:
    return total_variation(scan.projector, lines, weight=weight, tolerance=CONVERGED).image


def _weight_in_the_plane(scan: LogScan) -> float:
    """Search for the best weight for the judged rows."""
    judged, lines = scan.judged, scan.lines[scan.judged]

    def best(weights: Floats) -> float:
        errors = [scan.error(_in_the_plane(scan, lines, weight), judged) for weight in weights]
        return parabola_minimum(weights, np.log(errors))[0]

    return best(best(WEIGHTS / _wood(scan)) * NEAR_WEIGHTS)


def tuned_in_the_plane(scan: LogScan, settings: Settings | None) -> Outcome:
    """Run total variation of each slice alone, converged; one weight for the log, by the truth of the judged rows."""
    chosen = {"weight": _weight_in_the_plane(scan)} if settings is None else settings
    found, cpu, wall = _timed(lambda: _in_the_plane(scan, scan.lines, chosen["weight"]))
    return Outcome(found, cpu, wall, settings=chosen)


METHODS: dict[str, Method] = {
    "FBP": ours("fbp"),
    "FBP, tuned": tuned_fbp,
    "CGLS, tuned": astra_rival("CGLS"),
    "SIRT, tuned": astra_rival("SIRT"),
    "Tikhonov": ours("tikhonov", judged_only=True),
    "Cauchy MAP": ours("cauchy_map", ("sigma", "beta"), judged_only=True),
    "total variation": ours("total_variation", ("weight",), coupling="none"),
    "total variation, coupled": ours("total_variation", ("weight", "coupling"), coupling="auto"),
    "ring-aware": ours("ring_tv", ("weight", "ring_weight"), coupling="none"),
    "ring-aware, coupled": ours("ring_tv", ("weight", "ring_weight", "coupling"), coupling="auto"),
    "2-D total variation, tuned": tuned_in_the_plane,
}
