"""The API while another process holds SQLite's write lock."""

import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from small_scanner import SCANNER
from write_lock import write_lock

pytestmark = pytest.mark.slow

CLIENTS = 60  # more than the API has threads (40)
LOCKED_S = 8.0  # longer than any request may wait
LONGEST_S = 5.0


def test_writers_are_refused_within_five_seconds_and_readers_are_answered(tmp_path, offline, serve):
    # All these clients have one address, and it is not their number that they are to be refused for.
    environment = {**offline.variables, "SAWMILL_CHANGE_RATE_LIMIT": "10000/minute"}
    with serve(tmp_path, environment, "--no-examples", "--workers", "0") as service:
        scanner_id = service.create_scanner()
        until = time.monotonic() + LOCKED_S

        def write() -> list[tuple[httpx.Response, float]]:
            answers = []
            while time.monotonic() < until:
                started = time.monotonic()
                response = service.client.post(
                    "/v1/scans", params={"scanner_id": scanner_id, "data": "counts"}, content=b"a scan"
                )
                answers.append((response, time.monotonic() - started))
                time.sleep(0.2)
            return answers

        def read() -> list[float]:
            waits = []
            while time.monotonic() < until:
                started = time.monotonic()
                assert service.client.get("/v1/scanners").status_code == 200
                waits.append(time.monotonic() - started)
                time.sleep(0.2)
            return waits

        with ThreadPoolExecutor(CLIENTS + 1) as pool, write_lock(service.data / "sawmill.db"):
            reading = pool.submit(read)
            written = [answer for writer in [pool.submit(write) for _ in range(CLIENTS)] for answer in writer.result()]
            read_waits = reading.result()
        # A refused client comes back; at the lock's very end a last writer may be before it.
        _create_within(5.0, service)
    statuses = {response.status_code for response, _ in written}
    assert statuses == {503}, statuses
    refused = written[0][0]
    assert refused.json()["code"] == "storage-unavailable"
    assert {int(response.headers["retry-after"]) > 0 for response, _ in written} == {True}
    assert max(seconds for _, seconds in written) < LONGEST_S
    assert max(read_waits) < LONGEST_S
    assert sorted(read_waits)[len(read_waits) // 2] < 0.5  # those that come later find free threads


def _create_within(seconds: float, service) -> None:
    deadline = time.monotonic() + seconds
    scanner = {"name": "Line 3", "constants": vars(SCANNER)}
    while (answer := service.client.post("/v1/scanners", json=scanner)).status_code == 503:
        assert time.monotonic() < deadline, answer.text
        time.sleep(0.2)
    assert answer.is_success, answer.text
