"""Addresses of our own pages."""

import re


def local_path(path: str) -> str:
    r"""A path of this service, else Today's: nothing leads to another site, as `//` and `/\` would."""
    return path if re.fullmatch(r"/(?!/)[!-\[\]-~]*", path) else "/"
