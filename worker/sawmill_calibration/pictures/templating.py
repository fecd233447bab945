"""Templates of pages and drawings, and results as notebooks show them."""

from base64 import b64encode
from collections.abc import Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined


def templates_of(package: str, extensions: Sequence[str] = ()) -> Environment:
    """Load the templates in a package's folder `templates`; values are escaped, and a missing name is an error."""
    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=extensions,
    )


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
    page = templates_of("sawmill_calibration.pictures").get_template("result.html")
    return page.render(title=title, rows=rows, verdict=verdict, sentences=sentences, picture=picture)
