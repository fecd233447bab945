"""The tables of docs/understand/measured.md: calibration, drift and reconstruction on the measured discs.

    make measured
    python benchmarks/measured.py [--only PART ...] [--processes N]

The discs are those that `measured_discs.py` reads. No truth is known: COR and tilt are compared with an independent
fit of the whole turn, distances with the laboratory's. Prints the tables and writes
benchmarks/results/measured-PART.json.
"""

import argparse
import math
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import TypeVar

import numpy as np
from measured_discs import OUTLINE_WIDTH_MM, SCANNER, SOLID, VIEWS, Disc, discs_folder, nominal_frame, read_discs
from measurement import Measurement
from numpy.typing import NDArray
from paper.conduct import one_thread
from PIL import Image
from rich.progress import track
from scipy.ndimage import binary_erosion
from skimage.filters import threshold_otsu

import sawmill_calibration as sawmill
from sawmill_tomography.geometry.ray_error import ray_error

Answer = TypeVar("Answer")
Values = Mapping[str, str | float | Mapping[str, float]]
FloatImage = NDArray[np.float32]

CALIBRATED_VIEWS = (90, 18)
DRIFT_VIEWS = (8, 9, 18, 20, 30, 45, 60, 90, 120, 180, 360, 720)
MOST_STARTS = 3
IMAGE_VIEWS = (20, 45, 90, 360, 720)
METHODS = ("fbp", "tikhonov", "total_variation", "cauchy_map")
# The Cauchy MAP takes minutes with more views, and is no better than total variation.
MOST_CAUCHY_VIEWS = 90
SIZE = 256
# Around the axis: no disc reaches farther.
DISC_RADIUS_MM = 37.0
# Where cupping is measured, of discs of 35 mm.
MIDDLE_MM, RIM_MM = (0.0, 10.0), (25.0, 32.0)
PIXELS_MM = (np.arange(SIZE) - (SIZE - 1) / 2) * OUTLINE_WIDTH_MM / SIZE
RADIUS_MM = np.hypot(*np.meshgrid(PIXELS_MM, PIXELS_MM))
# Verdicts promise these.
ALLOWED_RAYS_MM, ALLOWED_SCALE_PERCENT = 0.1, 0.5


@dataclass(frozen=True)
class Calibrated:
    """A calibration against the outline, and how far it is from what is known of the scan.

    Where it was refused, `verdict` is the code of the refusal.
    """

    disc: str
    views: int
    verdict: str
    ray_error_mm: float = math.nan
    bound_mm: float = math.nan
    scale_off_percent: float = math.nan
    scale_bound_percent: float = math.nan
    cor_off_mm: float = math.nan
    cor_sd_mm: float = math.nan
    tilt_off_deg: float = math.nan
    tilt_sd_deg: float = math.nan
    hardening: bool = False

    @property
    def answered(self) -> bool:
        """True if there is a geometry."""
        return not math.isnan(self.ray_error_mm)

    @property
    def wrong(self) -> bool:
        """True if the calibration passed and does not hold what a pass promises."""
        return self.verdict == "pass" and (
            self.ray_error_mm > ALLOWED_RAYS_MM or self.scale_off_percent > ALLOWED_SCALE_PERCENT
        )


@dataclass(frozen=True)
class Checked:
    """A drift check: by how much its COR is off and the standard deviation that it states, mm; NaN where refused."""

    disc: str
    views: int
    cor_off_mm: float = math.nan
    sd_mm: float = math.nan
    known_sd_mm: float = math.nan

    @property
    def answered(self) -> bool:
        """True if the check was not refused."""
        return not math.isnan(self.cor_off_mm)

    @property
    def within(self) -> bool:
        """True if the 95 % interval holds the independent COR, whose own error counts too."""
        return abs(self.cor_off_mm) <= 1.96 * math.hypot(self.sd_mm, self.known_sd_mm)


@dataclass(frozen=True)
class Drawn:
    """A reconstruction: its error against FBP of all views, and Matthews' correlation with the outline."""

    disc: str
    views: int
    method: str
    error: float
    correlation: float


def calibrated(disc: Disc, views: int) -> Calibrated:
    """Calibrate a disc from some views of the turn, the outline as the phantom's picture."""
    try:
        found = sawmill.calibrate(disc.scan(views), disc.outline, phantom_width_mm=OUTLINE_WIDTH_MM)
    except sawmill.InputError as error:
        return Calibrated(disc.name, views, error.code)
    frame, bound, deviation = found.source_frame, found.predicted_ray_error_mm, found.result.standard_deviation
    assert bound is not None
    assert deviation is not None
    off = ray_error(SCANNER, disc.frame, frame, radius_mm=bound.radius_mm)
    return Calibrated(
        disc.name,
        views,
        found.verdict,
        ray_error_mm=off.rms_mm,
        bound_mm=bound.upper_95,
        scale_off_percent=100.0 * abs(off.scale_change),
        scale_bound_percent=found.scale_uncertainty_percent,
        cor_off_mm=frame.cor_column_mm - disc.independent.cor_column_mm,
        cor_sd_mm=deviation.source_frame.cor_column_mm,
        tilt_off_deg=math.degrees(frame.tilt_rad) - disc.independent.tilt_deg,
        tilt_sd_deg=math.degrees(deviation.source_frame.tilt_rad),
        hardening=any("hardening" in effect for effect in found.result.adjustments),
    )


def starts(disc: Disc, views: int) -> list[int]:
    """List the views at which subsets of a turn begin: as many as there are, at most three, evenly apart."""
    step = disc.views // views
    return [number * step // min(step, MOST_STARTS) for number in range(min(step, MOST_STARTS))]


def checked(disc: Disc, views: int) -> list[Checked]:
    """Find the COR from the laboratory's distances, with several subsets of the turn."""
    known, checks, nominal = disc.independent, [], nominal_frame().theta(SCANNER.source_to_cor_mm)
    for start in starts(disc, views):
        try:
            found = sawmill.drift(disc.scan(views, start), nominal).result
        except sawmill.InputError:
            checks.append(Checked(disc.name, views))
            continue
        off, deviation = found.measured.cor_column_mm - known.cor_column_mm, found.standard_deviation.cor_column_mm
        checks.append(Checked(disc.name, views, off, deviation, known.cor_column_sd_mm))
    return checks


def image_of(disc: Disc, views: int, method: str) -> FloatImage:
    """Reconstruct (x, y) with the independent geometry, on half as many pixels as the outline has."""
    theta = disc.frame.theta(SCANNER.source_to_cor_mm)
    made = sawmill.reconstruct(disc.scan(views), theta, method=method, size=SIZE, field_mm=OUTLINE_WIDTH_MM)
    return made.image


def acrylic_of(disc: Disc) -> NDArray[np.bool_]:
    """Return the outline's acrylic (x, y) in the pixels of an image."""
    outline = Image.open(disc.outline).convert("L").resize((SIZE, SIZE), Image.Resampling.BOX)
    return np.asarray(outline) > 127


def cupping_percent(phantom: Disc, disc: Disc, hardening: str) -> float:
    """Compute how much darker a disc's middle is than its rim, by FBP with another disc's calibration."""
    views = CALIBRATED_VIEWS[0]
    calibration = sawmill.calibrate(phantom.scan(views), phantom.outline, phantom_width_mm=OUTLINE_WIDTH_MM)
    image = sawmill.reconstruct(
        disc.scan(views), calibration, hardening=hardening, size=SIZE, field_mm=OUTLINE_WIDTH_MM
    ).image
    acrylic = binary_erosion(acrylic_of(disc), iterations=3)
    middle, rim = (image[acrylic & (low < RADIUS_MM) & (high > RADIUS_MM)].mean() for low, high in (MIDDLE_MM, RIM_MM))
    return float(100.0 * (1.0 - middle / rim))


def drawn(disc: Disc, views: int) -> list[Drawn]:
    """Reconstruct from some views with each method, and compare with FBP of all views and with the outline."""
    reference, acrylic = image_of(disc, VIEWS, "fbp"), acrylic_of(disc)
    inside = RADIUS_MM < DISC_RADIUS_MM
    results = []
    for method in METHODS:
        if method == "cauchy_map" and views > MOST_CAUCHY_VIEWS:
            continue
        image = image_of(disc, views, method)
        error = float(np.linalg.norm((image - reference)[inside]) / np.linalg.norm(reference[inside]))
        correlation = float(np.corrcoef([np.ravel(image > threshold_otsu(image)), np.ravel(acrylic)])[0, 1])
        results.append(Drawn(disc.name, views, method, error, correlation))
    return results


def measure(works: Sequence[Callable[[], Answer]], *, processes: int, what: str) -> Iterator[Answer]:
    """Run all works, the first ones first, in some processes with one thread each, and show the progress."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, initializer=one_thread) as pool:
        running = [pool.submit(work) for work in works]
        for future in track(running, description=what):
            yield future.result()


def rms(values: Iterable[float]) -> float:
    """Compute the root mean square."""
    return math.sqrt(np.mean(np.square(list(values))))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)).replace(
        "| --- ", "|---"
    )


def calibration_table(results: Sequence[Calibrated]) -> str:
    """Tabulate the discs, a row each, their numbers of views side by side."""
    of = {(each.disc, each.views): each for each in results}
    head = ["disc"]
    for views in CALIBRATED_VIEWS:
        head += [f"{views} views", "rays off, bound, mm", "scale off, bound"]
    rows = []
    for disc in dict.fromkeys(each.disc for each in results):
        row = [disc]
        for views in CALIBRATED_VIEWS:
            each = of[disc, views]
            if each.answered:
                row += [
                    f"`{each.verdict}`",
                    f"{each.ray_error_mm:.4f}, {each.bound_mm:.3f}",
                    f"{each.scale_off_percent:.2f}, {each.scale_bound_percent:.2f} %",
                ]
            else:
                row += [f"refused, `{each.verdict}`", "", ""]
        rows.append(row)
    return table(head, rows)


def calibration_summary(results: Sequence[Calibrated]) -> str:
    """Tabulate all discs with holes together, a row for each number of views."""
    head = ("", *(f"{views} views" for views in CALIBRATED_VIEWS))
    columns = [calibration_figures([each for each in results if each.views == views]) for views in CALIBRATED_VIEWS]
    return table(head, ([name, *(column[name] for column in columns)] for name in columns[0]))


def calibration_figures(results: Sequence[Calibrated]) -> dict[str, str]:
    """Name what several calibrations come to."""
    answers = [each for each in results if each.answered]
    held = sum(each.ray_error_mm <= each.bound_mm for each in answers)
    rays = [each.ray_error_mm for each in answers]
    return {
        "calibrated": f"{len(answers)} of {len(results)}",
        "`pass`, and of these wrong": f"{sum(each.verdict == 'pass' for each in answers)}, "
        f"{sum(each.wrong for each in answers)}",
        "rays off, median and most": f"{np.median(rays):.4f}, {max(rays):.4f} mm",
        "rays within their bound": f"{held} of {len(answers)}",
        "scale off, median; its bound, median": f"{np.median([each.scale_off_percent for each in answers]):.2f} %; "
        f"{np.median([each.scale_bound_percent for each in answers]):.2f} %",
        "COR off, RMS; stated": f"{rms(each.cor_off_mm for each in answers):.4f} mm; "
        f"{rms(each.cor_sd_mm for each in answers):.4f} mm",
        "tilt off, RMS; stated": f"{rms(each.tilt_off_deg for each in answers):.2f}°; "
        f"{rms(each.tilt_sd_deg for each in answers):.2f}°",
        "hardening found": f"{sum(each.hardening for each in answers)} of {len(answers)}",
    }


def rms_off_mm(results: Iterable[Checked], views: int) -> float:
    """Compute the COR's error, RMS over the checks of a number of views that were answered."""
    return rms(each.cor_off_mm for each in results if each.views == views and each.answered)


def drift_table(results: Sequence[Checked]) -> str:
    """Tabulate the drift checks, a row for each number of views."""
    head = ("views", "checks", "answered", "COR off, RMS", "stated", "within 95 %")
    rows = []
    for views in DRIFT_VIEWS:
        checks = [each for each in results if each.views == views]
        answers = [each for each in checks if each.answered]
        figures = ["", "", ""]
        if answers:
            figures = [
                f"{rms_off_mm(answers, views):.4f} mm",
                f"{rms(each.sd_mm for each in answers):.4f} mm",
                f"{sum(each.within for each in answers)} of {len(answers)}",
            ]
        rows.append([str(views), str(len(checks)), str(len(answers)), *figures])
    return table(head, rows)


def image_table(results: Sequence[Drawn]) -> str:
    """Tabulate the images, a row for each number of views, the mean of the discs for each method."""
    rows = []
    for views in IMAGE_VIEWS:
        row = [str(views)]
        for method in METHODS:
            images = [each for each in results if (each.views, each.method) == (views, method)]
            if not images:
                row.append("")
                continue
            correlation = f"{np.mean([each.correlation for each in images]):.3f}"
            error = f"{np.mean([each.error for each in images]):.3f}"
            row.append(f"0, {correlation}" if (views, method) == (VIEWS, "fbp") else f"{error}, {correlation}")
        rows.append(row)
    return table(("views", *(f"`{method}`" for method in METHODS)), rows)


def calibrations(discs: Sequence[Disc], processes: int) -> Values:
    """Calibrate all discs; those with holes are counted."""
    works = [partial(calibrated, disc, views) for views in CALIBRATED_VIEWS for disc in discs]
    results = list(measure(works, processes=processes, what="Calibrating"))
    holed = [each for each in results if each.disc != SOLID]
    return {
        "discs": len(discs),
        "table": calibration_table(results),
        "summary": calibration_summary(holed),
        "calibrations": len(holed),
        "passed": sum(each.verdict == "pass" for each in holed),
        "wrong": sum(each.wrong for each in holed),
    }


def drift_checks(discs: Sequence[Disc], processes: int) -> Values:
    """Check all discs for drift; the one without holes counts by itself."""
    works = [partial(checked, disc, views) for views in DRIFT_VIEWS for disc in discs if not disc.views % views]
    results = list(chain.from_iterable(measure(works, processes=processes, what="Checking for drift")))
    solid, holed = ([each for each in results if (each.disc == SOLID) is of] for of in (True, False))
    return {
        "table": drift_table(holed),
        "checks": len(holed),
        "answered": sum(each.answered for each in holed),
        "within": sum(each.within for each in holed),
        "rms_mm": {f"views_{views}": rms_off_mm(holed, views) for views in DRIFT_VIEWS},
        "solid_checks": len(solid),
        "solid_refused": sum(not each.answered for each in solid),
    }


def reconstructions(discs: Sequence[Disc], processes: int) -> Values:
    """Reconstruct the discs of which all views are here."""
    full = [disc for disc in discs if disc.views == VIEWS]
    works = [partial(drawn, disc, views) for views in reversed(IMAGE_VIEWS) for disc in full]
    results = list(chain.from_iterable(measure(works, processes=processes, what="Reconstructing")))
    (solid,) = (disc for disc in discs if disc.name == SOLID)
    return {
        "discs": len(full),
        "table": image_table(results),
        "cupping_uncorrected_percent": cupping_percent(full[0], solid, "none"),
        "cupping_percent": cupping_percent(full[0], solid, "auto"),
    }


PARTS: Mapping[str, Callable[[Sequence[Disc], int], Values]] = {
    "calibration": calibrations,
    "drift": drift_checks,
    "reconstruction": reconstructions,
}


def main() -> None:
    """Measure what is wanted, print its tables and write its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="at a time, of one thread each")
    chosen = parser.parse_args()
    discs = read_discs(discs_folder())
    for name in chosen.only:
        measurement = Measurement.begin(f"worker/sawmill_tomography/{name}")
        values = PARTS[name](discs, chosen.processes)
        print(*(text for text in values.values() if isinstance(text, str)), sep="\n\n")
        measurement.write({f"measured-{name}": values}, timed=False)


if __name__ == "__main__":
    main()
