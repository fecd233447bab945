"""The API beside a Redis that accepts connections and never answers."""

import pytest

pytestmark = pytest.mark.slow

POSTS = 8


def test_no_post_waits_for_redis(tmp_path, offline, serve, silent_redis_url):
    """Each wake-up is given up after seconds. One that a request waited for is in the log before its answer."""
    environment = {**offline.variables, "SAWMILL_BROKER_URL": silent_redis_url}
    with serve(tmp_path, environment, "--no-examples") as service:
        scanner_id = service.create_scanner()
        for _ in range(POSTS):
            scan = service.upload(b"a scan", scanner_id=scanner_id, data="counts", phantom_id="l-shape")
            service.post("/v1/calibrations", json={"scan_id": scan["id"]})
        given_up = (tmp_path / "service.log").read_text().count("wake-up-not-sent")
    assert given_up < POSTS
