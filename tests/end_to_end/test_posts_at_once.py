"""Many posts at once to a service on SQLite that nothing disturbs but the load."""

import subprocess
import sys
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from uuid import uuid4

import httpx
import pytest

from sawmill_tomography.geometry.geometry import Theta

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize(("number", "busy_loops"), [(200, 0), (60, 4)])
def test_none_is_refused(tmp_path, offline, serve, write_phantom_scan, number, busy_loops):
    write_phantom_scan(tmp_path / "scan.h5", Theta(0.7, 728.0, -254.0, -37.0, -0.21))
    with serve(tmp_path, offline.variables, "--no-examples", "--workers", "1") as service, ExitStack() as running:
        scan = service.upload(
            (tmp_path / "scan.h5").read_bytes(),
            scanner_id=service.create_scanner(),
            data="counts",
            phantom_id="l-shape",
        )
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
