"""The requested jobs: tiny, of every kind that mills use, each with one right answer."""

import hashlib
import io
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import httpx
import numpy as np

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection.simulate import simulate_sinogram

Json = dict[str, Any]
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)
# Half of the jobs are plans, which take milliseconds: a fresh process is what the rest of the price is for.
MIX = ("plan",) * 5 + ("phantom scan", "log scan", "calibration", "drift check", "reconstruction")
PLANS = 2  # kinds of them
BASE = ("phantom scan", "calibration", "log scan")
_DIFFERS = {"id", "created_at", "links", "at", "timing_s", "time_s", "sha256", "input_sha256"}


@dataclass(frozen=True)
class Work:
    """A kind of request: those of one name have one right answer."""

    name: str
    plural: str  # of the answer's place: /v1/<plural>/<id>, and <plural>/<id>/ in the data folder


@dataclass(frozen=True)
class Accepted:
    work: Work
    subject_id: str
    job_id: str


@cache
def phantom_scan() -> bytes:
    """Return 20 views of the phantom, line integrals, as an NPY file."""
    return _scan(L_SHAPE.of_density(SAPWOOD_PER_MM), 20)


@cache
def log_scan() -> bytes:
    return _scan(LogModel.random(4).slice_at(120.0).moved(5.0, -3.0), 120)


def _scan(slice_: Any, views: int) -> bytes:
    angles = (np.arange(views) + 0.5) * TAU / views
    sinogram = simulate_sinogram(slice_, FanBeamGeometry(SCANNER, THETA, angles), noise=0.01, seed=4)
    file = io.BytesIO()
    np.save(file, sinogram[:, None].astype(np.float32))
    return file.getvalue()


class Asker:
    """Asks for jobs as patiently as a good client, until they are accepted, and lists them."""

    def __init__(self, client: httpx.Client, wait_s: float) -> None:
        self._client, self._wait_s = client, wait_s
        self.accepted: list[Accepted] = []
        self._base: dict[str, str] = {}

    def prepare(self) -> None:
        """Create a scanner, and what the other jobs need."""
        self._base["scanner"] = self._post("/v1/scanners", json={"name": "line", "constants": vars(SCANNER)})["id"]
        for name in BASE:
            self._base[name] = self.ask(name).subject_id

    def ask(self, name: str, number: int = 0) -> Accepted:
        """Request one of the mix; `number` distinguishes plans."""
        plural, options = self._request(name, number)
        answer = self._post("/v1/phantoms/l-shape/plans" if plural == "plans" else f"/v1/{plural}", **options)
        work = Work(f"{name} {number % PLANS}" if name == "plan" else name, plural)
        self.accepted.append(Accepted(work, answer["id"], answer["job_id"]))
        return self.accepted[-1]

    def _request(self, name: str, number: int) -> tuple[str, Json]:
        base, theta = self._base, vars(THETA)
        scan = {"scanner_id": base["scanner"], "data": "line-integrals"}
        match name:
            case "phantom scan":
                spec = {**scan, "phantom_id": "l-shape", "angles_deg": "9:18"}
                return "scans", {"params": spec, "content": phantom_scan()}
            case "log scan":
                return "scans", {"params": {**scan, "angles_deg": "1.5:3"}, "content": log_scan()}
            case "calibration":
                return "calibrations", {"json": {"scan_id": base["phantom scan"]}}
            case "drift check":
                return "drifts", {"json": {"scan_id": base["log scan"], "calibration_id": base["calibration"]}}
            case "reconstruction":
                ask = {"scan_id": base["log scan"], "theta": theta, "method": "fbp", "size": 64}
                return "reconstructions", {"json": ask}
            case _:
                ask = {"scanner_id": base["scanner"], "views": 12 + number % PLANS, "theta": theta}
                return "plans", {"json": ask}

    def _post(self, path: str, **options: Any) -> Json:
        deadline = time.monotonic() + self._wait_s
        while True:
            try:
                answer = self._client.post(path, **options)
            except httpx.TransportError:
                status = 0
            else:
                if answer.is_success:
                    return dict(answer.json())
                status = answer.status_code
                assert status >= 500, answer.text
            assert time.monotonic() < deadline, f"POST {path} was not accepted for {self._wait_s:g} s: {status}"
            time.sleep(0.2)


def answer_of(client: httpx.Client, data: Path, accepted: Accepted) -> str:
    """Return an answer for comparison: everything but ids and times, its files included."""
    plural, subject_id = accepted.work.plural, accepted.subject_id
    document = client.get(f"/v1/{plural}/{subject_id}").raise_for_status().json()
    files = {path.name: _numbers(path) for path in sorted((data / plural / subject_id).glob("*.h5"))}
    return json.dumps({"answer": _without_names(document), "files": files}, sort_keys=True)


def _without_names(value: Any) -> Any:
    if isinstance(value, Mapping):
        kept = {name: item for name, item in value.items() if name not in _DIFFERS and not name.endswith("_id")}
        return {name: _without_names(item) for name, item in kept.items()}
    return [_without_names(item) for item in value] if isinstance(value, list) else value


def _numbers(path: Path) -> dict[str, str]:
    found: dict[str, str] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim and item.dtype.kind in "biuf":
            found[name] = hashlib.sha256(np.ascontiguousarray(item[()]).tobytes()).hexdigest()

    with h5py.File(path, "r") as file:
        file.visititems(note)
    return found
