"""A service on a real store in a temporary folder, and a data folder as a fresh installation has it."""

import asyncio
import io
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, redirect_stderr
from dataclasses import dataclass, field
from functools import partial, partialmethod
from pathlib import Path
from typing import Any, Literal

import h5py
import httpx
import numpy as np
import pytest
import results
import scan_files
from asgi import asynchronous, scope_of
from emptied_databases import PostgresDatabases
from plain_logs import log_plainly
from scan_files import new_volume

from sawmill_contracts import fixed_pairs, kinds, pair_logs
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_formats.nexus import PACKED
from sawmill_formats.output.calibration_file import NamedArray
from sawmill_formats.output.calibration_file import write_calibration as write_calibration_file
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import KeyRequest, NewKey, Scope
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.contracts.webhooks import WebhookRequest
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.verified_results import compute_digest
from sawmill_platform.jobs.job_store import Claim
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_platform.workers.logs import configure_logs
from sawmill_service.app import create_app
from sawmill_service.http.document.openapi_document import Application
from sawmill_service.settings import ServiceSettings
from sawmill_store.examples import LOG, LOG_FILES, PAIR_FILES, PAIRS
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, Disc, ReconstructionMethod

VIEWS, ROWS, CELLS = 12, 4, 16
SLICES, SIDE = 3, 32


@dataclass
class Client:
    app: Application
    headers: dict[str, str] = field(default_factory=dict)

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        async def send() -> httpx.Response:
            async with asynchronous(self.app, **self.headers) as client:
                return await client.request(method, path, **options)

        return asyncio.run(send())

    def follow(self, path: str, heard: Callable[[str], object]) -> str:
        """Read a stream to its end, and show each block in a thread as it comes: the stream goes on after that."""
        blocks, asked = list[str](), [{"type": "http.request", "body": b"", "more_body": False}]

        async def receive() -> dict[str, Any]:
            return asked.pop() if asked else await asyncio.Future()

        async def send(message: dict[str, Any]) -> None:
            for block in message.get("body", b"").decode().split("\n\n")[:-1]:
                blocks.append(block)
                await asyncio.to_thread(heard, block)

        asyncio.run(asyncio.wait_for(self.app(scope_of(path), receive, send), 60))
        return "\n\n".join([*blocks, ""])

    def bring(self, scope: Scope, *, name: str = "visitor", **changes: Any) -> NewKey:
        key = self.app.state.store.keys.create(KeyRequest(name=name, scope=scope, **changes))
        self.headers["Authorization"] = f"Bearer {key.secret}"
        return key

    get, post = partialmethod(request, "GET"), partialmethod(request, "POST")
    put, delete = partialmethod(request, "PUT"), partialmethod(request, "DELETE")


@pytest.fixture(scope="session", autouse=True)
def _one_document() -> Iterator[None]:
    """The OpenAPI document is every application's: a second of work, done once."""
    made: list[dict[str, Any]] = []
    make = Application.openapi

    def openapi(app: Application) -> dict[str, Any]:
        made[:] = made or [make(app)]
        return made[0]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Application, "openapi", openapi)
        yield


@pytest.fixture(scope="session")
def seeded_data(empty_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeded") / "data"
    shutil.copytree(empty_data, folder)
    opened = Store(StorageSettings(data_folder=folder, database_url=None))
    seed(opened, FakeWorker(opened))
    opened.close()
    return folder


@pytest.fixture
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    """A store of the test's own, with the examples where the test asks for `seeded`."""
    template: Path = request.getfixturevalue("seeded_data" if "seeded" in request.fixturenames else "empty_data")
    shutil.copytree(template, tmp_path / "data")
    opened = Store(StorageSettings(data_folder=tmp_path / "data", database_url=None))
    yield opened
    opened.close()


@pytest.fixture
def postgresql_store(postgres: PostgresDatabases, tmp_path: Path) -> Iterator[Store]:
    with postgres.database() as url:
        opened = Store.open(StorageSettings(data_folder=tmp_path / "beside-postgresql", database_url=url))
        seed(opened, FakeWorker(opened))
        yield opened
        opened.close()


@pytest.fixture
def woken() -> list[str]:
    return []


@pytest.fixture
def log_text() -> Iterator[Callable[[Literal["console", "json"]], io.StringIO]]:
    """Starts this process's log in a format, and gives what is written from then on."""

    def start(log_format: Literal["console", "json"]) -> io.StringIO:
        text = redirected.enter_context(redirect_stderr(io.StringIO()))
        configure_logs(log_format)
        return text

    with ExitStack() as redirected:
        yield start
    log_plainly()


@pytest.fixture
def log_lines(log_text: Callable[[str], io.StringIO]) -> Callable[[], list[dict[str, Any]]]:
    """Gives what has been logged since it was asked last."""
    text = log_text("json")

    def lines() -> list[dict[str, Any]]:
        written = text.getvalue().splitlines()
        text.seek(0)
        text.truncate()
        return [json.loads(line) for line in written]

    return lines


@pytest.fixture(scope="session")
def settings() -> ServiceSettings:
    """Made once: to look for forty variables takes longer than many a request."""
    sizes = {"max_upload_bytes": 100_000, "max_picture_bytes": 50_000, "max_json_bytes": 20_000}
    return ServiceSettings(**sizes, event_poll_s=0.01, webhook_destinations=["alarms.mill.example", "127.0.0.1"])


@pytest.fixture
def client(store: Store, settings: ServiceSettings, woken: list[str]) -> Client:
    return Client(create_app(settings, store, woken.append))


@pytest.fixture
def limited(client: Client, store: Store) -> Callable[..., Client]:
    def limit(**bounds: Any) -> Client:
        client.app = create_app(ServiceSettings(**bounds), store, print)
        return client

    return limit


@pytest.fixture
def worker(store: Store) -> "FakeWorker":
    return FakeWorker(store)


@pytest.fixture
def seeded(client: Client) -> Client:
    return client


@pytest.fixture
def _another_is_active(store: Store, worker: "FakeWorker") -> None:
    """A second calibration is active: to activate `example` is to go back."""
    store.calibrations.accept(CalibrationRequest(scan_id="example"), identifier="another")
    worker.finish_calibration()
    store.calibrations.activate("another", "by hand")


@pytest.fixture
def newer(store: Store, worker: "FakeWorker") -> str:
    """A calibration that nobody has accepted yet, newer than the active one, which is `example`."""
    identifier = store.calibrations.accept(CalibrationRequest(scan_id="example"), identifier="newer").id
    worker.finish_calibration()
    return identifier


@dataclass
class FakeWorker:
    store: Store

    def claim(self) -> Claim:
        claim = self.store.jobs.claim("test")
        assert claim is not None
        return claim

    def finish_scan(self, lines: np.ndarray | None = None, **changes: Any) -> None:
        lines = projections() if lines is None else lines
        shape = dict(zip(("views", "rows", "detector"), lines.shape, strict=True))
        result = {"format": "NPZ", "shape": shape, "angular_range_deg": (0.0, 330.0)} | changes
        self._finish(partial(write_scan, lines=lines), result)

    def finish_tracing(self) -> None:
        outline = {"kind": "polygon", "vertices_mm": [[-100, -150], [100, -150], [100, 150], [-100, 150]]}
        self._finish(lambda _: None, {"name": "ell", "shapes": [outline]})

    def finish_calibration(self, **changes: Any) -> None:
        self._finish(write_calibration, calibration_result(**changes))

    def finish_reconstruction(self, volume: np.ndarray | None = None) -> None:
        volume = make_volume() if volume is None else volume
        self._finish(partial(write_reconstruction, volume=volume), reconstruction_result(shape=volume.shape))

    def finish_sparse_reconstruction(self, volume: np.ndarray | None = None) -> None:
        volume = make_volume() if volume is None else volume
        result = reconstruction_result(has_deviation=True, shape=volume.shape)
        self._finish(partial(write_sparse_reconstruction, volume=volume), result)

    def _answer(self, result: Callable[..., dict[str, Any]], **changes: Any) -> None:
        self._finish(lambda _: None, result(**changes))

    finish_drift = partialmethod(_answer, results.drift_result)
    finish_inspection = partialmethod(_answer, results.inspection_result)
    finish_plan = partialmethod(_answer, results.plan_result)
    finish_fixed_pairs = partialmethod(_answer, results.fixed_pairs_result)
    finish_pair_log = partialmethod(_answer, results.pair_log_result)

    def _finish(self, write: Callable[[Path], None], result: dict[str, Any]) -> None:
        claim = self.claim()
        output = self.store.files.make_attempt_folder(claim.job_id, claim.attempt)
        write(output)
        _, file = self.store.jobs.check_output(claim.job.kind, result, output)
        sha256 = None if file is None else compute_digest(file)
        self.store.jobs.succeed(claim, results.answer_of(claim.job.kind, result), output, sha256=sha256)


def seed(store: Store, worker: FakeWorker) -> None:
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=CELLS, detector_pitch_mm=1.5)
    spec = ScannerSpec(name="Line <2>", constants=constants)
    for scanner_id in ("example", "example-spare"):
        store.scanners.create(spec, scanner_id=scanner_id)
    drawing = PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)])
    store.phantoms.create(drawing, phantom_id="example-spare")
    scan = ScanSpec(scanner_id="example", data=DataKind.LINE_INTEGRALS, phantom_id="l-shape")
    for scan_id in ("example", "example-spare"):
        store.scans.accept(scan, store.files.receive([b"original"], max_bytes=100), scan_id=scan_id)
        worker.finish_scan()
    store.calibrations.accept(CalibrationRequest(scan_id="example", activate=True), identifier="example")
    worker.finish_calibration()
    dense = ReconstructionRequest(scan_id="example", method=ReconstructionMethod.FBP)
    store.reconstructions.accept(dense, identifier="example")
    worker.finish_reconstruction()
    sparse = ReconstructionRequest(scan_id="example", method=ReconstructionMethod.TIKHONOV)
    store.reconstructions.accept(sparse, identifier="example-sparse")
    worker.finish_sparse_reconstruction()
    store.plans.accept(
        PlanRequest(scanner_id="example", views=20), identifier="example", given={"phantom_id": "l-shape"}
    )
    worker.finish_plan()
    store.drifts.accept(DriftRequest(scan_id="example"), identifier="example")
    worker.finish_drift()
    for inspection_id in ("example", "example-spare", *PAIR_FILES, *LOG_FILES):
        received = store.files.receive([b"original"], max_bytes=100)
        store.inspections.accept_file(InspectionOptions(), received, identifier=inspection_id)
        worker.finish_inspection()
    for declared, identifier in ((fixed_pairs.DECLARATION, PAIRS), (pair_logs.DECLARATION, LOG)):
        ask = declared.ask.model_validate(declared.to_ask.example["body"])
        store.asked(declared).accept(ask, identifier=identifier)
        getattr(worker, f"finish_{declared.noun.replace('-', '_')}")()
    for upload_id in ("example", "example-spare"):
        store.uploads.create(UploadRequest(size_bytes=2**20), UploadQuota(2, 2**21, 2**30), identifier=upload_id)
    for schedule_id in ("example", "example-spare"):
        store.schedules.create(ScheduleSpec(scanner_id="example", cron="30 5 * * 1-6"), schedule_id=schedule_id)
    for webhook_id in ("example", "example-spare"):
        store.webhooks.create(WebhookRequest(url="http://127.0.0.1:9/", enabled=False), webhook_id=webhook_id)
    done = {"kind": kinds.CALIBRATE, "state": JobState.SUCCEEDED, "subject_id": "example"}
    with store.database.write() as session:
        session.add(JobRow(id="example", created_at=store.database.now(), **done))
    examples = store.files.folder / "examples"
    examples.mkdir()
    np.savez(examples / "phantom-scan.npz", projections=np.ones((3, 1, CELLS), np.float32))


def projections() -> np.ndarray:
    """(views, rows, detector), another constant in each row."""
    return np.broadcast_to(np.linspace(0.1, 0.9, ROWS, dtype=np.float32)[None, :, None], (VIEWS, ROWS, CELLS)).copy()


@pytest.fixture
def volume() -> np.ndarray:
    return make_volume()


def make_volume() -> np.ndarray:
    """(slices, x, y), rising along x by a step a slice."""
    ramp = np.linspace(0.0, 1.0, SIDE, dtype=np.float32)[None, :, None]
    return np.broadcast_to(ramp, (SLICES, SIDE, SIDE)) * np.arange(1, SLICES + 1, dtype=np.float32)[:, None, None]


def write_scan(folder: Path, lines: np.ndarray) -> None:
    about = {"angles_rad": np.deg2rad(np.arange(len(lines)) * 30.0), "detector_pitch_mm": 1.5, "row_pitch_mm": None}
    scan_files.write_scan(folder / "scan.h5", line_integrals=lines, **about)


def write_calibration(folder: Path) -> None:
    arrays = {
        "sinogram": np.ones((VIEWS, CELLS), np.float32),
        "model": np.zeros((VIEWS, CELLS), np.float32),
        "residual": np.ones((VIEWS, CELLS), np.float32),
        "angles_rad": np.linspace(0.0, 5.8, VIEWS),
        "phantom_image": np.eye(SIDE, dtype=np.float32),
        "phantom_field_mm": np.array(200.0),
        "phantom_outlines_mm": np.array([(-50.0, -50.0), (50.0, 0.0), (0.0, 50.0), (-50.0, -50.0)]),
        "search_history": np.array([(1.0, 0.5), (2.0, 0.001)]),
        "log_row": np.array(3),
        "log_field_mm": np.array(345.0),
        "log_after": np.hypot(*np.mgrid[-1:1:32j, -1:1:32j]).astype(np.float32),
        "log_before": np.hypot(*np.mgrid[-1:1:32j, -0.5:1.5:32j]).astype(np.float32),
    }
    write_calibration_file(
        folder / "result.h5",
        calibration_result(adjustments=[], comparison=None),
        {name: NamedArray(values, "1", "") for name, values in arrays.items()},
        software_version="0",
        input_sha256="0" * 64,
    )


def write_reconstruction(folder: Path, volume: np.ndarray) -> None:
    with new_volume(folder / "volume.h5", volume.shape, pixel_mm=1.25, row_pitch_mm=20.0) as volume_file:
        volume_file.write(0, volume)


def write_sparse_reconstruction(folder: Path, volume: np.ndarray) -> None:
    """With all that only some methods leave, and the deviations that an earlier version wrote."""
    alphas = np.geomspace(1e-3, 1e3, 31)
    with new_volume(folder / "volume.h5", volume.shape, pixel_mm=1.25, row_pitch_mm=20.0) as volume_file:
        volume_file.write(0, volume)
        norms = {"residual_norms": 1.0 + alphas, "solution_norms": 1.0 / alphas, "gcv": 1.0 + alphas}
        volume_file.note_alpha_curve({"alphas": alphas, **norms, "alpha": np.array(1.0)})
    with h5py.File(folder / "volume.h5", "r+") as file:
        stored = {"chunks": (1, *volume.shape[1:]), **PACKED, "fletcher32": True}
        file.create_dataset("entry/reconstruction/data_errors", data=np.float32(0.1) * volume, **stored)
        file["entry/reconstruction/data_errors"].attrs["units"] = "1/mm"


def calibration_result(**changes: Any) -> dict[str, Any]:
    known = results.calibration_result()
    deviations = {name: dict.fromkeys(values) for name, values in known["standard_deviation"].items()}
    scanner = {**results.CONSTANTS, "num_detector_pixels": CELLS}
    return known | {"standard_deviation": deviations, "scanner": scanner, "views": VIEWS, "rows": (0, ROWS)} | changes


def reconstruction_result(**changes: Any) -> dict[str, Any]:
    shape = {"shape": (SLICES, SIDE, SIDE), "pixel_mm": 1.25, "value_range": (0.0, 3.0)}
    return results.reconstruction_result(**shape, views=VIEWS, rows=(0, SLICES)) | changes
