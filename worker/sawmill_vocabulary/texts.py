"""The mark of texts for people, which are translated when they are shown, and a word in names of fields."""

GROUP = "scanner"
"""Name of a group of jobs: groups take turns in the queue, and an event has the id of its group."""


def N_(text: str) -> str:  # noqa: N802 - Babel's word for a text that is translated when it is shown
    """Mark a text for the catalogues, and return it unchanged."""
    return text
