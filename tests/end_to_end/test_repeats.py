"""A real service that gets one request fifty times at once, and is killed meanwhile: one scan, and one answer."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

pytestmark = pytest.mark.slow
AT_ONCE = 50  # more than the API has threads


def send(service, scanner_id, key, start):
    """The answer, or None where the service was killed before it."""
    path, headers = f"/v1/scans?scanner_id={scanner_id}&data=counts", {"Idempotency-Key": key}
    start.wait()
    try:
        return service.client.post(path, content=b"a scan", headers=headers)
    except httpx.TransportError:
        return None


def at_once(pool, service, scanner_id, key):
    start = threading.Barrier(AT_ONCE)
    return [pool.submit(send, service, scanner_id, key, start) for _ in range(AT_ONCE)]


def test_fifty_at_once_and_a_kill_make_one_scan(serve, offline, tmp_path):
    environment, flags = offline.variables, ("--no-examples", "--workers", "0")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        with serve(tmp_path, environment, *flags) as service:
            scanner_id = service.create_scanner()
            answers = [future.result() for future in at_once(pool, service, scanner_id, "whole")]
            assert {answer.status_code for answer in answers} == {202}, [answer.text for answer in answers]
            assert len({(answer.content, answer.headers["Location"]) for answer in answers}) == 1
            assert sum("Idempotency-Replayed" in answer.headers for answer in answers) == AT_ONCE - 1
            killed = at_once(pool, service, scanner_id, "killed")
            next(iter(killed)).result()
            os.kill(service.process_id, signal.SIGKILL)
            before = [future.result() for future in killed]
        with serve(tmp_path, environment, *flags) as service:
            after = send(service, scanner_id, "killed", threading.Barrier(1))
            assert {answer.content for answer in before if answer is not None} == {after.content}
            scans = service.get("/v1/scans").json()["items"]
            jobs = service.get("/v1/jobs").json()["items"]
            assert {scan["id"] for scan in scans} == {answers[0].json()["id"], after.json()["id"]}
            assert (len(scans), len(jobs)) == (2, 2)
            assert len(list((service.data / "uploads" / "scans").iterdir())) == 2
