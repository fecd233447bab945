"""What every page shares: language, numbers and times, problems as pages, and no other host."""

import gettext
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from babel.messages.checkers import checkers
from babel.messages.frontend import CommandLineInterface
from babel.messages.pofile import read_po
from page_text import absent
from results import calibration_result, comparison

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_service.access import ANYBODY
from sawmill_service.pages.frame.languages import ENGLISH, LANGUAGES, Formats, catalogue, locale_of, preferred_language
from sawmill_service.pages.frame.page_frame import templates
from sawmill_service.pages.frame.verdicts import shown_questions

BROWSER = {"Accept": "text/html,application/xhtml+xml"}


@pytest.mark.parametrize(
    ("chosen", "accepted", "language"),
    [
        ("", "", "en"),
        ("", "fi-FI,fi;q=0.9,en;q=0.8", "fi"),
        ("", "sv,en-GB;q=0.9,fi;q=0.5", "en"),
        ("", "fi;q=0,en", "en"),
        ("", "fi;q=much", "en"),
        ("", "*;q=0.1,\xff;q=;,", "en"),
        ("fi", "en", "fi"),
        ("xx", "fi", "fi"),
        ("", "EN-US", "en"),
        ("", "FI", "fi"),
        ("", "Fi-fi;q=0.9", "fi"),
    ],
)
def test_the_language_is_the_one_chosen_else_the_best_accepted(chosen, accepted, language):
    assert preferred_language(chosen, accepted) == language


def test_numbers_and_times_are_written_as_the_language_does_and_unknown_ones_are_said_to_be():
    english, finnish = (Formats(locale_of(name), gettext.NullTranslations()) for name in ("en", "fi"))
    assert (english.mm(0.0431), finnish.mm(0.0431)) == ("0.043\N{NO-BREAK SPACE}mm", "0,043\N{NO-BREAK SPACE}mm")
    assert (english.percent(1.5, signed=True), english.degrees(-0.25)) == ("+1.50\N{NO-BREAK SPACE}%", "-0.250°")
    assert english.mm(None) == english.mm(float("nan")) == english.bytes(None) == "not known"
    assert english.mm(-1e30) == "-1E30\N{NO-BREAK SPACE}mm"
    assert [english.bytes(value) for value in (0, 1023, 1536, 2**42)] == ["0 B", "1,023 B", "1.5 KiB", "4.0 TiB"]
    english = Formats(locale_of("en"), gettext.NullTranslations())
    time = datetime.now(UTC) - timedelta(hours=3, seconds=5)
    assert english.age(time) == english.age(time.isoformat()) == "3 hours ago"
    assert english.moment(time) == time.astimezone().strftime("%-d %b %Y, %H:%M")
    assert english.moment(None) == english.age(None) == english.day(None) == "never"


@pytest.mark.parametrize(
    ("changes", "active", "badges"),
    [
        ({"comparison": comparison()}, False, [("good", "Yes"), ("good", "Yes"), ("good", "No")]),
        ({"comparison": comparison(0.9)}, False, [("good", "Yes"), ("good", "Yes"), ("watch", "Look at it")]),
        ({"comparison": comparison(0.9)}, True, [("good", "Yes"), ("good", "Yes"), ("idle", "Accepted")]),
        ({"predicted_ray_error_mm": None, "scale_uncertainty_percent": None}, False, [("idle", "Not known")] * 3),
        (
            {"rays_verdict": "fail", "scale_uncertainty_percent": 1.2},
            False,
            [("bad", "No"), ("watch", "Look at it"), ("idle", "Not known")],
        ),
    ],
)
def test_each_answer_of_the_three_questions_has_its_colour_and_word(changes, active, badges):
    limits = {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}
    answer = calibration_result(**{"limits": limits, "rays_verdict": "pass"} | changes)
    text = gettext.NullTranslations()
    ask = shown_questions(text, Formats(locale_of("en"), text))
    questions = ask(CalibrationResult.model_validate(answer), None, active)
    assert [(question.tone, question.word) for question in questions] == badges
    assert questions[2].question == "Did anything move?"


def test_a_browser_keeps_its_language_and_colours(client):
    answer = client.get("/look?language=fi&theme=dark&next=/docs?x=1")
    assert answer.headers["Location"] == "/docs?x=1"
    kept = [cookie.partition(";")[0] for cookie in answer.headers.get_list("Set-Cookie")]
    assert kept == ["sawmill_language=fi", "sawmill_theme=dark"]
    assert '<html lang="fi" data-theme="dark">' in client.get("/docs", headers={"Cookie": "; ".join(kept)}).text
    assert "Set-Cookie" not in client.get("/look?language=xx&theme=red&next=//evil.example").headers
    assert client.get("/look?next=//evil.example").headers["Location"] == "/"


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("/nothing/here", 404, "There is nothing here"),
        ("/v1/scanners/none", 404, "there is no scanner &#39;none&#39;"),
        ("/v1/scanners?limit=0", 422, "Something was not right"),
        ("/v1/calibrations/none/report.png", 404, "/problems/calibration-not-found"),
    ],
)
def test_a_person_gets_a_problem_as_a_page_and_a_program_as_json(client, path, status, words):
    page = client.get(path, headers=BROWSER)
    assert (page.status_code, page.headers["Content-Type"]) == (status, "text/html; charset=utf-8")
    assert page.headers["Content-Length"] == str(len(page.content))
    assert absent(page.text, words, page.headers["X-Request-Id"]) == []
    problem = client.get(path)
    assert problem.headers["Content-Type"] == "application/problem+json"
    assert problem.json()["code"] in page.text


def test_whoever_is_not_let_in_sees_no_names_of_pages(client):
    unknown = client.get("/docs", headers={**BROWSER, "Host": "evil.example"})
    assert unknown.status_code == 421
    assert "does not answer as" in unknown.text
    assert 'href="/docs"' not in unknown.text


def verdict(language, **changes):
    answer = CalibrationResult.model_validate(calibration_result(**changes))
    page = templates(language).from_string(
        '{% from "pages/parts.html" import verdict with context %}{{ verdict(it, none, false) }}'
    )
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page.render(it=answer, caller=ANYBODY))).strip()


def test_a_verdict_shows_both_questions_with_their_limits_as_the_language_writes_them():
    predicted = {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0}
    changes = {
        "rays_verdict": "pass",
        "predicted_ray_error_mm": predicted,
        "scale_uncertainty_percent": 0.8,
        "limits": {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5},
    }
    english, finnish = verdict("en", **changes), verdict("fi", **changes)
    assert "Are the rays right? Yes 0.040 mm of 0.100 mm allowed" in english
    assert "Are the millimetres right? Look at it 0.80 % of 0.50 % allowed" in english
    assert "2.4 mm on a log of 300 mm" in english
    assert absent(finnish, "0,040 mm", "2,4 mm") == []
    unknown = verdict("en", predicted_ray_error_mm=None, rays_verdict="watch", limits=None)
    assert "Are the rays right? Not known" in unknown


ROOT = Path(__file__).parents[2]
OTHERS = LANGUAGES.keys() - {ENGLISH}


@pytest.fixture(scope="module")
def texts_of_the_pages(tmp_path_factory):
    template = tmp_path_factory.mktemp("texts") / "sawmill.pot"
    folders = (
        "service/sawmill_service",
        "worker/sawmill_contracts",
        "worker/sawmill_mill",
        "worker/sawmill_vocabulary",
        "worker/sawmill_worker/pictures",
    )
    places = [str(ROOT / folder) for folder in folders]
    options = ["--mapping-file", str(ROOT / "pyproject.toml"), "--output-file", str(template)]
    CommandLineInterface().run(["pybabel", "--quiet", "extract", *options, *places])
    with template.open("rb") as file:
        return {message.id for message in read_po(file) if message.id}


@pytest.mark.slow
@pytest.mark.parametrize("language", OTHERS)
def test_a_catalogue_has_the_texts_of_the_pages_and_no_others(language, texts_of_the_pages):
    stored = catalogue(language)
    assert {message.id for message in stored if message.id} == texts_of_the_pages, "run make texts"
    assert not stored.obsolete


@pytest.mark.parametrize("language", OTHERS)
def test_every_text_is_translated_with_its_places(language):
    stored = catalogue(language)
    for message in stored:
        forms = [message.string] if isinstance(message.string, str) else message.string
        assert all(forms), message.id
        assert not message.fuzzy, message.id
        if message.id:
            for check in checkers:
                check(stored, message)


ADDRESS = re.compile(r"""(?:src|href|action)\s*=\s*["']([^"']+)["']""", re.IGNORECASE)
STYLE_ADDRESS = re.compile(r"""(?:url\(|@import)\s*["']?([^"')\s]+)""", re.IGNORECASE)


@pytest.mark.parametrize("page", ["/", "/docs", "/login"])
def test_a_page_loads_only_what_is_served_here(seeded, page):
    html = seeded.get(page)
    assert html.headers["Content-Type"].startswith("text/html")
    addresses = [
        address for address in ADDRESS.findall(html.text) if "/activate/" not in address and address != "#content"
    ]
    assert addresses
    for address in addresses:
        assert re.match(r"/(?!/)", address), f"{page} loads {address}"
        asset = seeded.get(address)
        assert asset.status_code == (303 if address == "/look" else 200), address
        if address.endswith(".css"):
            assert all(inner.startswith("data:") for inner in STYLE_ADDRESS.findall(asset.text)), address


def test_pages_run_no_script_but_files_of_ours(seeded):
    for page in ("/", "/docs", "/login"):
        html = seeded.get(page).text
        assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+\s*=|javascript:", html), page
    policy = seeded.get("/docs").headers["Content-Security-Policy"]
    directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert directives["default-src"] == "'none'"
    assert directives["script-src"] == directives["connect-src"] == "'self'"
    assert "http" not in policy


def test_the_console_asks_no_validator_elsewhere(client):
    script = client.get("/static/console.js").text
    assert "validatorUrl: null" in script
    assert "http" not in script
    assert client.get("/openapi.json").json()["openapi"].startswith("3.1")
    assert client.get("/examples/phantom-scan.npz").json()["code"] == "file-missing"
