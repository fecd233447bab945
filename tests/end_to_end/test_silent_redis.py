"""The API beside a Redis that accepts connections and never answers."""

import time

import pytest

pytestmark = pytest.mark.slow


def test_every_post_is_answered_within_half_a_second(tmp_path, offline, serve, silent_redis_url):
    with serve(tmp_path, {**offline.variables, "SAWMILL_BROKER_URL": silent_redis_url}, "--no-examples") as service:
        scanner_id = service.create_scanner()
        seconds = []
        for _ in range(8):
            started = time.monotonic()
            scan = service.upload(b"a scan", scanner_id=scanner_id, data="counts", phantom_id="l-shape")
            asked = time.monotonic()
            service.post("/v1/calibrations", json={"scan_id": scan["id"]})
            seconds += [asked - started, time.monotonic() - asked]
        stopping = time.monotonic()
    assert max(seconds) < 0.5, seconds
    assert time.monotonic() - stopping < 10
