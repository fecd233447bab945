"""What a page of ours says."""

import re


def text_of(html: str) -> str:
    """In one line, without its tags."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")
