"""`sawmill demo`: the whole job over HTTP, on a simulated stack and, where they are, on the published scans."""

import math
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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

from sawmill_worker import demo_client, examples
from sawmill_worker.contracts.calibrations import CalibrationSucceeded
from sawmill_worker.demo_client import DemoError, Json
from sawmill_worker.demo_page import Section, write_page
from sawmill_worker.files.volume_reader import volume_slice
from sawmill_worker.pictures.image_panels import log_comparison_png
from sawmill_worker.tomography.geometry import Scanner, Theta, angle_difference, to_vector
from sawmill_worker.tomography.quality import relative_error, structural_similarity_index
from sawmill_worker.tomography.ray_error import ray_error
from sawmill_worker.vocabulary import Progress, ProgressCallback
from sawmill_worker.vocabulary.physics import Physics

PUBLISHED_THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
# What a tape measure and a spirit level get wrong: the geometry that a mill would have without calibrating.
TAPE_ERROR = Theta(0.0, 18.0, 14.0, -11.0, -0.03)
VIEWS, SPARSE_VIEWS = 360, 20
SIZE, FIELD_MM = 256, 400.0
FIRST_LOG_ROW = examples.PHANTOM_ROWS

console = Console()


@dataclass(frozen=True)
class Truth:
    """The truth of the scan: theta and the log's slice [x, y]."""

    theta: Theta
    image: NDArray[np.float64]
    unit: str


def run_demo(output: Path) -> int:
    """Write pictures, HDF5 files and index.html into the folder; returns the exit code."""
    started = time.perf_counter()
    published = published_data()
    try:
        output.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-demo-")))
            bar = stack.enter_context(_progress())
            with _step(bar, "Starting the service"):
                client = stack.enter_context(demo_client.running_service(folder))
            steps = _Demo(client, output, folder, bar)
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
    """The folder of the published scans, if it is here."""
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
    """The steps, each with its bar."""

    def __init__(self, client: httpx.Client, output: Path, folder: Path, bar: bars.Progress) -> None:
        self._client, self._output, self._folder, self._bar = client, output, folder, bar

    def simulated(self) -> Section:
        """One stack of counts in which a log carries the phantom on its end."""
        stack = self._folder / "stack.h5"
        slices = examples.mill_slices()
        with _step(self._bar, "Simulating a log with the phantom on its end"):
            examples.write_mill_stack(stack, VIEWS, slices)
            image = slices[FIRST_LOG_ROW].rasterise(SIZE, FIELD_MM)
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
        section = Section(
            "A simulated scan of a log with the phantom on its end",
            f"{VIEWS} views of raw counts with flat and dark fields; rows 0 to {FIRST_LOG_ROW - 1} show the L-shaped "
            "phantom, the others the log: growth rings, knots, photon noise.",
            ("", "found", "standard deviation", "truth"),
        )
        truth = Truth(examples.THETA, image.astype(np.float64), "1/mm")
        rows = f"{FIRST_LOG_ROW}:{len(slices)}"
        self._process(section, "simulated", scan["id"], scan["id"], examples.SCANNER, truth, rows)
        return section

    def bad_day(self) -> Section:
        """A scan of the phantom with much that can be wrong, and what the calibration reports of it."""
        scan = self._folder / "bad-day.h5"
        with _step(self._bar, "Simulating a bad day at the mill"):
            examples.write_bad_day(scan, VIEWS)
        scanner = self._scanner("scanner on a bad day", examples.SCANNER)
        with _step(self._bar, "Uploading its scan") as on_progress:
            spec = {"scanner_id": scanner, "data": "counts", "phantom_id": "l-shape"}
            uploaded = demo_client.upload(self._client, scan, on_progress, **spec)
        found = self._calibrate("Calibrating (bad day)", uploaded["id"], None)
        section = Section(
            "A bad day at the mill",
            "The same scanner, but much is wrong. Every effect is simulated with the size in the table (its fields: "
            "docs/simulating.md); below is what the calibration found by itself.",
            ("what is wrong", "size"),
        )
        section.rows = _physics_rows(examples.BAD_DAY)
        section.facts.append(("calibration", _verdict(found, examples.SCANNER, examples.THETA)))
        section.facts += [("adjusted for", sentence) for sentence in found.adjustments]
        section.facts += [("reason", sentence) for sentence in found.reasons]
        self._save_calibration(section, "bad-day", found.id)
        return section

    def published(self, folder: Path) -> Section:
        """The L-phantom and the log of arXiv 2206.14444."""
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
        section = Section(
            "The published scans (arXiv 2206.14444)",
            "The L-shaped phantom calibrates; the log, scanned separately, is reconstructed with that geometry.",
            ("", "found", "standard deviation", "truth"),
        )
        truth = Truth(PUBLISHED_THETA, image, "as given")
        self._process(section, "published", ids[0], ids[1], examples.SCANNER, truth, "0:1")
        return section

    def _scanner(self, name: str, scanner: Scanner) -> str:
        constants = {**vars(scanner), "row_pitch_mm": examples.ROW_PITCH_MM if name.startswith("simulated") else None}
        created = demo_client.post(self._client, "/v1/scanners", json={"name": name, "constants": constants})
        return str(created["id"])

    def _process(
        self, section: Section, prefix: str, phantom_scan: str, log_scan: str, scanner: Scanner, truth: Truth, rows: str
    ) -> None:
        found = self._calibrate(f"Calibrating ({prefix})", phantom_scan, None)
        sparse = self._calibrate(f"Calibrating with {SPARSE_VIEWS} views ({prefix})", phantom_scan, SPARSE_VIEWS)
        section.rows = _theta_rows(found, truth.theta)
        for label, calibration in ((f"{found.views} views", found), (f"{SPARSE_VIEWS} views", sparse)):
            section.facts.append((f"calibration, {label}", _verdict(calibration, scanner, truth.theta)))
        self._save_calibration(section, prefix, found.id)
        volumes = {}
        taped = Theta.from_vector(to_vector(truth.theta) + to_vector(TAPE_ERROR))
        asks: dict[str, Json] = {
            "calibrated": {"calibration_id": found.id},
            "measured by tape": {"theta": vars(taped)},
        }
        for name, geometry in asks.items():
            asked = {"scan_id": log_scan, "rows": rows, "size": SIZE, "field_mm": FIELD_MM, **geometry}
            path = self._output / f"{prefix}-log-{name.replace(' ', '-')}.h5"
            volumes[name] = self._reconstruct(f"Reconstructing, {name} ({prefix})", asked, path)
            error = relative_error(volumes[name], truth.image)
            similarity = structural_similarity_index(volumes[name], truth.image)
            section.facts.append((f"log, geometry {name}", f"relative error {error:.3f}, SSIM {similarity:.3f}"))
            section.files.append((path.name, f"the log's slices, geometry {name}: /entry/reconstruction/data"))
        picture = f"{prefix}-log.png"
        (self._output / picture).write_bytes(
            log_comparison_png(
                before=volumes["measured by tape"],
                after=volumes["calibrated"],
                field_mm=FIELD_MM,
                titles=("geometry measured by tape", "geometry calibrated"),
                unit=f"attenuation, {truth.unit}",
            )
        )
        section.pictures.append(
            (picture, "The first log slice with the geometry a tape measure gives, and calibrated.")
        )

    def _calibrate(self, what: str, scan_id: str, views: int | None) -> CalibrationSucceeded:
        with _step(self._bar, what) as on_progress:
            asked = demo_client.post(self._client, "/v1/calibrations", json={"scan_id": scan_id, "views": views})
            demo_client.wait(self._client, asked["job_id"], on_progress)
            return CalibrationSucceeded.model_validate(demo_client.get(self._client, f"/v1/calibrations/{asked['id']}"))

    def _save_calibration(self, section: Section, prefix: str, calibration_id: str) -> None:
        path = f"/v1/calibrations/{calibration_id}"
        for name in ("overlay.png", "report.png", "result.h5"):
            demo_client.download(self._client, f"{path}/{name}", self._output / f"{prefix}-{name}")
        section.pictures += [
            (f"{prefix}-overlay.png", "The phantom, reconstructed with the geometry found, and its drawing's outline."),
            (f"{prefix}-report.png", "The calibration's report, with the residual sinogram and its profiles."),
        ]
        section.files.append((f"{prefix}-result.h5", "the calibration with its sinogram, model and residual"))

    def _reconstruct(self, what: str, asked: Json, path: Path) -> NDArray[np.float32]:
        with _step(self._bar, what) as on_progress:
            answer = demo_client.post(self._client, "/v1/reconstructions", json=asked)
            demo_client.wait(self._client, answer["job_id"], on_progress)
            demo_client.download(self._client, f"/v1/reconstructions/{answer['id']}/volume.h5", path)
        return volume_slice(path, 0).data


def _theta_rows(found: CalibrationSucceeded, truth: Theta) -> list[tuple[str, ...]]:
    deviation = found.standard_deviation.theta if found.standard_deviation else None
    rows: list[tuple[str, ...]] = []
    for name, value in vars(found.theta).items():
        spread = getattr(deviation, name, None)
        rows.append((name, f"{value:.5g}", "" if spread is None else f"{spread:.2g}", f"{getattr(truth, name):.5g}"))
    return rows


def _physics_rows(physics: Physics) -> list[tuple[str, ...]]:
    """The effects that are on."""
    return [
        (f"{group}.{name}", f"{value:g}")
        for group, effects in vars(physics).items()
        for name, value in vars(effects).items()
        if value != getattr(type(effects)(), name)
    ]


def _verdict(found: CalibrationSucceeded, scanner: Scanner, truth: Theta) -> str:
    true, frame = truth.source_frame(scanner.source_to_cor_mm), found.source_frame
    error = ray_error(scanner, true, frame).rms_mm
    psi = math.degrees(angle_difference(frame.psi_rad, true.psi_rad))
    predicted = found.predicted_ray_error_mm
    expected = "" if predicted is None else f" (predicted {predicted.rms:.3f})"
    return (
        f"{found.verdict}: ray error {error:.3f} mm{expected}, psi off by {psi:+.4f}°, in {found.timing_s.total:.2f} s"
    )


def _print(section: Section) -> None:
    table = Table(*section.head, title=section.title)
    for row in section.rows:
        table.add_row(*row)
    console.print(table)
    for label, value in section.facts:
        console.print(f"  {label}: {value}", highlight=False, soft_wrap=True)
