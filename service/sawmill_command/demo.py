"""`sawmill demo`: the whole job over HTTP, on simulated scans."""

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

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
from sawmill_command.seeding import PHANTOM_ROWS, ROW_PITCH_MM, THETA
from sawmill_contracts.calibrations import CalibrationSucceeded, FoundGeometry
from sawmill_formats.output.volume_reader import volume_slice
from sawmill_mill.two_questions import TwoQuestions
from sawmill_tomography.geometry.geometry import SourceFrame, Theta, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_vocabulary import Progress, ProgressCallback
from sawmill_vocabulary.physics import Physics
from sawmill_worker.pictures.images import bare_png
from sawmill_worker.pictures.report_numbers import theta_change, theta_rows, theta_values
from sawmill_worker.pictures.windows import LOG_WINDOW, window_of

# Usual errors of a tape measure and a spirit level, in the directions that add up: 3 mm and half a degree.
TAPE_ERROR = Theta(0.0, 3.0, 3.0, -3.0, -0.009)
SPARSE_VIEWS, FIELD_MM, LOG_MM = 20, 400.0, 300.0
TAPED, CALIBRATED = "measured by tape", "calibrated"
# Logs are reconstructed without a fit, so that an image shows its geometry and nothing else.
DIRECT: Json = {"method": "fbp"}

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
    try:
        output.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-demo-")))
            bar = stack.enter_context(_progress())
            with _step(bar, "Starting the service"):
                client = stack.enter_context(service(folder))
            steps = _Demo(client, output, folder, bar, size)
            sections = [steps.simulated(), steps.bad_day()]
    except (DemoError, httpx.TransportError, OSError) as error:
        console.print(f"[bold red]The demo stopped:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    write_page(output / "index.html", sections)
    for section in sections:
        _print(section)
    done = f"Done in {time.perf_counter() - started:.1f} s. Open [bold]{output / 'index.html'}[/]"
    console.print(done, highlight=False, soft_wrap=True)
    return 0


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
            image = slices[PHANTOM_ROWS].rasterise(self._size.slices, FIELD_MM)
        scanner = self._scanner("simulated scanner")
        with _step(self._bar, "Uploading the stack") as on_progress:
            scan = demo_client.upload(
                self._client,
                stack,
                on_progress,
                scanner_id=scanner,
                data="counts",
                phantom_id="l-shape",
                phantom_rows=f"0:{PHANTOM_ROWS}",
            )
        rows = f"{PHANTOM_ROWS}:{len(slices)}"
        calibrated = self._calibrate("Calibrating", scan["id"], None)
        section = self._section(
            "A simulated scan of a log with the phantom on its end",
            f"{self._size.views} views of raw counts with flat and dark fields; rows 0 to {PHANTOM_ROWS - 1} show the "
            "L-shaped phantom, the others the log: growth rings, knots, photon noise.",
            "simulated",
            calibrated,
        )
        self._process(section, scan["id"], calibrated, image.astype(np.float64), rows)
        return section

    def bad_day(self) -> Section:
        """Calibrate with a scan of the phantom that has many defects, and show the calibration's remarks."""
        scan = self._folder / "bad-day.h5"
        with _step(self._bar, "Simulating a bad day at the mill"):
            examples.write_bad_day(scan, self._size.views)
        scanner = self._scanner("scanner on a bad day")
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
        section.facts.append(("calibration", _verdict(calibrated)))
        section.facts += [("adjusted for", sentence) for sentence in calibrated.adjustments]
        section.facts += [("reason", sentence) for sentence in calibrated.reasons]
        return section

    def _scanner(self, name: str) -> str:
        constants = {**vars(examples.SCANNER), "row_pitch_mm": ROW_PITCH_MM}
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
        scan_id: str,
        calibrated: CalibrationSucceeded,
        image: NDArray[np.float64],
        rows: str,
    ) -> None:
        """Add the numbers and the log to a section; `image` is the true first slice (x, y) of the log."""
        sparse = self._calibrate(f"Calibrating with {SPARSE_VIEWS} views", scan_id, SPARSE_VIEWS)
        section.head, section.rows = ("", "found", "standard deviation", "truth"), _theta_rows(calibrated)
        for label, calibration in ((f"{calibrated.views} views", calibrated), (f"{SPARSE_VIEWS} views", sparse)):
            section.facts.append((f"calibration, {label}", _verdict(calibration)))
        taped = Theta.from_vector(to_vector(THETA) + to_vector(TAPE_ERROR))
        asks: dict[str, Json] = {CALIBRATED: {"calibration_id": calibrated.id}, TAPED: {"theta": vars(taped)}}
        shown = {}
        for name, geometry in asks.items():
            request = {"scan_id": scan_id, "rows": rows, "size": self._size.slices, "field_mm": FIELD_MM, **geometry}
            path = self._output / f"simulated-log-{name.replace(' ', '-')}.h5"
            volume = self._reconstruct(f"Reconstructing, {name}", request, path)
            error, similarity = relative_error(volume, image), structural_similarity_index(volume, image)
            section.facts.append((f"log, geometry {name}", f"relative error {error:.3f}, SSIM {similarity:.3f}"))
            section.files.append((path.name, f"the log's slices, geometry {name}: /entry/reconstruction/data"))
            first = {"rows": f"{PHANTOM_ROWS}:{PHANTOM_ROWS + 1}", "size": self._size.shown, "field_mm": LOG_MM}
            shown[name] = self._reconstruct(f"Drawing, {name}", request | first, self._folder / "shown.h5")
        window = window_of(shown[CALIBRATED], *LOG_WINDOW)
        files = {TAPED: "simulated-before.png", CALIBRATED: "simulated-after.png"}
        for name, file in files.items():
            (self._output / file).write_bytes(bare_png(shown[name], field_mm=LOG_MM, window=window))
        section.log = LogPair(
            before=files[TAPED],
            after=files[CALIBRATED],
            before_mm=_ray_error_mm(taped.source_frame(examples.SCANNER.source_to_cor_mm)),
            after_mm=_ray_error_mm(calibrated.source_frame),
            assumed=theta_change(THETA, taped),
            time_s=calibrated.timing_s.total,
        )

    def _calibrate(self, what: str, scan_id: str, views: int | None) -> CalibrationSucceeded:
        with _step(self._bar, what) as on_progress:
            accepted = demo_client.post(self._client, "/v1/calibrations", json={"scan_id": scan_id, "views": views})
            demo_client.wait(self._client, accepted["job_id"], on_progress)
            return CalibrationSucceeded.model_validate(
                demo_client.get(self._client, f"/v1/calibrations/{accepted['id']}")
            )

    def _reconstruct(self, what: str, request: Json, path: Path) -> NDArray[np.float32]:
        with _step(self._bar, what) as on_progress:
            answer = demo_client.post(self._client, "/v1/reconstructions", json={**request, **DIRECT})
            demo_client.wait(self._client, answer["job_id"], on_progress)
            log = f"/v1/reconstructions/{answer['id']}"
            demo_client.download(self._client, f"{log}/volume.h5", path)
            slices, x, y = demo_client.get(self._client, log)["result"]["shape"]
        return volume_slice(path, (slices, x, y), 0).data


def _theta_rows(geometry: FoundGeometry) -> list[tuple[str, ...]]:
    rows = zip(theta_rows(geometry), theta_values(THETA), strict=True)
    return [(each.name, each.value, each.deviation, value) for each, value in rows]


def _physics_rows(physics: Physics) -> list[tuple[str, ...]]:
    """List the effects that are switched on."""
    return [
        (f"{group}.{name}", f"{value:g}")
        for group, effects in vars(physics).items()
        for name, value in vars(effects).items()
        if value != getattr(type(effects)(), name)
    ]


def _verdict(calibrated: CalibrationSucceeded) -> str:
    true, frame = THETA.source_frame(examples.SCANNER.source_to_cor_mm), calibrated.source_frame
    psi = math.degrees(angle_difference(frame.psi_rad, true.psi_rad))
    predicted = calibrated.predicted_ray_error_mm
    expected = "" if predicted is None else f" (predicted {predicted.rms:.3f})"
    error = f"ray error {_ray_error_mm(frame):.3f} mm{expected}"
    return f"{calibrated.verdict}: {error}, psi off by {psi:+.4f}°, in {calibrated.timing_s.total:.2f} s"


def _ray_error_mm(frame: SourceFrame) -> float:
    return ray_error(examples.SCANNER, THETA.source_frame(examples.SCANNER.source_to_cor_mm), frame).rms_mm


def _print(section: Section) -> None:
    table = Table(*section.head, title=section.title)
    for row in section.rows:
        table.add_row(*row)
    console.print(table)
    for label, value in section.facts:
        console.print(f"  {label}: {value}", highlight=False, soft_wrap=True)
