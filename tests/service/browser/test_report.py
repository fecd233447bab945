"""The report as a browser shows and prints it."""

import re

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

A4_PT = (595, 842)
MOST_BYTES = 900_000


def test_the_report_prints_on_two_pages_of_a4_and_fits_a_phone(site):
    page = site.open("/calibrations/example/report")
    assert len(page.content()) < MOST_BYTES
    # Without headers and footers of the browser's own: the page brings its own. Finnish words are longer.
    for language in ("fi", "en"):
        page.goto(f"/calibrations/example/report?language={language}")
        pdf = page.pdf(prefer_css_page_size=True)
        assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 2
    width, height = (float(number) for number in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf).groups())
    assert (width, height) == pytest.approx(A4_PT, abs=1.0)  # 210 x 297 mm
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
