"""`sawmill demo`: the whole job over HTTP, on a simulated scan of a log that carries the phantom on its end."""

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray
from rich import progress as bars
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_calibration.pictures.images import bare_png
from sawmill_calibration.pictures.pages import LOG_WINDOW, window_of
from sawmill_calibration.pictures.report_numbers import theta_change, theta_rows, theta_values
from sawmill_calibration.pictures.report_page import page_templates
from sawmill_command import demo_client, examples
from sawmill_command.demo_client import DemoError, Json, running_service
from sawmill_command.seeding import PHANTOM_ROWS, ROW_PITCH_MM, THETA
from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_formats.output.volume_reader import volume_slice
from sawmill_mill.two_questions import VERDICTS, TwoQuestions
from sawmill_tomography.geometry.geometry import SourceFrame, Theta, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_vocabulary import Progress, ProgressCallback

# Usual errors of a tape measure and a spirit level, in the directions that add up: 3 mm and half a degree.
TAPE_ERROR = Theta(0.0, 3.0, 3.0, -3.0, -0.009)
SPARSE_VIEWS, FIELD_MM, LOG_MM = 20, 400.0, 300.0
TAPED, CALIBRATED = "measured by tape", "calibrated"
TRUE = THETA.source_frame(examples.SCANNER.source_to_cor_mm)

console = Console()
_say = partial(console.print, highlight=False, soft_wrap=True)
_Step = Callable[[str], AbstractContextManager[ProgressCallback]]


@dataclass(frozen=True)
class DemoSize:
    """Number of views, and of pixels along a side of a slice and of the two pictures that people compare."""

    views: int = 360
    slices: int = 256
    shown: int = 540


def run_demo(
    output: Path,
    size: DemoSize = DemoSize(),
    service: Callable[[Path], AbstractContextManager[httpx.Client]] = running_service,
) -> int:
    """Write pictures, HDF5 files and index.html into a folder, and return the exit code.

    `service` runs a service with its files in a folder, and gives a client of it.
    """
    started = time.perf_counter()
    try:
        output.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-demo-")))
            step = stack.enter_context(_progress())
            with step("Starting the service"):
                client = stack.enter_context(service(folder))
            shown = _shown(client, output, folder, size, step)
    except (DemoError, httpx.TransportError, OSError) as error:
        _say(f"[bold red]The demo stopped:[/] {escape(str(error))}")
        return 1
    page = page_templates().get_template("demo.html").render(shown)
    (output / "index.html").write_text(page.lstrip(), encoding="utf-8")
    table = Table(*shown["head"], title="A simulated scan of a log with the phantom on its end")
    for row in shown["rows"]:
        table.add_row(*row)
    console.print(table)
    for label, value in shown["facts"]:
        _say(f"  {label}: {value}")
    _say(f"Done in {time.perf_counter() - started:.1f} s. Open [bold]{output / 'index.html'}[/]")
    return 0


@contextmanager
def _progress() -> Iterator[_Step]:
    """Yield a function that shows a step of the demo as a bar."""
    columns = ("{task.description}", bars.BarColumn(), "{task.percentage:3.0f} %", bars.TimeElapsedColumn())
    with bars.Progress(*columns, console=console) as bar:

        @contextmanager
        def step(what: str) -> Iterator[ProgressCallback]:
            task = bar.add_task(what, total=1.0)

            def on_progress(progress: Progress) -> None:
                bar.update(task, completed=min(progress.fraction, 0.99), description=f"{what}: {progress.stage}")

            yield on_progress
            bar.update(task, completed=1.0, description=what)

        yield step


def _shown(client: httpx.Client, output: Path, folder: Path, size: DemoSize, step: _Step) -> dict[str, Any]:
    """Do the whole job, save its files, and return what the page shows."""
    slices = examples.mill_slices()
    with step("Simulating a log with the phantom on its end"):
        examples.write_mill_stack(folder / "stack.h5", size.views, slices)
        true_slice = slices[PHANTOM_ROWS].rasterise(size.slices, FIELD_MM).astype(np.float64)
    scanner = {"name": "simulated scanner", "constants": {**vars(examples.SCANNER), "row_pitch_mm": ROW_PITCH_MM}}
    spec = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": f"0:{PHANTOM_ROWS}"}
    spec["scanner_id"] = demo_client.post(client, "/v1/scanners", json=scanner)["id"]
    with step("Uploading the stack") as on_progress:
        scan_id = demo_client.upload(client, folder / "stack.h5", on_progress, **spec)["id"]
    found = _calibrate(client, step, "Calibrating", scan_id, None)
    sparse = _calibrate(client, step, f"Calibrating with {SPARSE_VIEWS} views", scan_id, SPARSE_VIEWS)
    facts = [(f"calibration, {each.views} views", _verdict(each)) for each in (found, sparse)]
    report, overlay, result = (f"simulated-{name}" for name in ("report.html", "overlay.png", "result.h5"))
    files = [(report, "the calibration's report"), (result, "the calibration with its sinogram, model and residual")]
    for address, name in (
        (f"/calibrations/{found.id}/report", report),
        (f"/v1/calibrations/{found.id}/overlay.png", overlay),
        (f"/v1/calibrations/{found.id}/result.h5", result),
    ):
        demo_client.download(client, address, output / name)

    taped = Theta.from_vector(to_vector(THETA) + to_vector(TAPE_ERROR))
    asks: dict[str, Json] = {CALIBRATED: {"calibration_id": found.id}, TAPED: {"theta": vars(taped)}}
    pictures = {}
    for name, geometry in asks.items():
        # Reconstructed without a fit, so that an image shows its geometry and nothing else.
        ask = {"scan_id": scan_id, "method": "fbp", "field_mm": FIELD_MM, **geometry}
        rows = {"rows": f"{PHANTOM_ROWS}:{len(slices)}", "size": size.slices}
        path = output / f"simulated-log-{name.replace(' ', '-')}.h5"
        volume = _reconstruct(client, step, f"Reconstructing, {name}", ask | rows, path)
        error, similarity = relative_error(volume, true_slice), structural_similarity_index(volume, true_slice)
        facts.append((f"log, geometry {name}", f"relative error {error:.3f}, SSIM {similarity:.3f}"))
        files.append((path.name, f"the log's slices, geometry {name}: /entry/reconstruction/data"))
        one = {"rows": f"{PHANTOM_ROWS}:{PHANTOM_ROWS + 1}", "size": size.shown, "field_mm": LOG_MM}
        pictures[name] = _reconstruct(client, step, f"Drawing, {name}", ask | one, folder / "shown.h5")
    window = window_of(pictures[CALIBRATED], *LOG_WINDOW)
    for name, file in ((TAPED, "before"), (CALIBRATED, "after")):
        (output / f"simulated-{file}.png").write_bytes(bare_png(pictures[name], field_mm=LOG_MM, window=window))
    return {
        "verdict": found.verdict,
        "sentence": VERDICTS[found.verdict],
        "questions": TwoQuestions.of(found, None),
        "report": report,
        "overlay": overlay,
        "views": size.views,
        "before_mm": _ray_error_mm(taped.source_frame(examples.SCANNER.source_to_cor_mm)),
        "after_mm": _ray_error_mm(found.source_frame),
        "assumed": theta_change(THETA, taped),
        "time_s": found.timing_s.total,
        "head": ("", "found", "standard deviation", "truth"),
        "rows": [
            (each.name, each.value, each.deviation, value)
            for each, value in zip(theta_rows(found), theta_values(THETA), strict=True)
        ],
        "facts": facts,
        "files": files,
    }


def _calibrate(client: httpx.Client, step: _Step, what: str, scan_id: str, views: int | None) -> CalibrationSucceeded:
    with step(what) as on_progress:
        accepted = demo_client.post(client, "/v1/calibrations", json={"scan_id": scan_id, "views": views})
        demo_client.wait(client, accepted["job_id"], on_progress)
        return CalibrationSucceeded.model_validate(demo_client.get(client, f"/v1/calibrations/{accepted['id']}"))


def _reconstruct(client: httpx.Client, step: _Step, what: str, ask: Json, path: Path) -> NDArray[np.float32]:
    """Save a volume, and return its first slice (x, y)."""
    with step(what) as on_progress:
        answer = demo_client.post(client, "/v1/reconstructions", json=ask)
        demo_client.wait(client, answer["job_id"], on_progress)
        volume = f"/v1/reconstructions/{answer['id']}"
        demo_client.download(client, f"{volume}/volume.h5", path)
        slices, x, y = demo_client.get(client, volume)["result"]["shape"]
    return volume_slice(path, (slices, x, y), 0).data


def _verdict(calibrated: CalibrationSucceeded) -> str:
    frame, predicted = calibrated.source_frame, calibrated.predicted_ray_error_mm
    psi = math.degrees(angle_difference(frame.psi_rad, TRUE.psi_rad))
    expected = "" if predicted is None else f" (predicted {predicted.rms:.3f})"
    error = f"ray error {_ray_error_mm(frame):.3f} mm{expected}"
    return f"{calibrated.verdict}: {error}, psi off by {psi:+.4f}°, in {calibrated.timing_s.total:.2f} s"


def _ray_error_mm(frame: SourceFrame) -> float:
    return ray_error(examples.SCANNER, TRUE, frame).rms_mm
