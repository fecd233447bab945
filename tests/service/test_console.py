"""The pages work without internet: everything that they load is served here."""

import re

import pytest

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
