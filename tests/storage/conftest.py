"""A store in a temporary folder, and what is needed to fill it."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.scanners import Scanner, ScannerSpec
from sawmill_worker.contracts.scans import Scan, ScanSpec
from sawmill_worker.storage.jobs import Claim
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import DataKind

CONSTANTS = {"source_to_cor_mm": 859.46, "num_detector_pixels": 768, "detector_pitch_mm": 1.5}
THETA = {
    "initial_angle_rad": 2.5,
    "detector_to_cor_mm": 714.7,
    "source_shift_mm": 319.9,
    "detector_shift_mm": 43.7,
    "detector_tilt": 0.281,
}
FRAME = {
    "psi_rad": 2.9,
    "source_distance_mm": 917.1,
    "source_to_detector_mm": 1619.3,
    "cor_column_mm": -209.1,
    "tilt_rad": -0.083,
    "magnification": 1.766,
}


class TestClock:
    """A clock that moves only when told."""

    __test__ = False

    def __init__(self) -> None:
        self.now = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now

    def advance(self, **step: float) -> None:
        self.now += timedelta(**step)


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def settings(tmp_path: Path) -> StorageSettings:
    return StorageSettings(data_folder=tmp_path / "data", database_url=None)


@pytest.fixture
def store(settings: StorageSettings) -> Iterator[Store]:
    opened = Store.open(settings)
    yield opened
    opened.close()


@pytest.fixture
def scanner(store: Store) -> Scanner:
    return store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS)))


@pytest.fixture
def upload(scanner: Scanner) -> Callable[..., Scan]:
    """Accept a scan of four bytes."""

    def accept(store: Store, *, phantom_id: str | None = "l-shape", scan_id: str | None = None) -> Scan:
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS, phantom_id=phantom_id)
        return store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10), scan_id=scan_id)

    return accept


def reading() -> dict[str, Any]:
    return {
        "format": "NXtomo",
        "shape": {"views": 20, "rows": 1, "detector": 768},
        "angular_range_deg": (0.0, 342.0),
        "remarks": ["one invalid frame left out"],
    }


def calibration_result(verdict: str = "pass") -> dict[str, Any]:
    return {
        "theta": THETA,
        "theta_twin": None,
        "source_frame": FRAME,
        "standard_deviation": {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)},
        "covariance": [[0.0] * 5] * 5,
        "unconstrained_source_distance_mm": 917.1,
        "scale_uncertainty_mm": 0.9,
        "scale_ray_error_mm": 0.05,
        "predicted_ray_error_mm": {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0},
        "handedness": "as-drawn",
        "rotation": "as-given",
        "hypotheses": [],
        "phantom_position_mm": (0.0, 0.0),
        "gain": 1.0,
        "offset": 0.0,
        "residual": {"rms": 0.1, "relative": 0.001},
        "status": "calibrated",
        "verdict": verdict,
        "reasons": [],
        "scanner": CONSTANTS,
        "phantom": "L-shape",
        "views": 20,
        "rows": (0, 1),
        "search": {
            "method": "default",
            "seed": 7,
            "evaluations": 1,
            "generations": 1,
            "best_value": 0.0,
            "converged": True,
            "message": "converged",
        },
        "timing_s": {"total": 1.0, "search": 0.5, "refine": 0.4, "uncertainty": 0.1},
        "software_version": "0",
        "input_sha256": "0" * 64,
    }


def reconstruction_result() -> dict[str, Any]:
    return {
        "shape": (1, 16, 16),
        "pixel_mm": 1.0,
        "unit": "1/mm",
        "value_range": (0.0, 1.0),
        "theta": THETA,
        "rotation": "as-given",
        "handedness": "as-drawn",
        "views": 20,
        "rows": (0, 1),
        "time_s": 0.1,
        "software_version": "0",
        "input_sha256": "0" * 64,
    }


def plan_result() -> dict[str, Any]:
    known = calibration_result()
    kept = (
        "theta",
        "source_frame",
        "standard_deviation",
        "covariance",
        "predicted_ray_error_mm",
        "scale_uncertainty_mm",
        "scale_ray_error_mm",
        "scanner",
        "phantom",
        "software_version",
    )
    return {name: known[name] for name in kept} | {"noise_mm": 2.1, "views_cut_off": 0, "views": 20, "noise": 0.02}


def drift_result() -> dict[str, Any]:
    three = {"cor_column_mm": -209.1, "tilt_rad": -0.083, "source_to_detector_mm": 1619.3}
    changes = ("change", "change_standard_deviation", "significance")
    return {
        "measured": three,
        "standard_deviation": dict.fromkeys(three, 0.1),
        "covariance": [[0.0] * 3] * 3,
        "calibrated": three,
        **dict.fromkeys(changes, dict.fromkeys(three, 0.1)),
        "moved": False,
        "ray_change_mm": 0.01,
        "ray_change_uncertainty_mm": 0.02,
        "radius_mm": 150.0,
        "tolerance_mm": 0.5,
        "within_tolerance": True,
        "reason": "nothing moved",
        "not_seen": ["R"],
        "rotation": "as-given",
        "rotation_ratio": 60.0,
        "rotation_decided": True,
        "relative_residual": 0.01,
        "adjustments": [],
        "scanner": CONSTANTS,
        "views": 120,
        "rows": (0, 1),
        "time_s": 0.1,
        "software_version": "0",
        "input_sha256": "0" * 64,
    }


RESULTS: dict[JobKind, Callable[[], dict[str, Any]]] = {
    JobKind.INGEST: reading,
    JobKind.CALIBRATE: calibration_result,
    JobKind.RECONSTRUCT: reconstruction_result,
    JobKind.PLAN: plan_result,
    JobKind.DRIFT: drift_result,
    JobKind.TRACE_PHANTOM: lambda: {
        "name": "traced",
        "shapes": [{"kind": "disc", "center_mm": (0, 0), "radius_mm": 50}],
    },
}


@pytest.fixture
def finish() -> Callable[..., Claim]:
    """Do the oldest job as a worker would, without any science."""

    def do(store: Store, **changes: Any) -> Claim:
        claim = store.jobs.claim("test", lease_s=60)
        assert claim is not None
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        (output / "result").write_text(f"attempt {claim.attempt}")
        store.jobs.succeed(claim, RESULTS[claim.job.kind]() | changes, output)
        return claim

    return do


@pytest.fixture
def ready_scan(store: Store, upload: Callable[..., Scan], finish: Callable[..., Claim]) -> Scan:
    accepted = upload(store)
    finish(store)
    return store.scans.get(accepted.id)
