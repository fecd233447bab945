"""The cost of a log's drift check to its sender in seconds, requests and bytes: by the rows' mean, by the stack.

    python benchmarks/drift_over_http.py [--repeats 10] [--views 20] [--rows 2500]

A service with a separate folder, as users start it, and one simulated scanner, calibrated from a phantom. A log is
sent as the float32 mean of its rows' line integrals, and once as uint16 counts. Of each the scan is posted, the drift
check is requested, and its answer is awaited: three requests. The log has 8 different rows,
over and over with noise of their own.
"""

import argparse
import io
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np
from http_latency import print_seconds

from sawmill_command import demo_client, examples
from sawmill_command.demo_client import Json
from sawmill_formats.output.scan_writer import write_raw_scan
from sawmill_tomography.projection.simulate import SimulatedStack

SLICES = 8


class Counted:
    """The bytes of requests and answers, bodies alone, and the number of requests."""

    def __init__(self, client: httpx.Client) -> None:
        self.sent = self.received = self.requests = 0
        client.event_hooks = {"request": [self._of_request], "response": [self._of_response]}

    def _of_request(self, request: httpx.Request) -> None:
        self.requests += 1
        self.sent += int(request.headers.get("content-length", 0))

    def _of_response(self, response: httpx.Response) -> None:
        self.received += len(response.read())


def calibrated(client: httpx.Client, folder: Path) -> str:
    """Create a scanner with an active calibration; return its id."""
    stack = folder / "phantom.h5"
    examples.write_mill_stack(stack, 360, examples.mill_slices(log_rows=0))
    scanner = demo_client.post(client, "/v1/scanners", json={"name": "line", "constants": vars(examples.SCANNER)})
    fields = {"scanner_id": scanner["id"], "data": "counts", "phantom_id": "l-shape"}
    scan = demo_client.upload(client, stack, lambda *_: None, **fields)
    asked = demo_client.post(client, "/v1/calibrations", json={"scan_id": scan["id"], "activate": True})
    demo_client.wait(client, asked["job_id"], lambda *_: None)
    return str(scanner["id"])


def checked(client: httpx.Client, content: bytes, **about: object) -> Json:
    """Run the drift check of one log: send the scan, request the check and wait for the answer."""
    scan = demo_client.post(client, "/v1/scans", params=about, content=content)
    drift = demo_client.post(client, "/v1/drifts", json={"scan_id": scan["id"]})
    while drift["state"] in {"queued", "running"}:
        drift = demo_client.get(client, f"/v1/drifts/{drift['id']}?wait=55")
    assert drift["state"] == "succeeded", drift
    return drift


def mean_of(log: SimulatedStack, rows: int, random: np.random.Generator) -> bytes:
    """Write a NPY file of the mean over this number of rows, with noise that differs from log to log."""
    flat, dark = log.flats.mean(axis=0), log.darks.mean(axis=0)
    transmission = np.maximum(log.counts - dark, 1.0) / (flat - dark)
    lines = -np.log(transmission)
    noise = np.sqrt(np.mean(1.0 / (transmission * flat), axis=1) / rows)
    mean = io.BytesIO()
    np.save(mean, (lines.mean(axis=1) + noise * random.standard_normal(noise.shape)).astype(np.float32))
    return mean.getvalue()


def write_counts(path: Path, log: SimulatedStack, rows: int, random: np.random.Generator) -> None:
    """Write a NXtomo file of this number of rows."""
    shown = np.arange(rows) % SLICES
    counts = log.counts[:, shown]
    write_raw_scan(
        path,
        counts=np.clip(counts + random.standard_normal(counts.shape, np.float32) * 50, 0, 65535).astype(np.uint16),
        flats=log.flats[:, shown],
        darks=log.darks[:, shown],
        angles_rad=examples.full_turn(len(counts)),
        detector_pitch_mm=examples.SCANNER.detector_pitch_mm,
        row_pitch_mm=None,
    )


def measure(client: httpx.Client, name: str, contents: list[bytes], **about: object) -> None:
    """Print what one check takes, and what it found."""
    counted, seconds, found = Counted(client), list[float](), list[Json]()
    for content in contents:
        started = time.perf_counter()
        found.append(checked(client, content, **about)["result"])
        seconds.append(time.perf_counter() - started)
    client.event_hooks = {}
    checks = len(contents)
    print_seconds(f"{name}, {checks} checks", seconds)
    print_seconds("of that the fit", [each["time_s"] for each in found])
    print(f"  a check: {counted.requests / checks:.1f} requests, {counted.sent / checks:,.0f} bytes sent, ", end="")
    print(f"{counted.received / checks:,.0f} received")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10, help="logs that are sent as their mean")
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--rows", type=int, default=2500)
    chosen = parser.parse_args()
    random = np.random.default_rng(17)
    slices = [examples.mill_log().slice_at(200.0 + 40.0 * row) for row in range(SLICES)]
    log = examples.mill_stack(chosen.views, slices)
    step = 360.0 / chosen.views
    with tempfile.TemporaryDirectory(prefix="sawmill-drift-") as name:
        folder = Path(name)
        means = [mean_of(log, chosen.rows, random) for _ in range(chosen.repeats + 1)]
        stack = folder / "log.h5"
        write_counts(stack, log, chosen.rows, random)
        with demo_client.running_service(folder) as client:
            scanner_id = calibrated(client, folder)
            as_mean = {"data": "line-integrals", "averaged_rows": chosen.rows, "angles_deg": f"{step / 2}:{step}"}
            checked(client, means.pop(), scanner_id=scanner_id, **as_mean)  # the first job of a kind compiles
            measure(client, "the mean of rows", means, scanner_id=scanner_id, **as_mean)
            measure(client, "the stack", [stack.read_bytes()], scanner_id=scanner_id, data="counts")


if __name__ == "__main__":
    main()
