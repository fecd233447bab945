import io

import numpy as np
import pytest
from PIL import Image

VOLUME = "/v1/reconstructions/example/volume.h5"


def test_a_reconstruction_takes_the_active_calibration(seeded, worker, woken):
    accepted = seeded.post("/v1/reconstructions", json={"scan_id": "example"})
    assert accepted.status_code == 202
    path = accepted.headers["Location"]
    queued = seeded.get(path).json()
    assert (queued["state"], queued["calibration_id"]) == ("queued", "example")
    assert woken == [queued["job_id"]]
    for link in ("volume", "first_slice"):
        assert seeded.get(queued["links"][link]).json()["code"] == "reconstruction-without-result"
    worker.finish_reconstruction()
    answer = seeded.get(path).json()
    assert answer["result"]["shape"] == [3, 32, 32]
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


def test_a_theta_of_ones_own_needs_no_calibration(seeded, theta):
    answer = seeded.post("/v1/reconstructions", json={"scan_id": "example", "theta": theta, "rotation": "reversed"})
    assert answer.json()["calibration_id"] is None


def test_a_theta_and_a_calibration_contradict_each_other(seeded, theta):
    ask = {"scan_id": "example", "theta": theta, "calibration_id": "example"}
    answer = seeded.post("/v1/reconstructions", json=ask)
    assert answer.json()["detail"] == "body is refused: give calibration_id or theta, not both"


@pytest.mark.parametrize(
    "ask",
    [
        {"scan_id": "example", "rotation": "reversed"},
        {"scan_id": "example", "size": 1_000_000},
        {"scan_id": "example", "field_mm": -400},
    ],
)
def test_a_contradictory_or_absurd_ask_is_a_problem(seeded, ask):
    assert seeded.post("/v1/reconstructions", json=ask).status_code == 422


def test_a_sixteen_bit_slice_holds_the_values_of_its_window(seeded, volume):
    answer = seeded.get("/v1/reconstructions/example/slices/1.png?bits=16&window_low=0&window_high=4")
    drawn = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert drawn.shape == (32, 32)
    np.testing.assert_allclose(drawn / 65535 * 4, volume[1], atol=1e-4)


def test_slices_and_windows_are_told_apart(seeded):
    urls = [
        f"slices/{index}.png?window_high={high}&bits={bits}" for index in (0, 1) for high in (2, 3) for bits in (8, 16)
    ]
    answers = [seeded.get(f"/v1/reconstructions/example/{url}") for url in urls]
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.headers["ETag"] for answer in answers}) == len(urls)


def test_a_slice_that_the_client_holds_is_not_drawn(seeded):
    path = "/v1/reconstructions/example/slices/0.png"
    tag = seeded.get(path).headers["ETag"]
    assert seeded.get(path, headers={"If-None-Match": f'"other", W/{tag}'}).status_code == 304
    assert seeded.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


@pytest.mark.parametrize(
    ("url", "status"),
    [
        ("slices/3.png", 404),
        ("slices/-1.png", 422),
        ("slices/0.png?bits=12", 422),
        ("slices/0.png?window_low=4", 422),
        ("slices/0.png?window_low=nan", 422),
        ("slices/0.png?window=4", 422),
    ],
)
def test_a_slice_that_cannot_be_drawn_is_a_problem(seeded, url, status):
    answer = seeded.get(f"/v1/reconstructions/example/{url}")
    assert answer.status_code == status
    assert answer.headers["Content-Type"] == "application/problem+json"


def test_the_volume_can_be_fetched_in_ranges(seeded):
    whole = seeded.get(VOLUME)
    assert whole.headers["Accept-Ranges"] == "bytes"
    half = len(whole.content) // 2
    parts = [seeded.get(VOLUME, headers={"Range": f"bytes={span}"}) for span in (f"0-{half - 1}", f"{half}-")]
    assert [part.status_code for part in parts] == [206, 206]
    assert b"".join(part.content for part in parts) == whole.content
    assert parts[0].headers["Content-Range"] == f"bytes 0-{half - 1}/{len(whole.content)}"


def test_the_size_can_be_asked_for_alone(seeded):
    answer = seeded.request("HEAD", VOLUME)
    assert (answer.content, int(answer.headers["Content-Length"])) == (b"", len(seeded.get(VOLUME).content))


@pytest.mark.parametrize(
    ("span", "status"),
    [
        ("bytes=999999999-", 416),
        ("bytes=abc", 400),
        ("bytes=-", 400),
        ("bytes=5-2", 400),
        ("pages=1-2", 400),
        ("bytes=0-1,x", 400),
    ],
)
def test_a_range_that_cannot_be_is_a_problem(seeded, span, status):
    answer = seeded.get(VOLUME, headers={"Range": span})
    assert (answer.status_code, answer.headers["Content-Type"]) == (status, "application/problem+json")


@pytest.mark.parametrize(("span", "length"), [("bytes=-7", 7), ("bytes=3-3", 1)])
def test_ends_and_single_bytes_are_ranges(seeded, span, length):
    answer = seeded.get(VOLUME, headers={"Range": span})
    assert (answer.status_code, len(answer.content)) == (206, length)


def test_a_range_of_an_older_file_is_answered_with_the_whole(seeded):
    answer = seeded.get(VOLUME, headers={"Range": "bytes=0-9", "If-Range": '"older"'})
    assert (answer.status_code, len(answer.content) > 10) == (200, True)


def test_a_volume_that_was_removed_by_hand_is_a_problem(seeded, store):
    store.files.volume("example").unlink()
    answer = seeded.get(VOLUME)
    assert (answer.status_code, answer.headers["Content-Type"]) == (404, "application/problem+json")
