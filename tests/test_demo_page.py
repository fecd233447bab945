"""The page that the demo writes."""

import re

from results import calibration_result

from sawmill_command.demo_page import LogPair, Section, write_page
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_mill.two_questions import TwoQuestions

LIMITS = {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}
PAIR = LogPair("log's-before.png", "after.png", 3.41, 0.0123, ["source shift +3 mm", "detector tilt -0.5°"], 0.61)


def section(title="scan <1>", **changes):
    result = CalibrationResult.model_validate(calibration_result(limits=LIMITS))
    return Section(
        **{
            "title": title,
            "text": "R & D",
            "verdict": result.verdict,
            "questions": TwoQuestions.of(result, None),
            "report": "a-report.html",
            "log": PAIR,
        }
        | changes
    )


def written(tmp_path, *sections):
    write_page(tmp_path / "index.html", list(sections))
    return (tmp_path / "index.html").read_text()


def test_the_page_opens_with_the_log_before_and_after_and_says_which_is_which(tmp_path):
    page = written(tmp_path, section())
    parts = ("<h1>", "log&#39;s-before.png", "after.png", 'class="verdict', 'class="scan"')
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    text = " ".join(re.sub(r"<[^>]+>", " ", page[page.index("<body>") :]).split())
    assert "As measured by tape Its rays are off by 3.4 mm." in text
    assumed = "source shift +3 mm, detector tilt -0.5° from the truth, in the directions that add up."
    assert f"Assumed of a tape measure and a spirit level: {assumed}" in text
    assert "Calibrated Its rays are off by 0.012 mm." in text
    assert "0.040 mm 95 % bound limit 0.100 mm" in text
    assert "± 0.3 % = ± 0.9 mm on a log of 300 mm" in text


def test_the_page_shows_every_part_of_a_section_escaped(tmp_path):
    one = section(head=("", "found <i>"))
    one.rows.append(("tilt", "<0.3>"))
    one.facts.append(("error <mm>", "0.1"))
    one.pictures.append(("log's.png", 'a "log"'))
    one.files.append(("a&b.h5", "<slices>"))
    page = written(tmp_path, one)
    escaped = ("scan &lt;1&gt;", "R &amp; D", "found &lt;i&gt;", "&lt;0.3&gt;", "error &lt;mm&gt;", "&lt;slices&gt;")
    assert all(text in page for text in escaped)
    assert '<img src="log&#39;s.png" alt="a &#34;log&#34;">' in page
    assert '<a href="a&amp;b.h5">a&amp;b.h5</a>' in page


def test_a_second_scan_has_its_own_log_and_a_scan_without_one_has_none(tmp_path):
    other = LogPair("b2.png", "a2.png", 3.0, 0.01, ["source shift +3 mm"], 1.0)
    page = written(tmp_path, section(), section("second", log=other), section("third", log=None))
    assert page.index("second") < page.index("b2.png") < page.index("a2.png") < page.index("third")
    assert page.count("As measured by tape") == 2


def test_what_is_only_quotes_cannot_leave_an_attribute(tmp_path):
    assert "<script" not in written(tmp_path, section(pictures=[("x.png", '"><script>alert(1)</script>')]))
