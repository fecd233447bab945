"""The page on which two calibrations are compared, and one log with both."""

import re

import pytest
from results import FRAME, calibration_result

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.scans import ScanSpec
from sawmill_vocabulary import DataKind

PAGE = "/scanners/example/compare"


@pytest.fixture
def pair(store, worker) -> tuple[str, str]:
    """Two calibrations with error bars; the second has moved by 0.4 mm on the detector."""
    made = []
    for column_mm in (FRAME["cor_column_mm"], FRAME["cor_column_mm"] + 0.4):
        made.append(store.calibrations.accept(CalibrationAsk(scan_id="example")).id)
        spreads = calibration_result()["standard_deviation"]
        worker.finish_calibration(source_frame=FRAME | {"cor_column_mm": column_mm}, standard_deviation=spreads)
    return tuple(made)


def row(answer, name: str) -> str:
    cells = re.search(rf"<tr><th scope=\"row\">{re.escape(name)}.*?</tr>", answer.text)[0]
    return " ".join(re.sub(r"<[^>]+>", " ", cells).replace("\N{NO-BREAK SPACE}", " ").split())


def test_any_two_calibrations_are_compared_with_their_error_bars(seeded, pair):
    newest = seeded.get(PAGE)
    assert re.findall(r'<option value="(\w+)" selected', newest.text)[:2] == list(pair)
    moved = row(newest, "Centre of rotation on the detector (u_c)")
    # 1.96 times the root of 2 times 0.1 mm squared.
    assert moved.endswith("-209.100 mm -208.700 mm +0.400 mm 0.277 mm Changed")
    assert row(newest, "Source to detector (SDD)").endswith("0.277 mm The same")
    other_way = seeded.get(f"{PAGE}?first={pair[1]}&second={pair[0]}")
    assert "-0.400 mm" in row(other_way, "Centre of rotation on the detector (u_c)")
    unknown = row(seeded.get(f"{PAGE}?first=example&second={pair[0]}"), "Centre of rotation on the detector (u_c)")
    assert unknown.endswith("not known Not certain")
    assert seeded.get(f"/scanners/example-spare/compare?first={pair[1]}&second={pair[0]}").status_code == 404


def test_before_the_second_calibration_there_is_nothing_to_compare(seeded):
    assert "There are no two calibrations to compare yet." in seeded.get(PAGE).text


def test_one_log_is_made_with_both_and_only_once(seeded, store, pair):
    fields = {"first": pair[0], "second": pair[1], "scan_id": "example-spare"}
    made = seeded.post(PAGE, data=fields)
    assert made.status_code == 303
    newest, older = (log.id for log in store.reconstructions.page(scan_id="example-spare").items)
    assert made.headers["Location"] == f"/logs/{newest}?beside={older}"
    assert {store.reconstructions.get(each).calibration_id for each in (newest, older)} == set(pair)
    assert seeded.post(PAGE, data=fields).headers["Location"] == made.headers["Location"]
    reading = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS)
    another = store.scans.accept(reading, store.files.receive([b"file"], max_bytes=100)).id
    for wrong in ({"first": ""}, {"second": "another one"}, {"scan_id": ""}, {"scan_id": "no such scan"}):
        assert seeded.post(PAGE, data=fields | wrong).status_code == 404, wrong
    assert seeded.post("/scanners/example-spare/compare", data=fields).status_code == 404, "another scanner's"
    refused = seeded.post(PAGE, data=fields | {"scan_id": another})
    assert refused.status_code == 409
    assert 'class="problem"' in refused.text
