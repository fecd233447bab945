"""The lists of scans and logs, one scan, and a log while it is not ready."""

import itertools
import re
from datetime import timedelta

from asgi import absent

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.database.paging import new_id
from sawmill_store.mill_tables import ReconstructionRow, ScanRow
from sawmill_vocabulary import DataKind

HTML = {"Accept": "text/html"}


def words(answer) -> str:
    text = re.sub(r"<[^>]+>", " ", answer.text.partition("<main")[2])
    return " ".join(text.replace("\N{MULTIPLICATION SIGN}", "x").split())


def titles(answer) -> list[str]:
    return re.findall(r'<h2><a href="/(?:scans|logs)/([\w-]+)">', answer.text)


def badges(answer) -> list[tuple[str, str]]:
    return re.findall(r'<span class="badge (\w+)">([^<]+)</span>', answer.text.partition('<div id="list"')[2])


def upload(store, name: str) -> str:
    spec = ScanSpec(scanner_id="example", data=DataKind.COUNTS, name=name)
    return store.scans.accept(spec, store.files.receive([b"file"], max_bytes=100)).id


def test_a_list_shows_what_became_of_each_scan(seeded, store):
    refused, coming = upload(store, "a <bad> scan"), upload(store, "a coming scan")
    reason = "the file has 359 angles for 360 views: give angles_deg"
    with store.database.write() as session:
        row = session.get(ScanRow, refused)
        row.state, row.reason = "refused", reason
    answer = seeded.get("/scans")
    assert titles(answer) == [coming, refused, "example-spare", "example"]
    assert "a &lt;bad&gt; scan" in answer.text
    shown = words(answer)
    assert "a coming scan Being read Line &lt;2&gt;" in shown
    assert badges(answer) == [("busy", "Being read"), ("bad", "Refused"), ("good", "Ready"), ("good", "Ready")]
    assert absent(shown, reason, "12 views x 4 rows x 16 cells") == []
    assert 'src="/v1/scans/example/thumbnail.png"' in answer.text
    assert f"/v1/scans/{refused}/thumbnail.png" not in answer.text
    # Only a scan that is ready can be used, and only one of a phantom calibrates.
    assert 'href="/calibrate?scan=example"' in answer.text
    assert f"/scans/{coming}#reconstruct" not in answer.text
    assert "data-unfinished" in answer.text


def test_a_list_is_filtered_by_scanner_and_day_in_the_address(seeded, store):
    for kind in ("scans", "logs"):
        everything = titles(seeded.get(f"/{kind}"))
        assert titles(seeded.get(f"/{kind}?scanner_id=&day=&zone=")) == everything
        assert titles(seeded.get(f"/{kind}?scanner_id=example")) == everything
        assert titles(seeded.get(f"/{kind}?scanner_id=example-spare")) == []
        today = store.database.now()
        for zone in ("Europe/Helsinki", "America/Los_Angeles"):
            days = {(today + timedelta(days=n)).date().isoformat() for n in (-1, 0, 1)}
            found = [titles(seeded.get(f"/{kind}?day={day}&zone={zone}")) for day in days]
            # Made within a minute: on one day everywhere, or on two where midnight was meanwhile.
            assert sorted(itertools.chain(*found)) == sorted(everything)
        answer = seeded.get(f"/{kind}?day=2020-02-29&scanner_id=example")
        assert "Choose another scanner or day." in words(answer)
        assert absent(answer.text, 'value="2020-02-29"', '<option value="example" selected>') == []
    for query, code in {
        "day=29.2.2020": "invalid-day",
        "day=0001-01-01": "invalid-day",
        "zone=Nowhere/Land&day=2020-02-29": "invalid-zone",
        "zone=../../etc/passwd": "invalid-zone",
        "after=nonsense": "invalid-cursor",
    }.items():
        answer = seeded.get(f"/scans?{query}", headers=HTML)
        assert (answer.status_code, code in words(answer)) == (422, True), query


def test_a_long_list_leads_to_older_items(seeded, store):
    with store.database.write() as session:
        template = session.get(ScanRow, "example")
        known = {column.key: getattr(template, column.key) for column in ScanRow.__table__.columns}
        for number in range(30):
            at = template.created_at - timedelta(minutes=number + 1)
            session.add(ScanRow(**known | {"id": new_id(), "created_at": at}))
    first = seeded.get("/scans?scanner_id=example")
    older = re.search(r'href="(/scans\?[^"]+)" rel="next"', first.text)[1].replace("&amp;", "&")
    assert "scanner_id=example" in older
    second = seeded.get(older)
    assert (len(titles(first)), len(titles(second))) == (24, 8)
    assert not set(titles(first)) & set(titles(second))
    assert 'rel="next"' not in second.text


def test_slices_are_asked_for_by_a_form_that_comes_back_with_a_sentence(seeded, woken, store):
    for sent, sentence in (
        ({"rows": "5"}, "rows must be A:B with 0 <= A < B"),
        ({"rows": "0:9"}, "0:9"),
        ({"field_mm": "-1", "size": "many"}, "field_mm: Input should be greater than 0"),
        ({"field_centre_mm": "60"}, "field_centre_mm: must be two numbers, x and y in mm, as in 60, -40, not '60'"),
        ({"size": "many"}, "size: Input should be a valid integer"),
    ):
        answer = seeded.post("/scans/example/reconstruct", data=sent)
        assert (answer.status_code, woken) == (422, [])
        assert sentence in words(answer).replace("&lt;", "<").replace("&#39;", "'")
        assert all(f'value="{value}"' in answer.text for name, value in sent.items() if name != "size")
    assert "all 4" in seeded.get("/scans/example").text
    sent = {"method": "total_variation", "rows": " 0:2 ", "size": "512", "field_mm": "350,5", "unknown": "1"}
    sent["field_centre_mm"] = "60, -40,5"
    answer = seeded.post("/scans/example/reconstruct", data=sent)
    assert answer.status_code == 303
    log = store.reconstructions.get(answer.headers["Location"].removeprefix("/logs/"))
    options = log.options
    assert (options.method, options.rows, options.size, options.field_mm) == ("total_variation", "0:2", 512, 350.5)
    assert (options.field_centre_mm, woken) == ((60.0, -40.5), [log.job_id])
    assert "It waits for its turn" in words(seeded.get(answer.headers["Location"]))


def test_a_scan_says_what_it_lacks_and_is_deleted_after_a_question_unless_it_is_in_use(seeded, store, worker):
    spec = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.files.receive([b"file"], max_bytes=100))
    worker.finish_scan()
    answer = seeded.post(f"/scans/{scan.id}/reconstruct", data={"method": "fbp"})
    assert answer.status_code == 409
    assert "no active calibration" in words(answer)
    running = store.calibrations.accept(CalibrationRequest(scan_id="example")).id
    page = seeded.get("/scans/example").text
    assert f'href="/calibrate?calibration={running}"' in page
    assert 'href="/calibrations/example/report?language=en"' in page
    page = seeded.get("/scans/example-spare")
    assert re.search(r"<details>.*?<summary>Delete this scan.*?Yes, delete it", page.text, re.DOTALL)
    log = store.reconstructions.accept(ReconstructionRequest(scan_id="example-spare"))
    refused = seeded.post("/scans/example-spare/delete")
    assert refused.status_code == 409
    assert log.job_id in words(refused)
    store.jobs.request_cancel(log.job_id)
    gone = seeded.post("/scans/example-spare/delete")
    assert (gone.status_code, gone.headers["Location"]) == (303, "/scans")
    assert seeded.get("/scans/example-spare", headers=HTML).status_code == 404


def test_a_log_is_renamed_on_its_page_and_a_list_of_logs_shows_state_method_and_size(seeded, store):
    waiting = store.reconstructions.accept(ReconstructionRequest(scan_id="example", method="cauchy_map"))
    answer = seeded.get("/logs")
    shown = words(answer)
    assert titles(answer)[0] == waiting.id
    # The reconstructions of one scan are of one log.
    assert re.search(r"Line &lt;2&gt;, log 1, \d+:\d\d Waiting Line &lt;2&gt; · scan", shown)
    assert badges(answer) == [("idle", "Waiting"), ("good", "Ready"), ("good", "Ready")]
    assert absent(shown, "Cauchy MAP", "3 slices of 32 x 32 pixels") == []
    assert "Line &lt;2&gt;, log 1," in seeded.get("/logs/example").text.partition("</title>")[0]
    seeded.post("/logs/example/name", data={"name": " Spruce <7> "})
    assert seeded.get("/v1/reconstructions/example").json()["name"] == "Spruce <7>"
    assert "<h1>Spruce &lt;7&gt;</h1>" in seeded.get("/logs/example").text
    refused = seeded.post("/logs/example/name", data={"name": 201 * "x"})
    assert refused.status_code == 422
    assert "200" in words(refused)
    seeded.post("/logs/example/name", data={"name": ""})
    assert seeded.get("/v1/reconstructions/example").json()["name"] is None


def test_a_log_s_page_says_how_it_was_made_and_what_the_method_reports(seeded, store):
    answer = seeded.get("/logs/example")
    shown = words(answer)
    for fact in ("Filtered back-projection", "Line &lt;2&gt;", "1.250 mm", "12", "32 x 32"):
        assert fact in shown
    assert absent(answer.text, 'href="/calibrations/example/report?language=en"', 'src="/static/pages/viewer.js"') == []
    # Without a script: the middle slice.
    assert '<img class="picture" src="/v1/reconstructions/example/slices/1.png"' in answer.text
    # Others of the same scan can be looked at beside it.
    assert '<option value="example-sparse" data-moment=' in answer.text
    both = seeded.get("/logs/example?beside=example-sparse")
    assert both.text.count("data-volume=") == 2
    assert '<option value="example-sparse" selected data-moment=' in both.text
    metal = {"slices": 1, "samples": 9, "share_of_samples": 0.1, "treatment": "left-out", "source": "a paper"}
    method = {"name": "cauchy_map", "noise": 0.0123, "data_misfit": 1.04, "worst_data_misfit": 1.31, "beta": 0.0021}
    method |= {"metal": metal, "unconverged_slices": 2, "remarks": ["the rays <cross> a nail"]}
    with store.database.write() as session:
        row = session.get(ReconstructionRow, "example")
        row.result = row.result | {"method": method, "preparation": ["dark fields taken off"]}
    answer = seeded.get("/logs/example")
    shown = words(answer)
    for fact in (
        "Cauchy MAP",
        "1.04 times the noise, at worst 1.31",
        "β 0.0021 1/mm",
        "in 1 slice",
        "2 slices",
        "the rays &lt;cross&gt; a nail",
        "dark fields taken off",
    ):
        assert fact in shown
    assert "sigma" not in shown
    coupled = method | {"name": "total_variation", "beta": None, "weight": 120.0, "coupling": 0.4}
    coupled |= {"knot_10_mm_contrast": 0.448, "knot_20_mm_contrast": 0.81}
    with store.database.write() as session:
        row = session.get(ReconstructionRow, "example")
        row.result = row.result | {"method": coupled}
    shown = words(seeded.get("/logs/example"))
    assert "Weight of the total variation 120 Coupling of neighbouring slices 0.4" in shown
    assert "Contrast that a knot keeps 45 % of it with 10 mm, 81 % with 20 mm" in shown


def test_a_log_that_failed_or_whose_file_or_scan_is_gone_is_still_described(seeded, store):
    log = store.reconstructions.accept(ReconstructionRequest(scan_id="example"))
    store.jobs.request_cancel(log.job_id)
    answer = seeded.get(f"/logs/{log.id}")
    assert "It was cancelled before it was done." in words(answer)
    assert 'href="/scans/example#reconstruct"' in answer.text
    assert seeded.get("/logs/nobody", headers=HTML).status_code == 404
    assert seeded.get("/logs/example?beside=nobody", headers=HTML).status_code == 404
    (store.files.folder / "reconstructions/example/volume.h5").unlink()
    assert "The file with the slices is not there any more" in words(seeded.get("/logs/example"))
    store.scans.delete("example")
    assert "deleted" in words(seeded.get("/logs/example-sparse"))
