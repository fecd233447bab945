"""The API on SQLite while another process holds the write lock, and with many posts at once."""

import subprocess
import sys
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from uuid import uuid4

import httpx
import pytest
from live_service import serving, wait_until
from small_scanner import SCANNER
from write_lock import write_lock

pytestmark = pytest.mark.slow

CLIENTS = 45  # more than the API has threads (40)
READS = 5


def test_writers_are_refused_and_readers_are_answered_while_the_lock_is_held(tmp_path, offline):
    # All these clients have one address, and it is not their number that they are to be refused for.
    environment = {**offline.variables, "SAWMILL_CHANGE_RATE_LIMIT": "10000/minute"}
    with serving(tmp_path, environment, "--no-examples", "--workers", "0") as service:
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


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "busy_loops"), [(200, 0), (60, 4)])
def test_of_many_posts_at_once_none_is_refused(tmp_path, offline, phantom_scan, number, busy_loops):
    with serving(tmp_path, offline.variables, "--no-examples", "--workers", "1") as service, ExitStack() as running:
        scan = service.upload_phantom(phantom_scan())
        for _ in range(busy_loops):
            loop = running.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            running.callback(loop.kill)
        together = threading.Barrier(number, timeout=60)

        def post(seed: int) -> int:
            together.wait()
            ask = {"scan_id": scan["id"], "seed": seed}
            headers = {"Idempotency-Key": str(uuid4())}
            return client.post("/v1/calibrations", json=ask, headers=headers).status_code

        limits = httpx.Limits(max_connections=number)
        with (
            httpx.Client(base_url=service.client.base_url, limits=limits, timeout=120.0) as client,
            ThreadPoolExecutor(number) as pool,
        ):
            statuses = Counter(pool.map(post, range(number)))
    assert statuses == {202: number}
