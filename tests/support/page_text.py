"""What a page of ours says."""

import re


def text_of(html: str) -> str:
    """In one line, without its tags."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")


def absent(text: object, *parts: str) -> list[str]:
    """Those parts that a text does not have."""
    return [part for part in parts if part not in text]
