"""Templates of pages and drawings."""

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
