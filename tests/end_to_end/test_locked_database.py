"""The API while another process holds SQLite's write lock."""

import threading
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from live_service import wait_until
from small_scanner import SCANNER
from write_lock import write_lock

pytestmark = pytest.mark.slow

CLIENTS = 45  # more than the API has threads (40)
READS = 5


def test_writers_are_refused_and_readers_are_answered_while_the_lock_is_held(tmp_path, offline, serve):
    # All these clients have one address, and it is not their number that they are to be refused for.
    environment = {**offline.variables, "SAWMILL_CHANGE_RATE_LIMIT": "10000/minute"}
    with serve(tmp_path, environment, "--no-examples", "--workers", "0") as service:
        scanner_id = service.create_scanner()
        read = threading.Event()

        def write() -> list[httpx.Response]:
            """Write at least once, and again and again until the reader has been answered."""
            answers = []
            while not answers or not read.is_set():
                query = {"scanner_id": scanner_id, "data": "counts"}
                answers.append(service.client.post("/v1/scans", params=query, content=b"a scan"))
            return answers

        with ThreadPoolExecutor(CLIENTS) as pool, write_lock(service.data / "sawmill.db"):
            writers = [pool.submit(write) for _ in range(CLIENTS)]
            try:
                statuses = [service.client.get("/v1/scanners").status_code for _ in range(READS)]
            finally:
                read.set()
            written = [answer for writer in writers for answer in writer.result()]
        # The lock is released here: every answer came before. A refused client comes back.
        scanner = {"name": "Line 3", "constants": vars(SCANNER)}
        wait_until(lambda: service.client.post("/v1/scanners", json=scanner).is_success)
    assert statuses == [200] * READS
    assert {response.status_code for response in written} == {503}
    assert {response.json()["code"] for response in written} == {"storage-unavailable"}
    assert {int(response.headers["retry-after"]) > 0 for response in written} == {True}
