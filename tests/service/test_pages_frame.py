"""What every page shares, and the documents at /help."""

import gettext
import os
import re
import shutil
import subprocess
import sys
import zipfile
from datetime import UTC, datetime, timedelta
from html import unescape
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import mill_states
import pytest
from asgi import absent
from babel.messages.checkers import checkers
from babel.messages.frontend import CommandLineInterface
from babel.messages.pofile import read_po
from results import calibration_result, comparison

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_service.access import ANYBODY
from sawmill_service.http.gate import CONTENT_POLICY
from sawmill_service.pages.frame.languages import ENGLISH, LANGUAGES, Formats, catalogue, locale_of, preferred_language
from sawmill_service.pages.frame.page_frame import templates
from sawmill_service.pages.frame.verdicts import shown_questions
from sawmill_service.pages.help.documents import all_documents

ROOT = Path(__file__).parents[2]
BROWSER = {"Accept": "text/html,application/xhtml+xml"}


def test_the_language_is_the_one_chosen_and_writes_numbers_and_times_its_way():
    accepted = {"fi-FI,fi;q=0.9,en;q=0.8": "fi", "sv,en-GB;q=0.9,fi;q=0.5": "en", "fi;q=0,en": "en", "fi;q=much": "en"}
    accepted |= {"": "en", "*;q=0.1,\xff;q=;,": "en", "EN-US": "en", "FI": "fi", "Fi-fi;q=0.9": "fi"}
    assert {header: preferred_language("", header) for header in accepted} == accepted
    assert (preferred_language("fi", "en"), preferred_language("xx", "fi")) == ("fi", "fi")
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


def test_each_answer_of_the_three_questions_has_its_colour_word_and_limit():
    for changes, active, badges in (
        ({"comparison": comparison()}, False, [("good", "Yes"), ("good", "Yes"), ("good", "No")]),
        ({"comparison": comparison(0.9)}, False, [("good", "Yes"), ("good", "Yes"), ("bad", "Yes")]),
        ({"comparison": comparison(0.9)}, True, [("good", "Yes"), ("good", "Yes"), ("idle", "Accepted")]),
        ({"predicted_ray_error_mm": None, "scale_uncertainty_percent": None}, False, [("idle", "Not known")] * 3),
        (
            {"rays_verdict": "fail", "scale_uncertainty_percent": 1.2},
            False,
            [("bad", "No"), ("watch", "Look at it"), ("idle", "Not known")],
        ),
    ):
        limits = {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}
        answer = calibration_result(**{"limits": limits, "rays_verdict": "pass"} | changes)
        text = gettext.NullTranslations()
        ask = shown_questions(text, Formats(locale_of("en"), text))
        questions = ask(CalibrationResult.model_validate(answer), None, active)
        assert [(question.tone, question.word) for question in questions] == badges
        assert questions[2].question == "Did anything move?"
    predicted = {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0}
    changes = {"limits": {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}, "rays_verdict": "pass"}
    changes |= {"predicted_ray_error_mm": predicted, "scale_uncertainty_percent": 0.8}
    english, finnish = verdict("en", **changes), verdict("fi", **changes)
    assert "Are the rays right? Yes 0.040 mm of 0.100 mm allowed" in english
    assert "Are the millimetres right? Look at it 0.80 % of 0.50 % allowed" in english
    assert "2.4 mm on a log of 300 mm" in english
    assert absent(finnish, "0,040 mm", "2,4 mm") == []
    unknown = verdict("en", predicted_ray_error_mm=None, rays_verdict="watch", limits=None)
    assert "Are the rays right? Not known" in unknown


def test_a_browser_keeps_its_language_and_a_person_gets_a_problem_as_a_page(client):
    answer = client.get("/look?language=fi&theme=dark&next=/docs?x=1")
    assert answer.headers["Location"] == "/docs?x=1"
    kept = [cookie.partition(";")[0] for cookie in answer.headers.get_list("Set-Cookie")]
    assert kept == ["sawmill_language=fi", "sawmill_theme=dark"]
    assert '<html lang="fi" data-theme="dark">' in client.get("/docs", headers={"Cookie": "; ".join(kept)}).text
    assert "Set-Cookie" not in client.get("/look?language=xx&theme=red&next=//evil.example").headers
    assert client.get("/look?next=//evil.example").headers["Location"] == "/"
    unknown = client.get("/docs", headers={**BROWSER, "Host": "evil.example"})
    assert unknown.status_code == 421
    assert "does not answer as" in unknown.text
    assert 'href="/docs"' not in unknown.text
    for path, status, words in (
        ("/nothing/here", 404, "There is nothing here"),
        ("/v1/scanners/none", 404, "there is no scanner &#39;none&#39;"),
        ("/v1/scanners?limit=0", 422, "Something was not right"),
        ("/v1/calibrations/none/report.png", 404, "/problems/calibration-not-found"),
    ):
        page = client.get(path, headers=BROWSER)
        assert (page.status_code, page.headers["Content-Type"]) == (status, "text/html; charset=utf-8")
        assert page.headers["Content-Length"] == str(len(page.content))
        assert absent(page.text, words, page.headers["X-Request-Id"]) == []
        problem = client.get(path)
        assert problem.headers["Content-Type"] == "application/problem+json"
        assert problem.json()["code"] in page.text


def verdict(language, **changes):
    answer = CalibrationResult.model_validate(calibration_result(**changes))
    page = templates(language).from_string(
        '{% from "pages/parts.html" import verdict with context %}{{ verdict(it, none, false) }}'
    )
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page.render(it=answer, caller=ANYBODY))).strip()


OTHERS = LANGUAGES.keys() - {ENGLISH}


@pytest.fixture(scope="module")
def texts_of_the_pages(tmp_path_factory):
    template = tmp_path_factory.mktemp("texts") / "sawmill.pot"
    folders = ["service/sawmill_service", "worker/sawmill_calibration/pictures"]
    folders += [f"worker/sawmill_{name}" for name in ("contracts", "mill", "vocabulary")]
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
        assert all([message.string] if isinstance(message.string, str) else message.string), message.id
        assert not message.fuzzy, message.id
        if message.id:
            for check in checkers:
                check(stored, message)


ADDRESS = re.compile(r"""(?:src|href|action)\s*=\s*["']([^"']+)["']""", re.IGNORECASE)
STYLE_ADDRESS = re.compile(r"""(?:url\(|@import)\s*["']?([^"')\s]+)""", re.IGNORECASE)


def test_pages_load_only_what_is_served_here_and_run_no_script_but_files_of_ours(seeded):
    for page in ("/", "/docs", "/login"):
        html = seeded.get(page)
        assert html.headers["Content-Type"].startswith("text/html")
        assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+\s*=|javascript:", html.text), page
        addresses = {each for each in ADDRESS.findall(html.text) if "/activate/" not in each} - {"#content"}
        assert addresses
        for address in addresses:
            assert re.match(r"/(?!/)", address), f"{page} loads {address}"
            asset = seeded.get(address)
            assert asset.status_code == (303 if address == "/look" else 200), address
            if address.endswith(".css"):
                assert all(inner.startswith("data:") for inner in STYLE_ADDRESS.findall(asset.text)), address
    policy = seeded.get("/docs").headers["Content-Security-Policy"]
    directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert directives["default-src"] == "'none'"
    assert directives["script-src"] == directives["connect-src"] == "'self'"
    assert "http" not in policy


TEMPLATES = ROOT / "service/sawmill_service/templates/pages"
# Folders of the sources, which an installation has not: a document names their files, and the site has no link there.
SOURCES = (".github", "benchmarks", "installation", "openapi", "service", "tests", "worker")
# What the policy would forbid, or allows for the API console alone.
INLINE = r"<script(?!(?: type=.module.)? src=./static/)|<style|<[^>]* (?:style|on\w+)="


def article(html: str) -> str:
    return html[html.index("<article") : html.index("</article>")]


def addresses(html: str) -> list[str]:
    return [unescape(each) for each in re.findall(r'(?:href|src)="([^"]+)"', html)]


def test_every_link_and_picture_of_every_page_leads_somewhere(client):
    seen, waiting, broken = {}, ["/help", "/help/.fi"], []
    while waiting:
        address = waiting.pop()
        answer = client.get(address, headers=BROWSER)
        seen[address] = answer
        if answer.status_code != 200 or "text/html" not in answer.headers["Content-Type"]:
            continue
        assert answer.headers["Content-Security-Policy"] == CONTENT_POLICY
        assert not re.search(INLINE, answer.text), address
        for link in addresses(article(answer.text)):
            target = urlsplit(urljoin(address, link))
            if not target.netloc and target.path not in seen and target.path not in waiting:
                waiting.append(target.path)
    for address, answer in seen.items():
        assert answer.status_code == 200, address
        if "<article" in answer.text:
            for link in addresses(article(answer.text)):
                target = urlsplit(urljoin(address, link))
                if target.fragment and not target.netloc and f'id="{target.fragment}"' not in seen[target.path].text:
                    broken.append(f"{address}: {link}")
    assert not broken
    assert {f"/help/{document.path}".rstrip("/") for document in all_documents("en")} <= seen.keys()


def test_every_page_of_the_product_names_a_page_that_helps_and_links_without_address_are_sources(client):
    named = {}
    for path in TEMPLATES.glob("*.html"):
        for page in re.findall(r"""set help = (?:help \| default\()?"([\w/-]+)"|"/help/([\w/-]+)""", path.read_text()):
            named["".join(page)] = path.name
    assert {"do/technician", "understand/drift", "do/webhooks"} <= named.keys()
    assert {page: name for page, name in named.items() if client.get(f"/help/{page}").status_code != 200} == {}
    assert 'href="/help/do/technician"' in client.get("/", headers=BROWSER).text
    assert {
        path.name
        for path in TEMPLATES.glob("*.html")
        if '{% extends "pages/base.html" %}' in path.read_text() and "set help" not in path.read_text()
    } == {"login.html", "login_display.html", "help.html", "help_search.html"}
    for document in all_documents("en"):
        source = (ROOT / "docs" / f"{document.path}.md") if document.path else ROOT / "docs/README.md"
        for text in re.findall(r"<span>(.*?)</span>", document.html):
            plain = re.escape(unescape(re.sub(r"<[^>]+>", "", text)))
            links = re.findall(rf"\[`?{plain}`?\]\(([^)#]+)", source.read_text())
            assert all((source.parent / link).resolve().relative_to(ROOT).parts[0] in SOURCES for link in links), links


def test_a_page_is_rendered_in_the_reader_s_language_as_the_repository_s_host_renders_it(client):
    page = article(client.get("/help/look-up/codes", headers=BROWSER).text)
    assert absent(page, '<h2 id="429-too-many-requests">', '<div class="scrolls" tabindex="0"><table>') == []
    assert "<td><code>queue-full</code></td>" in page
    everything = "".join(document.html for document in all_documents("en"))
    assert not re.search("(?<!<code>)&lt;!--", re.sub("<pre.*?</pre>", "", everything, flags=re.DOTALL)), "a comment"
    assert '<h1 id="ohjeet">' in client.get("/help", headers=BROWSER | {"Accept-Language": "fi"}).text
    finnish = client.get("/help/do/technician", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert '<article class="card" lang="fi">' in finnish
    assert 'href="/help/do/technician.en" lang="en" hreflang="en"' in finnish
    english = client.get("/help/do/technician.en", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert absent(english, '<html lang="fi"', '<article class="card" lang="en">') == []
    assert 'href="/help/do/technician.fi"' in article(english)
    other = client.get("/help/look-up/codes", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert '<article class="card" lang="en">' in other


def test_a_search_finds_what_is_known_first_and_takes_any_text(client):
    for words, language, address in (
        ("queue-full", "en", "look-up/http#full-queue"),
        ("sawmill_token", "en", "look-up/settings#network-and-access"),
        ("skannerilla", "fi", "do/technician#skannerilla"),
    ):
        found = client.get("/help", params={"search": words}, headers=BROWSER | {"Accept-Language": language}).text
        assert re.findall(r'<h2><a href="/help/([^"]+)"', found)[0] == address
        assert found.lower().count("<mark>") >= 1
    nothing = client.get("/help", params={"search": '<b>"nobody" .*[('}, headers=BROWSER)
    assert nothing.status_code == 200
    assert "No page of the help has all these words." in nothing.text
    assert "<b>" not in nothing.text
    assert client.get("/help", params={"search": " "}, headers=BROWSER).text.count("<article") == 1
    assert client.get("/help", params={"search": "x" * 201}).status_code == 422


def test_files_are_sent_as_downloads_with_a_tag_and_nothing_else_is_served(client):
    picture = client.get("/help/pictures/geometry.svg")
    assert (picture.headers["Content-Type"], picture.status_code) == ("image/svg+xml", 200)
    again = client.get("/help/pictures/geometry.svg", headers={"If-None-Match": picture.headers["ETag"]})
    assert again.status_code == 304
    script = client.get("/help/examples/clients/whole_job.sh")
    assert script.headers["Content-Disposition"] == 'attachment; filename="whole_job.sh"'
    assert script.text == (ROOT / "examples/clients/whole_job.sh").read_text()
    script = client.get("/static/console.js").text
    assert "validatorUrl: null" in script
    assert "http" not in script
    assert client.get("/openapi.json").json()["openapi"].startswith("3.1")
    assert client.get("/examples/phantom-scan.npz").json()["code"] == "file-missing"
    below_help = (
        *("../settings.py", "%2e%2e/settings.py", "..%2f..%2fpyproject.toml", "do/../../../pyproject.toml"),
        *("//etc/passwd", "%2Fetc%2Fpasswd", "do/run%00", "do\\run", "generate.py", "docs/do/run.md", "do/run.md"),
        *("documents/LICENSE", "examples/../../settings.py"),
    )
    below_static = ("../app.py", "%2e%2e/app.py", "/etc/passwd", "")
    below = {"/static": below_static, "/console": ["..%2f__init__.py"], "/help": below_help}
    for path in (f"{folder}/{each}" for folder, names in below.items() for each in names):
        answer = client.get(path)
        assert answer.status_code in {404, 422}, path
        assert answer.headers["Content-Type"] == "application/problem+json", path


def test_an_installation_without_documents_names_the_remedy(tmp_path):
    """The package alone was copied: its links lead nowhere."""
    shutil.copytree(ROOT / "service/sawmill_service", tmp_path / "a/service/sawmill_service", symlinks=True)
    program = """
from types import SimpleNamespace
from sawmill_service.pages.help import help
assert help.search("scan", "en") == []
help.help_list(SimpleNamespace(language="en"), "")
"""
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}/a/service:{ROOT}/service:{ROOT}/worker"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert "this installation has no documents: install the service again, from its wheel" in done.stderr


@pytest.mark.slow
def test_the_wheel_has_the_documents(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", tmp_path]
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    source = tmp_path / "source"
    for name in filter(None, tracked.split("\0")):
        if name.startswith(("service/", "worker/", "docs/", "examples/")) or "/" not in name:
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    subprocess.run([*command, source], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if "/documents/" in name}
    assert {
        f"sawmill_service/documents/{name}"
        for name in filter(None, tracked.split("\0"))
        if name.startswith(("docs/", "examples/")) and not name.endswith(".py")
    } <= inside
    assert "sawmill_service/documents/LICENSE" in inside
    assert not [name for name in inside if name.endswith(".py") and "/docs/" in name]


ENGLISH = re.compile(r"\b(?:the|of|and|with|was|is|not|by|for|from|at|to be)\b")
# Texts of people, which stay as they were typed.
TYPED = re.compile(r"line-4_2026\S*|Sorting line 4, log scanner behind the debarker|the cross of the hall")
# Pages whose subject is the API, its codes or its values.
TECHNICAL = {"problems", "problem", "audit", "webhooks"}


def english_in_sight(html: str) -> list[str]:
    """Texts of a page that are English or declared to be, but no code and nothing that is folded."""
    for tag in ("script", "style", "code", "datalist", "details"):
        while (less := re.sub(rf"<{tag}\b(?:(?!<{tag}\b).)*?</{tag}>", " ", html, flags=re.DOTALL)) != html:
            html = less
    declared = [text for _, text in re.findall(r'<(\w+)[^>]* lang="en"[^>]*>(.*?)</\1>', html, re.DOTALL)]
    spoken = re.findall(r'(?:alt|aria-label|placeholder|title)="([^"]*)"', html) + re.split(r"<[^>]*>", html)
    return [text for text in declared if re.search(r"[a-z]{3}", text)] + [
        text for text in spoken if ENGLISH.search(TYPED.sub("", unescape(text)))
    ]


def test_pages_of_a_bad_day_are_finnish_without_english_in_sight(seeded, store, worker):
    finnish = {"Accept": "text/html", "Accept-Language": "fi"}
    pages = {
        name: seeded.get(path, headers=finnish).text for name, path in mill_states.fill(store, worker, "fi").items()
    }
    shown = '<p lang="en">seen</p><p title="by x"><details>of<details>of</details></details>'
    assert english_in_sight(shown) == ["seen", "by x"]
    assert {name: found for name in pages.keys() - TECHNICAL if (found := english_in_sight(pages[name]))} == {}
