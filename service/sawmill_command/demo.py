"""`sawmill demo`: the whole job over HTTP, on a simulated stack and, if available, on the published scans."""

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import httpx
import numpy as np
from numpy.typing import NDArray
from rich import progress as bars
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_command import demo_client, examples
from sawmill_command.demo_client import DemoError, Json, running_service
from sawmill_command.demo_page import LogPair, Section, write_page
from sawmill_contracts.calibrations import CalibrationSucceeded, FoundGeometry
from sawmill_formats.output.volume_reader import volume_slice
from sawmill_mill.two_questions import TwoQuestions
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame, Theta, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_vocabulary import Progress, ProgressCallback
from sawmill_vocabulary.physics import Physics
from sawmill_worker.pictures.images import bare_png
from sawmill_worker.pictures.report_numbers import theta_change, theta_rows, theta_values
from sawmill_worker.pictures.windows import LOG_WINDOW, window_of

PUBLISHED_THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
# Usual errors of a tape measure and a spirit level, in the directions that add up: 3 mm and half a degree.
TAPE_ERROR = Theta(0.0, 3.0, 3.0, -3.0, -0.009)
SPARSE_VIEWS, FIELD_MM = 20, 400.0
TAPED, CALIBRATED = "measured by tape", "calibrated"
# Logs are reconstructed without a fit, so that an image shows its geometry and nothing else.
DIRECT: Json = {"method": "fbp"}
FIRST_LOG_ROW = examples.PHANTOM_ROWS

console = Console()


@dataclass(frozen=True)
class DemoSize:
    """Size of the demo's work.

    Attributes
    ----------
    views
        Number of views of a simulated scan.
    slices, shown
        Numbers of pixels along a side of a slice, and of the two pictures that people compare.
    """

    views: int = 360
    slices: int = 256
    shown: int = 540


@dataclass(frozen=True)
class Truth:
    """Ground truth of the scan: theta, the log's slice [x, y] and the side of the square that holds the log."""

    theta: Theta
    image: NDArray[np.float64]
    log_mm: float


def run_demo(
    output: Path,
    size: DemoSize = DemoSize(),
    service: Callable[[Path], AbstractContextManager[httpx.Client]] = running_service,
) -> int:
    """Write pictures, HDF5 files and index.html into a folder, and return the exit code.

    Parameters
    ----------
    output
        The folder.
    size
        Size of the work.
    service
        Function that runs a service with its files in a folder, and gives a client of it.
    """
    started = time.perf_counter()
    published = published_data()
    try:
        output.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-demo-")))
            bar = stack.enter_context(_progress())
            with _step(bar, "Starting the service"):
                client = stack.enter_context(service(folder))
            steps = _Demo(client, output, folder, bar, size)
            sections = [steps.simulated(), steps.bad_day()]
            if published is not None:
                sections.append(steps.published(published))
    except (DemoError, httpx.TransportError, OSError) as error:
        console.print(f"[bold red]The demo stopped:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    write_page(output / "index.html", sections)
    for section in sections:
        _print(section)
    if published is None:
        console.print(
            "The published scans are not here (SAWMILL_PUBLISHED_DATA or ../shared/data): simulated data only."
        )
    done = f"Done in {time.perf_counter() - started:.1f} s. Open [bold]{output / 'index.html'}[/]"
    console.print(done, highlight=False, soft_wrap=True)
    return 0


def published_data() -> Path | None:
    """Return the folder of the published scans, if the folder is available."""
    folder = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data"))
    return folder if (folder / "l-phantom" / "sinogram.mat").is_file() else None


@contextmanager
def _progress() -> Iterator[bars.Progress]:
    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.TextColumn("{task.percentage:3.0f} %"),
        bars.TimeElapsedColumn(),
    )
    with bars.Progress(*columns, console=console) as bar:
        yield bar


@contextmanager
def _step(bar: bars.Progress, what: str) -> Iterator[ProgressCallback]:
    task = bar.add_task(what, total=1.0)

    def on_progress(progress: Progress) -> None:
        bar.update(task, completed=min(progress.fraction, 0.99), description=f"{what}: {progress.stage}")

    yield on_progress
    bar.update(task, completed=1.0, description=what)


class _Demo:
    """Steps of the demo, each with a progress bar."""

    def __init__(self, client: httpx.Client, output: Path, folder: Path, bar: bars.Progress, size: DemoSize) -> None:
        self._client, self._output, self._folder, self._bar, self._size = client, output, folder, bar, size

    def simulated(self) -> Section:
        """Calibrate with a stack of counts in which a log carries the phantom on its end."""
        stack = self._folder / "stack.h5"
        slices = examples.mill_slices()
        with _step(self._bar, "Simulating a log with the phantom on its end"):
            examples.write_mill_stack(stack, self._size.views, slices)
            image = slices[FIRST_LOG_ROW].rasterise(self._size.slices, FIELD_MM)
        scanner = self._scanner("simulated scanner", examples.SCANNER)
        with _step(self._bar, "Uploading the stack") as on_progress:
            scan = demo_client.upload(
                self._client,
                stack,
                on_progress,
                scanner_id=scanner,
                data="counts",
                phantom_id="l-shape",
                phantom_rows=f"0:{FIRST_LOG_ROW}",
            )
        truth = Truth(examples.THETA, image.astype(np.float64), 300.0)
        rows = f"{FIRST_LOG_ROW}:{len(slices)}"
        calibrated = self._calibrate("Calibrating (simulated)", scan["id"], None)
        section = self._section(
            "A simulated scan of a log with the phantom on its end",
            f"{self._size.views} views of raw counts with flat and dark fields; rows 0 to {FIRST_LOG_ROW - 1} show the "
            "L-shaped phantom, the others the log: growth rings, knots, photon noise.",
            "simulated",
            calibrated,
        )
        self._process(section, "simulated", (scan["id"], scan["id"]), calibrated, truth, rows)
        return section

    def bad_day(self) -> Section:
        """Calibrate with a scan of the phantom that has many defects, and show the calibration's remarks."""
        scan = self._folder / "bad-day.h5"
        with _step(self._bar, "Simulating a bad day at the mill"):
            examples.write_bad_day(scan, self._size.views)
        scanner = self._scanner("scanner on a bad day", examples.SCANNER)
        with _step(self._bar, "Uploading its scan") as on_progress:
            spec = {"scanner_id": scanner, "data": "counts", "phantom_id": "l-shape"}
            uploaded = demo_client.upload(self._client, scan, on_progress, **spec)
        calibrated = self._calibrate("Calibrating (bad day)", uploaded["id"], None)
        section = self._section(
            "A bad day at the mill",
            "The same scanner, but much is wrong. Every effect is simulated with the size in the table (its fields: "
            "docs/do/simulate.md); below is what the calibration found by itself.",
            "bad-day",
            calibrated,
        )
        section.head, section.rows = ("what is wrong", "size"), _physics_rows(examples.BAD_DAY)
        section.facts.append(("calibration", _verdict(calibrated, examples.THETA)))
        section.facts += [("adjusted for", sentence) for sentence in calibrated.adjustments]
        section.facts += [("reason", sentence) for sentence in calibrated.reasons]
        return section

    def published(self, folder: Path) -> Section:
        """Calibrate with the L-phantom and the log of arXiv 2206.14444."""
        scanner = self._scanner("published scanner", examples.SCANNER)
        ids = []
        for name, extra in (("l-phantom/sinogram.mat", {"phantom_id": "l-shape"}), ("log-phantom/sinogram.npy", {})):
            with _step(self._bar, f"Uploading {name}") as on_progress:
                scan = demo_client.upload(
                    self._client,
                    folder / name,
                    on_progress,
                    scanner_id=scanner,
                    data="line-integrals",
                    angles_deg="0.5:1",
                    **extra,
                )
                ids.append(scan["id"])
        with h5py.File(folder / "log-phantom" / "truth.mat", "r") as file:
            image = np.asarray(file["logPhan"][()], np.float64)
        calibrated = self._calibrate("Calibrating (published)", ids[0], None)
        section = self._section(
            "The published scans (arXiv 2206.14444)",
            "The L-shaped phantom calibrates; the log, scanned separately, is reconstructed with that geometry.",
            "published",
            calibrated,
        )
        truth = Truth(PUBLISHED_THETA, image, FIELD_MM)
        self._process(section, "published", (ids[0], ids[1]), calibrated, truth, "0:1")
        return section

    def _scanner(self, name: str, scanner: Scanner) -> str:
        constants = {**vars(scanner), "row_pitch_mm": examples.ROW_PITCH_MM if name.startswith("simulated") else None}
        created = demo_client.post(self._client, "/v1/scanners", json={"name": name, "constants": constants})
        return str(created["id"])

    def _section(self, title: str, text: str, prefix: str, calibrated: CalibrationSucceeded) -> Section:
        """Create a section for a calibration, and save the calibration's files."""
        report, overlay, result = (f"{prefix}-{name}" for name in ("report.html", "overlay.png", "result.h5"))
        path = f"/v1/calibrations/{calibrated.id}"
        demo_client.download(self._client, f"/calibrations/{calibrated.id}/report", self._output / report)
        demo_client.download(self._client, f"{path}/overlay.png", self._output / overlay)
        demo_client.download(self._client, f"{path}/result.h5", self._output / result)
        section = Section(title, text, calibrated.verdict, TwoQuestions.of(calibrated, None), report)
        section.pictures.append((overlay, "The phantom with the geometry found, and its drawing's outline."))
        section.files += [
            (report, "the calibration's report"),
            (result, "the calibration with its sinogram, model and residual"),
        ]
        return section

    def _process(
        self,
        section: Section,
        prefix: str,
        scans: tuple[str, str],
        calibrated: CalibrationSucceeded,
        truth: Truth,
        rows: str,
    ) -> None:
        """Add the numbers and the log to a section; `scans` are the phantom's scan and the log's scan."""
        phantom_scan, log_scan = scans
        sparse = self._calibrate(f"Calibrating with {SPARSE_VIEWS} views ({prefix})", phantom_scan, SPARSE_VIEWS)
        section.head, section.rows = ("", "found", "standard deviation", "truth"), _theta_rows(calibrated, truth.theta)
        for label, calibration in ((f"{calibrated.views} views", calibrated), (f"{SPARSE_VIEWS} views", sparse)):
            section.facts.append((f"calibration, {label}", _verdict(calibration, truth.theta)))
        taped = Theta.from_vector(to_vector(truth.theta) + to_vector(TAPE_ERROR))
        asks: dict[str, Json] = {CALIBRATED: {"calibration_id": calibrated.id}, TAPED: {"theta": vars(taped)}}
        for name, geometry in asks.items():
            size = {"size": self._size.slices, "field_mm": FIELD_MM}
            request = {"scan_id": log_scan, "rows": rows, **size, **DIRECT, **geometry}
            path = self._output / f"{prefix}-log-{name.replace(' ', '-')}.h5"
            volume = self._reconstruct(f"Reconstructing, {name} ({prefix})", request, path)
            error = relative_error(volume, truth.image)
            similarity = structural_similarity_index(volume, truth.image)
            section.facts.append((f"log, geometry {name}", f"relative error {error:.3f}, SSIM {similarity:.3f}"))
            section.files.append((path.name, f"the log's slices, geometry {name}: /entry/reconstruction/data"))
        section.log = LogPair(
            *self._pair(prefix, log_scan, asks, rows, truth.log_mm),
            before_mm=_ray_error_mm(taped.source_frame(examples.SCANNER.source_to_cor_mm), truth.theta),
            after_mm=_ray_error_mm(calibrated.source_frame, truth.theta),
            assumed=theta_change(truth.theta, taped),
            time_s=calibrated.timing_s.total,
        )

    def _pair(self, prefix: str, log_scan: str, asks: dict[str, Json], rows: str, field_mm: float) -> tuple[str, str]:
        """Draw the first log slice by tape geometry and calibrated, in one grey window; return both file names."""
        first = int(rows.partition(":")[0])
        size = {"size": self._size.shown, "field_mm": field_mm}
        shown = {"scan_id": log_scan, "rows": f"{first}:{first + 1}", **size, **DIRECT}
        images = {
            name: self._reconstruct(f"Drawing, {name} ({prefix})", {**shown, **geometry}, self._folder / "shown.h5")
            for name, geometry in asks.items()
        }
        window, names = window_of(images[CALIBRATED], *LOG_WINDOW), (f"{prefix}-before.png", f"{prefix}-after.png")
        for name, image in zip(names, (images[TAPED], images[CALIBRATED]), strict=True):
            (self._output / name).write_bytes(bare_png(image, field_mm=field_mm, window=window))
        return names

    def _calibrate(self, what: str, scan_id: str, views: int | None) -> CalibrationSucceeded:
        with _step(self._bar, what) as on_progress:
            accepted = demo_client.post(self._client, "/v1/calibrations", json={"scan_id": scan_id, "views": views})
            demo_client.wait(self._client, accepted["job_id"], on_progress)
            return CalibrationSucceeded.model_validate(
                demo_client.get(self._client, f"/v1/calibrations/{accepted['id']}")
            )

    def _reconstruct(self, what: str, request: Json, path: Path) -> NDArray[np.float32]:
        with _step(self._bar, what) as on_progress:
            answer = demo_client.post(self._client, "/v1/reconstructions", json=request)
            demo_client.wait(self._client, answer["job_id"], on_progress)
            log = f"/v1/reconstructions/{answer['id']}"
            demo_client.download(self._client, f"{log}/volume.h5", path)
            slices, x, y = demo_client.get(self._client, log)["result"]["shape"]
        return volume_slice(path, (slices, x, y), 0).data


def _theta_rows(geometry: FoundGeometry, truth: Theta) -> list[tuple[str, ...]]:
    rows = zip(theta_rows(geometry), theta_values(truth), strict=True)
    return [(each.name, each.value, each.deviation, value) for each, value in rows]


def _physics_rows(physics: Physics) -> list[tuple[str, ...]]:
    """List the effects that are switched on."""
    return [
        (f"{group}.{name}", f"{value:g}")
        for group, effects in vars(physics).items()
        for name, value in vars(effects).items()
        if value != getattr(type(effects)(), name)
    ]


def _verdict(calibrated: CalibrationSucceeded, truth: Theta) -> str:
    true, frame = truth.source_frame(examples.SCANNER.source_to_cor_mm), calibrated.source_frame
    psi = math.degrees(angle_difference(frame.psi_rad, true.psi_rad))
    predicted = calibrated.predicted_ray_error_mm
    expected = "" if predicted is None else f" (predicted {predicted.rms:.3f})"
    error = f"ray error {_ray_error_mm(frame, truth):.3f} mm{expected}"
    return f"{calibrated.verdict}: {error}, psi off by {psi:+.4f}°, in {calibrated.timing_s.total:.2f} s"


def _ray_error_mm(frame: SourceFrame, truth: Theta) -> float:
    return ray_error(examples.SCANNER, truth.source_frame(examples.SCANNER.source_to_cor_mm), frame).rms_mm


def _print(section: Section) -> None:
    table = Table(*section.head, title=section.title)
    for row in section.rows:
        table.add_row(*row)
    console.print(table)
    for label, value in section.facts:
        console.print(f"  {label}: {value}", highlight=False, soft_wrap=True)
