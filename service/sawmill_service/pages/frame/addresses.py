"""Addresses of the service's own pages."""

import re


def local_path(path: str) -> str:
    r"""Return the path if it is one of this service, else Today's: `//` and `/\` may lead to another site."""
    return path if re.fullmatch(r"(?![^?]*//)/[!-\[\]-~]*", path) else "/"
