"""Figures of the pages are those of `benchmarks/results`, and a measurement records its conditions."""

import json
import re
import subprocess

import evidence
import pytest
from figures import PAGES, PLACE, ROOT, conditions, filled, read_results, stale
from measurement import RESULTS, Measurement, check_lines, commit

RESULTS_FILES = read_results()
FAST_S = 1.0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_shows_the_figures_of_the_results_with_their_commits_and_days(page):
    text = page.read_text()
    assert filled(text, RESULTS_FILES) == text, "stale: run `make figures`"
    assert len(PLACE.findall(text)) == text.count("<!-- figure") == text.count("<!-- end -->")
    # Markdown takes a line that begins with a comment for HTML, to the line's end.
    assert not re.search(r"^ *<!-- (?:figure [^\n]*|end) -->.", text, re.MULTILINE)
    shown = [(place[2], place[3]) for place in PLACE.finditer(text)]
    assert {name for name, _ in shown} == {name for name, key in shown if key in {"measured", "run"}}


def test_each_results_file_names_folders_that_it_measures():
    assert [name for name, file in RESULTS_FILES.items() if not file["measures"]] == []
    folders = {folder for file in RESULTS_FILES.values() for folder in file["measures"]}
    assert [folder for folder in sorted(folders) if not (ROOT / folder).exists()] == []


def git(folder, *arguments):
    author = ["-c", "user.name=nobody", "-c", "user.email=nobody@mill.example"]
    command = ["git", "-C", str(folder), *author, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def committed(folder, name):
    """The commit that adds a line to a file."""
    (folder / name).parent.mkdir(exist_ok=True)
    with (folder / name).open("a") as file:
        file.write("a line\n")
    git(folder, "add", ".")
    git(folder, "commit", "--message", f"A line in {name}")
    return git(folder, "rev-parse", "--short", "HEAD")


def test_a_results_file_is_stale_whose_folder_has_changed_since(tmp_path):
    git(tmp_path, "init")
    first, fit, page = (committed(tmp_path, name) for name in ("fit/a.py", "fit/b.py", "page/a.txt"))
    files = {
        "older": {"commit": first, "measures": ["page", "fit"], "command": "make a"},
        "dirty": {"commit": f"{first}-dirty", "measures": ["fit"], "command": "make a"},
        "newest": {"commit": fit, "measures": ["fit"], "command": "make a"},
        "lost": {"commit": "0123456789ab", "measures": ["fit"], "command": "make a"},
    }
    assert stale(files, tmp_path) == [
        f"older: page, fit changed in {page} after {first}: run make a",
        f"dirty: fit changed in {fit} after {first}: run make a",
        "lost: its commit 0123456789ab is not in this repository: fetch it, or run make a",
    ]


def test_the_evidence_is_that_of_the_results_with_the_conditions_of_each_file():
    written = {path.stem: path.read_text() for path in evidence.FOLDER.glob("*.md")}
    assert written == evidence.pages(evidence.read_templates(), RESULTS_FILES), "stale: run `make figures`"
    shelf = " ".join(" ".join(path.read_text() for path in evidence.FOLDER.glob("*.md")).split())
    assert not [name for name, file in RESULTS_FILES.items() if conditions(file) not in shelf]


def test_a_results_file_without_a_template_has_its_section_and_others_their_own():
    templates = {"a": "# A\n\n## One\n\nIn {speed.total_s 2 s}.\n\n## Words\n\nNone.\n"}
    pages = evidence.pages(templates, {"speed": RESULT, "new": RESULT | {"command": "make b"}})
    measured = ", commit 012 with changes, 2026-11-23, 2 cores (a processor) at a load of 0.1 before the start.*"
    head = "*Written by `make figures` from `benchmarks/results`.*"
    one = f"## One\n\nIn 0.42 s.\n\n*Measured by `make a`{measured}"
    assert pages["a"] == f"# A\n\n{head}\n\n{one}\n\n## Words\n\nNone.\n"
    title, _, section = pages["more"].split("\n\n", 2)
    assert title == "# Other measurements"
    assert section.startswith("## new\n\n| a |\n|---|\n| 1 |\n\n- `total_s`: 0.424\n")
    assert f"*Measured by `make b`{measured}" in section


def test_a_figure_that_no_results_file_has_is_named():
    with pytest.raises(LookupError, match=r"benchmarks/results has no speed\.lost, which a page shows"):
        evidence.pages({"a": "# A\n\n{speed.lost}"}, {"speed": RESULT})


def test_each_benchmark_is_named_by_a_page_or_a_target_or_is_part_of_one_that_is():
    scripts = {path.stem: path.read_text() for path in RESULTS.parent.glob("*.py")}
    parts = [path.read_text() for path in RESULTS.parent.glob("*/*.py")]
    namers = "".join(path.read_text() for path in (ROOT / "Makefile", *PAGES))
    reached = set(re.findall(r"(?<!tests/)benchmarks/(\w+)\.py(?![^`\n]*`\s+at [0-9a-f]{8})", namers))
    assert reached <= scripts.keys()
    imports, sources = re.compile(r"^ *(?:from|import) (\w+)", re.MULTILINE), "\n".join(parts)
    while more := {*imports.findall("\n".join([sources, *map(scripts.get, reached)]))} & scripts.keys() - reached:
        reached |= more
    assert reached == scripts.keys()


TABLE = "| a |\n|---|\n| 1 |"
VALUES = {"total_s": 0.4237, "ratio": 2934.2, "error_mm": 0.0, "rows": 2500, "table": TABLE, "of": {"x_ms": 3}}
RESULT = {"command": "make a", "commit": "012-dirty", "date": "2026-11-23T18:40+00:00", "machine": "a processor"}
RESULT |= {"cores": 2, "load": 0.1, "busy": False, "values": VALUES}
RUN = "`make a`, commit 012 with changes, 2026-11-23, 2 cores (a processor) at a load of 0.1 before the start"


@pytest.mark.parametrize(
    ("mark", "shown", "busy"),
    [
        ("total_s 2 s", "0.42 s", False),
        ("total_s", "0.4237", False),
        ("ratio 2", "2 900", False),
        ("ratio 5", "2 934.2", False),
        ("error_mm 2 mm", "0.0 mm", False),
        ("rows", "2500", False),
        ("of.x_ms 1 ms of 8", "3 ms of 8", False),
        ("table", f"\n{TABLE}\n", False),
        ("measured", "measured at 012 on 23 November 2026", False),
        ("run", RUN, False),
        ("total_s 2 s", "0.42 s (busy machine)", True),
        ("of.x_ms", "3 (busy machine)", True),
        ("ratio 2", "2 900", True),
        ("table", f"\n{TABLE}\n\n*Measured on a busy machine.*\n", True),
    ],
)
def test_a_figure_is_rounded_and_has_its_unit_and_a_busy_machine_s_times_and_tables_are_marked(mark, shown, busy):
    page = filled(f"| a <!-- figure speed.{mark} -->old\n1<!-- end --> | b |", {"speed": RESULT | {"busy": busy}})
    assert page == f"| a <!-- figure speed.{mark} -->{shown}<!-- end --> | b |"


@pytest.mark.parametrize("mark", ["speed.lost", "lost.total_s", "speed.total_s.x"])
def test_a_mark_without_a_figure_is_named(mark):
    with pytest.raises(LookupError, match=f"benchmarks/results has no {re.escape(mark)}, which a page shows"):
        filled(f"<!-- figure {mark} --><!-- end -->", {"speed": RESULT})


def measured(folder, *, before_s, after_s):
    times = iter((before_s, after_s))
    Measurement.begin("worker", reference=lambda: next(times)).write({"speed": {"total_s": 2.0}}, folder)
    return json.loads((folder / "speed.json").read_text())


def test_a_measurement_records_its_conditions(tmp_path, capsys):
    file = measured(tmp_path, before_s=FAST_S, after_s=1.1 * FAST_S)
    assert file["values"] == {"total_s": 2.0}
    assert file["reference_s"] == {"before": FAST_S, "after": 1.1 * FAST_S, "best": FAST_S}
    assert not file["busy"]
    assert re.fullmatch(r"[0-9a-f]{12}(-dirty)?", file["commit"])
    assert {"command", "date", "machine", "cores", "load"} <= file.keys()
    assert file["measures"] == ["worker"]
    assert "speed.json. `make figures`" in capsys.readouterr().out


@pytest.mark.parametrize("after_s", [0.8 * FAST_S, 1.2 * FAST_S])
def test_nothing_is_written_where_the_machine_s_speed_changed(tmp_path, after_s):
    with pytest.raises(SystemExit, match="Nothing is written: the reference computation took"):
        measured(tmp_path, before_s=FAST_S, after_s=after_s)
    assert not list(tmp_path.iterdir())


def test_results_of_the_published_data_are_never_replaced_by_others(tmp_path):
    measurement = Measurement.begin("worker", reference=lambda: FAST_S)
    measurement.write({"a": {"source": "published", "error_mm": 0.008}}, tmp_path)
    kept = (tmp_path / "a.json").read_bytes()
    for values in ({"source": "simulated", "error_mm": 0.016}, {"error_mm": 0.016}):
        with pytest.raises(SystemExit, match=r"Nothing is written: a in .* are of the published data\. Let SAWMILL"):
            measurement.write({"b": values, "a": values}, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert (tmp_path / "a.json").read_bytes() == kept
    measurement.write({"a": {"source": "published", "error_mm": 0.007}}, tmp_path)
    assert '"error_mm": 0.007' in (tmp_path / "a.json").read_text()


@pytest.mark.parametrize("other", [{"commit": None}, {"commit": "0123456789ab"}, {"seed": 12}])
def test_a_study_writes_no_lines_of_another_commit_or_seed(tmp_path, other):
    own = {"commit": commit(), "seed": 31}
    (kept := tmp_path / "lines.jsonl").write_text(json.dumps(own) + "\n")
    check_lines(kept, seed=31)
    kept.write_text(kept.read_text() + json.dumps(own | other) + "\n")
    with pytest.raises(SystemExit, match=r"Nothing is written: .* has results of \{'commit': .*Remove it"):
        check_lines(kept, seed=31)


def test_a_machine_that_is_slower_than_its_best_before_and_after_is_busy(tmp_path):
    measured(tmp_path, before_s=FAST_S, after_s=FAST_S)
    assert not measured(tmp_path, before_s=1.1 * FAST_S, after_s=1.2 * FAST_S)["busy"]
    busy = measured(tmp_path, before_s=1.2 * FAST_S, after_s=1.3 * FAST_S)
    assert busy["busy"]
    assert busy["reference_s"]["best"] == FAST_S
    (tmp_path / "speed.json").write_text(json.dumps(busy | {"cores": 1000}))
    assert not measured(tmp_path, before_s=1.2 * FAST_S, after_s=1.3 * FAST_S)["busy"]
