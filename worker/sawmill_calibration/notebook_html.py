"""Results as notebooks show them."""

from base64 import b64encode
from collections.abc import Sequence

from sawmill_worker.templating import templates_of

TEMPLATES = templates_of("sawmill_calibration")


def html_of(
    title: str,
    rows: Sequence[tuple[str, object]],
    *,
    verdict: str | None = None,
    sentences: Sequence[str] = (),
    png: bytes | None = None,
) -> str:
    """Return a title with a verdict, sentences, a table of labels and values, and a picture; all text is escaped."""
    picture = None if png is None else b64encode(png).decode("ascii")
    page = TEMPLATES.get_template("result.html")
    return page.render(title=title, rows=rows, verdict=verdict, sentences=sentences, picture=picture)
