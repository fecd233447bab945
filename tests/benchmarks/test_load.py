"""The load of a line: the page's tables are those that the code computes, and the study measures what they show."""

import json

import line_day
import load
import pytest


def test_a_day_of_logs_is_what_the_page_says():
    assert line_day.log_bytes() == 20 * 2500 * 768 * 2
    assert line_day.day_bytes() == 153_600_000_000
    assert "| samples of a day | 2000 logs x 76.8 MB | 154 GB |" in line_day.PAGE.read_text()


def test_the_page_shows_the_stored_figures_by_today_s_code():
    page, figures = line_day.PAGE.read_text(), json.loads(line_day.FIGURES.read_text())
    assert line_day.rendered(page, figures) == page, "stale: run `python benchmarks/line_day.py`"
    assert figures["log"]["rows"] == line_day.ROWS
    assert {cell["database"] for cell in figures["cells"]} == {"sqlite", "postgresql"}


def test_another_figure_changes_the_page_and_a_lost_place_is_an_error():
    page, figures = line_day.PAGE.read_text(), json.loads(line_day.FIGURES.read_text())
    figures["log"]["read_processor_s"] *= 2.0
    assert line_day.rendered(page, figures) != page
    with pytest.raises(ValueError, match="one place for 'day', not 0"):
        line_day.rendered(page.replace("<!-- day -->", ""), figures)


@pytest.mark.nightly
def test_the_quick_study_measures_everything_and_keeps_what_was_measured_before(tmp_path, capsys):
    kept = {"database": "postgresql", "workers": 2, "queued": 100, "finished_per_s": 1.0}
    (tmp_path / "load.json").write_text(json.dumps({"cells": [kept]}))
    load.main(["--quick", "--out", str(tmp_path / "load.json")])
    figures = json.loads((tmp_path / "load.json").read_text())
    assert figures["cells"][1] == kept
    cell, log = figures["cells"][0], figures["log"]
    assert (cell["database"], cell["workers"], cell["queued"]) == ("sqlite", 1, 10)
    assert all(cell[name] > 0.0 for name in cell.keys() - {"database", "by"})
    assert log["upload_bytes"] > log["rows"] * 22 * 768 * 2
    assert min(log["scan_bytes"], log["volume_bytes"], log["read_processor_s"], log["fbp_processor_s"]) > 0
    assert "sqlite           1      10" in capsys.readouterr().out
