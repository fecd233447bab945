"""The documents at /help: every link and picture leads somewhere, words are found, and nothing else is served."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from html import unescape
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import pytest
from page_text import absent

from sawmill_service.http.gate import CONTENT_POLICY
from sawmill_service.pages.help.documents import all_documents

ROOT = Path(__file__).parents[2]
TEMPLATES = ROOT / "service/sawmill_service/templates/pages"
BROWSER = {"Accept": "text/html"}
# Folders of the sources, which an installation has not: a document names their files, and the site has no link there.
SOURCES = (".github", "benchmarks", "installation", "openapi", "service", "tests", "worker")
# What the policy would forbid, or allows for the API console alone.
INLINE = r"<script(?! type=.module. src=./static/)|<style|<[^>]* (?:style|on\w+)="


def article(html: str) -> str:
    """A document, without the frame around it."""
    return html[html.index("<article") : html.index("</article>")]


def addresses(html: str) -> list[str]:
    return [unescape(each) for each in re.findall(r'(?:href|src)="([^"]+)"', html)]


def test_every_link_and_picture_of_every_page_leads_somewhere(client):
    seen, waiting, broken = {}, ["/help"], []
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


def test_a_link_without_an_address_here_is_to_a_source():
    for document in all_documents("en"):
        source = (ROOT / "docs" / f"{document.path}.md") if document.path else ROOT / "docs/README.md"
        for text in re.findall(r"<span>(.*?)</span>", document.html):
            plain = re.escape(unescape(re.sub(r"<[^>]+>", "", text)))
            links = re.findall(rf"\[`?{plain}`?\]\(([^)#]+)", source.read_text())
            assert all((source.parent / link).resolve().relative_to(ROOT).parts[0] in SOURCES for link in links), links


def test_every_page_of_the_product_names_a_page_that_helps(client):
    named = {}
    for path in TEMPLATES.glob("*.html"):
        for page in re.findall(r"""set help = (?:help \| default\()?"([\w/-]+)"|"/help/([\w/-]+)""", path.read_text()):
            named["".join(page)] = path.name
    assert {"do/technician", "understand/drift", "do/webhooks"} <= named.keys()
    assert {page: name for page, name in named.items() if client.get(f"/help/{page}").status_code != 200} == {}
    assert 'href="/help/do/technician"' in client.get("/", headers=BROWSER).text
    without = {
        path.name
        for path in TEMPLATES.glob("*.html")
        if '{% extends "pages/base.html" %}' in path.read_text() and "set help" not in path.read_text()
    }
    assert without == {"login.html", "login_display.html", "help.html", "help_search.html"}


def test_a_document_is_rendered_as_the_repository_s_host_renders_it(client):
    page = article(client.get("/help/look-up/codes", headers=BROWSER).text)
    assert absent(page, '<h2 id="429-too-many-requests">', '<div class="scrolls" tabindex="0"><table>') == []
    assert "<td><code>queue-full</code></td>" in page
    everything = "".join(document.html for document in all_documents("en"))
    assert not re.search("(?<!<code>)&lt;!--", re.sub("<pre.*?</pre>", "", everything, flags=re.DOTALL)), "a comment"


def test_a_document_in_two_languages_comes_in_the_reader_s(client):
    finnish = client.get("/help/do/technician", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert '<article class="card" lang="fi">' in finnish
    assert 'href="/help/do/technician.en" lang="en" hreflang="en"' in finnish
    english = client.get("/help/do/technician.en", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert absent(english, '<html lang="fi"', '<article class="card" lang="en">') == []
    assert 'href="/help/do/technician.fi"' in article(english)
    other = client.get("/help/look-up/codes", headers=BROWSER | {"Accept-Language": "fi"}).text
    assert '<article class="card" lang="en">' in other


@pytest.mark.parametrize(
    ("words", "language", "address"),
    [
        ("queue-full", "en", "/help/look-up/codes#429-too-many-requests"),
        ("sawmill_port", "en", "/help/look-up/settings#network-and-access"),
        ("skannerilla", "fi", "/help/do/technician#skannerilla"),
    ],
)
def test_a_search_finds_what_is_known_first(client, words, language, address):
    found = client.get("/help", params={"search": words}, headers=BROWSER | {"Accept-Language": language})
    assert re.findall(r'<h2><a href="([^"]+)"', found.text)[0] == address
    assert found.text.lower().count("<mark>") >= 1


def test_a_search_takes_any_text(client):
    nothing = client.get("/help", params={"search": '<b>"nobody" .*[('}, headers=BROWSER)
    assert nothing.status_code == 200
    assert "No page of the help has all these words." in nothing.text
    assert "<b>" not in nothing.text
    assert client.get("/help", params={"search": " "}, headers=BROWSER).text.count("<article") == 1
    assert client.get("/help", params={"search": "x" * 201}).status_code == 422


@pytest.mark.parametrize(
    "path",
    [
        "../settings.py",
        "%2e%2e/settings.py",
        "..%2f..%2fpyproject.toml",
        "do/../../../pyproject.toml",
        *("/static/../app.py", "/static/%2e%2e/app.py", "/console/..%2f__init__.py", "/static//etc/passwd", "/static/"),
        "//etc/passwd",
        "%2Fetc%2Fpasswd",
        "do/run%00",
        "do\\run",
        "generate.py",
        "docs/do/run.md",
        "do/run.md",
        "documents/LICENSE",
        "examples/../../settings.py",
    ],
)
def test_nothing_else_is_served(client, path):
    answer = client.get(path if path.startswith(("/static", "/console")) else f"/help/{path}")
    assert answer.status_code in {404, 422}
    assert answer.headers["Content-Type"] == "application/problem+json"


def test_files_are_sent_as_downloads_with_a_tag(client):
    picture = client.get("/help/pictures/geometry.svg")
    assert (picture.headers["Content-Type"], picture.status_code) == ("image/svg+xml", 200)
    again = client.get("/help/pictures/geometry.svg", headers={"If-None-Match": picture.headers["ETag"]})
    assert again.status_code == 304
    script = client.get("/help/examples/clients/whole_job.sh")
    assert script.headers["Content-Disposition"] == 'attachment; filename="whole_job.sh"'
    assert script.text == (ROOT / "examples/clients/whole_job.sh").read_text()


def test_an_installation_without_documents_names_the_remedy(tmp_path):
    """The package alone was copied: its links lead nowhere."""
    shutil.copytree(ROOT / "service/sawmill_service", tmp_path / "a/service/sawmill_service", symlinks=True)
    program = """
from types import SimpleNamespace
from sawmill_service.pages.help import help, search
assert search.search("scan", "en") == []
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
    documents = {
        f"sawmill_service/documents/{name}"
        for name in filter(None, tracked.split("\0"))
        if name.startswith(("docs/", "examples/")) and not name.endswith(".py")
    }
    assert documents <= inside
    assert "sawmill_service/documents/LICENSE" in inside
    assert not [name for name in inside if name.endswith(".py") and "/docs/" in name]
