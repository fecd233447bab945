"""Parts of a file, one after the other, from headers alone."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum


class PartKind(StrEnum):
    """Names of parts in their format."""

    GROUP = "group"
    DATASET = "dataset"
    LINK = "link"
    VARIABLE = "variable"
    ARRAY = "array"
    PAGE = "page"
    FILE = "file"
    PICTURE = "picture"


@dataclass(frozen=True)
class Part:
    """A part as its header describes it."""

    name: str  # path in the file; for several similar parts, the first and the last
    kind: PartKind
    shape: tuple[int, ...] | None = None  # shape in the axis order of the file
    type: str | None = None  # type of the numbers, or what the part is instead
    unit: str | None = None  # unit as in the file
    stored_bytes: int | None = None  # bytes in the file; for several similar parts, of all of them
    compression: str | None = None  # the filters through which it is stored
    leads_to: str | None = None  # target of a link, or place of data in another file
    count: int = 1  # the number of parts, which are alike but for their numbers


def alike_together(parts: Iterable[Part]) -> Iterator[Part]:
    """Combine successive parts that differ only in the numbers in their names and in their bytes."""
    run: list[Part] = []
    for part in parts:
        if run and _form(run[0]) != _form(part):
            yield _as_one(run)
            run = []
        run.append(part)
    if run:
        yield _as_one(run)


def _form(part: Part) -> Part:
    return replace(part, name=re.sub(r"\d+", "#", part.name), stored_bytes=None)


def _as_one(run: list[Part]) -> Part:
    first, last = run[0], run[-1]
    if len(run) == 1:
        return first
    stored = sum(part.stored_bytes or 0 for part in run)
    name = f"{first.name} to {last.name.rpartition('/')[2]}"
    return replace(first, name=name, count=len(run), stored_bytes=stored or None)
