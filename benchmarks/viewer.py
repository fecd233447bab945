"""Latency of a slice from the request to the pixels on the screen, and of lists of 10 000.

    python benchmarks/viewer.py [--slices 300] [--size 512] [--moves 60]

A service with a separate folder, a volume with noise as a reconstruction has it, and Debian's Chromium. "Random"
moves to a slice that nothing has fetched; "the next" moves on to a slice whose picture was fetched ahead, after a pause
in which somebody looks. The time runs from the slider's event to the second frame after the slice's picture, or its
values, were painted, by the page's own clock: by then the first one is on the screen. The time to the values includes
that in which the slider must rest. A line of 3 Mbit/s with 20 ms to and fro is Chromium's emulation. Prints
milliseconds: median, 95th percentile, largest; the percentiles go to `benchmarks/results/viewer.json`.
"""

import argparse
import logging
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path

import httpx
import numpy as np
import structlog
import uvicorn
from measurement import Measurement
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page, sync_playwright

from sawmill_contracts import kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanState
from sawmill_formats.output.volume_writer import new_reconstruction
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.tables import JobRow
from sawmill_platform.settings import StorageSettings
from sawmill_service.app import create_app
from sawmill_service.http.listening import listen
from sawmill_service.settings import ServiceSettings
from sawmill_store.mill_tables import ReconstructionRow, ScanRow
from sawmill_store.store import Store

SCANNERS, SCANS, MINUTES_APART = 50, 10_000, 7
PIXEL_FIELD_MM, SPACING_MM = 400.0, 10.0
WINDOW = (0.0, 0.034)
PAUSE_MS, SEED = 250, 20261122
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")
Line = dict[str, bool | float]
LINE: Line = {"offline": False, "latency": 20, "downloadThroughput": 3e6 / 8, "uploadThroughput": 3e6 / 8}
# Resolves with the milliseconds from the slider's event until the slice, "shown" or its "values", is on the screen.
MOVE = """
([index, what]) => new Promise(resolve => {
  const slider = document.querySelector("#slice"), pane = document.querySelector(".pane");
  const started = performance.now();
  const look = () => pane.dataset[what] === String(index)
    ? requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now() - started)))
    : setTimeout(look, 1);
  slider.value = index;
  slider.dispatchEvent(new Event("input"));
  look();
})
"""


def slice_of(index: int, slices: int, size: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw a log with rings, a moving knot and noise, (x, y) in 1/mm, without any symmetry."""
    x, y = np.mgrid[:size, :size] / size - 0.5
    radius = np.hypot(x - 0.03, 1.1 * (y + 0.02))
    wood = 0.02 + 0.004 * np.cos(180 * radius) * (radius < 0.36)
    angle = 2.0 + 2.0 * index / slices
    along = x * np.cos(angle) + y * np.sin(angle)
    knot = (along > 0) & (np.abs(x * np.sin(angle) - y * np.cos(angle)) < 0.02 + 0.06 * along)
    image = np.where(radius < 0.38, wood + 0.012 * knot, 0.0) + 0.0015 * rng.standard_normal((size, size))
    return image.astype(np.float32)


def write_volume(folder: Path, slices: int, size: int) -> None:
    """Write volume.h5."""
    rng = np.random.default_rng(SEED)
    folder.mkdir(parents=True)
    with new_reconstruction(
        folder / "volume.h5",
        (slices, size, size),
        pixel_mm=PIXEL_FIELD_MM / size,
        row_pitch_mm=SPACING_MM,
        unit="1/mm",
        geometry={},
        parameters={},
        software_version="0",
        input_sha256="0" * 64,
    ) as volume:
        for index in range(slices):
            volume.write(index, slice_of(index, slices, size, rng)[np.newaxis])


def result_of(slices: int, size: int) -> dict[str, object]:
    """Return a reconstruction's result, as a job would have stored it."""
    theta = {
        "source_shift_mm": 0.0,
        "detector_shift_mm": 0.0,
        "detector_tilt": 0.0,
        "detector_to_cor_mm": 500.0,
        "initial_angle_rad": 0.0,
    }
    return {
        "shape": (slices, size, size),
        "pixel_mm": PIXEL_FIELD_MM / size,
        "unit": "1/mm",
        "value_range": WINDOW,
        "theta": theta,
        "rotation": "as-given",
        "handedness": "as-drawn",
        "views": 360,
        "rows": (0, slices),
        "time_s": 12.0,
        "software_version": "0",
        "input_sha256": "0" * 64,
    }


def fill(store: Store, slices: int, size: int) -> None:
    """Store scanners, scans and a log of each; the newest, `r0`, has a volume."""
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=704, detector_pitch_mm=1.2)
    for number in range(SCANNERS):
        spec = ScannerSpec(name=f"Line {number}", constants=constants)
        store.scanners.create(spec, scanner_id=f"line-{number}")
    write_volume(store.files.results(kinds.RECONSTRUCT, "r0"), slices, size)
    shape = {"views": 360, "rows": slices, "detector": 704}
    reading = {"format": "NXtomo", "shape": shape, "angular_range_deg": [0, 359]}
    result, now = result_of(slices, size), store.database.now()
    with store.database.write() as session:
        for number in range(SCANS):
            at, scanner_id = now - timedelta(minutes=MINUTES_APART * number), f"line-{number % SCANNERS}"
            jobs = {"i": (kinds.INGEST, f"s{number}"), "j": (kinds.RECONSTRUCT, f"r{number}")}
            for prefix, (kind, subject_id) in jobs.items():
                done = {"state": JobState.SUCCEEDED, "subject_id": subject_id}
                session.add(JobRow(id=f"{prefix}{number}", created_at=at, kind=kind, **done))
            session.flush()
            of_scan = {"spec": {"data": "counts", "name": f"log {number}"}, "size_bytes": 10**8, "sha256": "0" * 64}
            common = {"created_at": at, "scanner_id": scanner_id}
            session.add(
                ScanRow(
                    id=f"s{number}", state=ScanState.READY, job_id=f"i{number}", reading=reading, **of_scan, **common
                )
            )
            options = {"scan_id": f"s{number}", "size": size}
            log = {"scan_id": f"s{number}", "options": options, "result": result, "calibration_id": None}
            session.add(ReconstructionRow(id=f"r{number}", job_id=f"j{number}", **log, **common))


@contextmanager
def serving(store: Store) -> Iterator[str]:
    """Serve a store in a thread; yield the service's address."""
    app = create_app(ServiceSettings(), store, lambda _: None)
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, lifespan="off"))
    with closing(listen("127.0.0.1", 0, guarded=False)) as listening:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            while not server.started:
                time.sleep(0.01)
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


def report(name: str, milliseconds: Sequence[float]) -> float:
    """Print one line; the 95th percentile."""
    median, most = np.percentile(milliseconds, [50, 95])
    print(f"  {name:<46} median {median:6.1f}   95 % {most:6.1f}   largest {max(milliseconds):6.1f} ms", flush=True)
    return float(most)


def timed(ask: Callable[[], httpx.Response], repeats: int) -> list[float]:
    """Measure the milliseconds of each call."""
    found = []
    for _ in range(repeats):
        started = time.perf_counter()
        ask().raise_for_status()
        found.append(1000 * (time.perf_counter() - started))
    return found


def measure_server(client: httpx.Client, slices: int, moves: int) -> None:
    """Print the service's answers, as another program on this machine has them."""
    order = iter(np.random.default_rng(SEED).integers(0, slices, 10 * moves).tolist())
    log = "/v1/reconstructions/r0"
    print("server")
    report("slice .npy", timed(lambda: client.get(f"{log}/slices/{next(order)}.npy"), moves))
    report("slice .npy, max_size=256", timed(lambda: client.get(f"{log}/slices/{next(order)}.npy?max_size=256"), moves))
    small = f"max_size=512&window_low={WINDOW[0]}&window_high={WINDOW[1]}"
    report("slice .jpg", timed(lambda: client.get(f"{log}/slices/{next(order)}.jpg?{small}"), moves))
    report("slice .png", timed(lambda: client.get(f"{log}/slices/{next(order)}.png"), moves // 4))
    report("side .npy", timed(lambda: client.get(f"{log}/side.npy"), moves // 4))
    report("thumbnail, drawn", timed(lambda: client.get(f"{log}/thumbnail.png"), 1))
    report("thumbnail, kept", timed(lambda: client.get(f"{log}/thumbnail.png"), moves))
    print(f"lists of {SCANS} scans and as many logs, {SCANNERS} scanners")
    for path in ("/v1/scans", "/v1/reconstructions", "/scans", "/logs", "/logs/r0"):
        report(path, timed(lambda path=path: client.get(path), moves // 4))  # type: ignore[misc]
    for path in ("/scans", "/logs"):
        query = f"{path}?scanner_id=line-7&day={time.strftime('%Y-%m-%d')}"
        report(f"{path}, of a scanner and a day", timed(lambda query=query: client.get(query), moves // 4))  # type: ignore[misc]


def moved(page: Page, places: Iterable[int], pause_ms: int, what: str = "shown") -> list[float]:
    """Measure the milliseconds of each move of the slider, until the slice is shown or its values are."""
    found = []
    for index in places:
        page.wait_for_timeout(pause_ms)
        found.append(page.evaluate(MOVE, [index, what]))
    return found


@contextmanager
def looking(browser: Browser, address: str, line: Line | None = None) -> Iterator[Page]:
    """Open the log's page in a browser with an empty cache; yield the page at rest."""
    with closing(browser.new_context(base_url=address, viewport={"width": 1280, "height": 800})) as context:
        page = context.new_page()
        page.goto("/logs/r0")
        page.wait_for_selector(".pane[data-values]:not([data-values=''])")
        page.wait_for_timeout(1000)
        if line:
            context.new_cdp_session(page).send("Network.emulateNetworkConditions", line)
        yield page


def measure_browser(address: str, slices: int, size: int, moves: int) -> dict[str, float]:
    """Measure milliseconds from the slider's event to the screen, the 95th percentile of each way to a slice."""
    program = shutil.which("chromium")
    assert program, "this needs Debian's Chromium: apt-get install chromium"
    # Five apart: no slice's picture is fetched ahead for another.
    random = np.random.default_rng(SEED).permutation(range(3, slices, 5))[:moves].tolist()
    following = range(slices // 2 + 1, slices)[:moves]
    with (
        sync_playwright() as playwright,
        closing(playwright.chromium.launch(executable_path=program, args=FLAGS)) as it,
    ):
        print(f"Chromium, 1280 x 800, {slices} slices of {size} x {size}")
        with looking(it, address) as page:
            picture = report("a random slice", moved(page, random, PAUSE_MS))
        with looking(it, address) as page:
            values = report("its values", moved(page, random, PAUSE_MS, "values"))
        with looking(it, address) as page:
            report("the next slice", moved(page, following, PAUSE_MS))
            kept = report("a slice that is kept", moved(page, following, 0))
        with looking(it, address, LINE) as page:
            far = report("a random slice, 3 Mbit/s", moved(page, random, PAUSE_MS))
            far_values = report("its values, 3 Mbit/s", moved(page, random[:: len(random) // 5], PAUSE_MS, "values"))
    return {
        "picture_ms": picture,
        "values_ms": values,
        "kept_ms": kept,
        "picture_3_mbit_ms": far,
        "values_3_mbit_ms": far_values,
    }


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slices", type=int, default=300)
    parser.add_argument("--size", type=int, default=512, help="pixels along a side")
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument("--serve", action="store_true", help="only serve, to look at the pages")
    chosen = parser.parse_args()
    measurement = Measurement.begin("service/sawmill_service/routes/volumes.py", "service/sawmill_service/static")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))  # no line a request
    with tempfile.TemporaryDirectory(prefix="sawmill-viewer-") as name:
        store = Store.open(StorageSettings(data_folder=Path(name), database_url=None))
        fill(store, chosen.slices, chosen.size)
        with serving(store) as address:
            if chosen.serve:
                print(address, flush=True)
                threading.Event().wait()
            with httpx.Client(base_url=address, timeout=60) as client:
                measure_server(client, chosen.slices, chosen.moves)
            found = measure_browser(address, chosen.slices, chosen.size, chosen.moves)
    measurement.write({"viewer": found})


if __name__ == "__main__":
    main()
