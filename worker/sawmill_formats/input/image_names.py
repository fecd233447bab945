"""Names of the images in an archive or a folder: which are views, in which order, and which are fields."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from decimal import Decimal
from itertools import chain, islice, pairwise
from pathlib import PurePosixPath
from statistics import median_low
from typing import NamedTuple

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.contents import FieldKind, kinds_in, words_of
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

MOST_QUOTED = 10
# Larger numbers are dates and times, which have gaps.
LARGEST_COUNTER = 10**9
# Share of the usual step by which numbers that were rounded may differ from equal steps.
ROUNDING = Decimal("0.1")

_OF_VIEWS = frozenset({"corrected", "corr", "normalised", "normalized", "subtracted"})
_NUMBER = re.compile(r"(?:(?<![a-z\d-])[-+])?(?:(?<![\d.,])\d+[.,]\d+(?![.,]?\d)|\d+)", re.ASCII)
# A hyphen after a letter is a sign where other names have none there.
_SIGNED = re.compile(_NUMBER.pattern.replace("a-z", ""), re.ASCII)


class _Image(NamedTuple):
    """An image's place and name, its name without the numbers, equal in a sequence, and the numbers."""

    place: int
    name: str
    form: str
    numbers: list[str]


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort view-2 before view-10."""
    return [
        (0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name.lower()) if part
    ]


def listed(names: Iterable[str], most: int = MOST_QUOTED) -> str:
    """Quote the first names, with dots if there are more."""
    first = [quoted(name) for name in islice(names, most + 1)]
    return ", ".join([*first[:most], "..."] if len(first) > most else first)


def sorted_images(
    names: Sequence[str], fields: FieldKind | None = None
) -> tuple[dict[FieldKind | None, list[int]], list[Reason]]:
    """Select views (None) and fields by the words in the images' names, and sort them by the numbers.

    Names are paths in an archive or a folder. Images are returned as their places in the list of names, with remarks;
    several scans are refused: `contradiction`. Where `fields` are read, images without a kind are such fields.
    """
    paths = [name.replace("\\", "/") for name in names]
    stems = [str(PurePosixPath(path.lower()).with_suffix("")) for path in paths]
    forms = {_NUMBER.sub("#", stem) for stem in stems}
    others = (form.replace("-#", sign) for form in forms if "-#" in form for sign in ("#", "+#"))
    number = _NUMBER if forms.isdisjoint(others) else _SIGNED
    images = [_Image(n, paths[n], number.sub("#", stem), number.findall(stem)) for n, stem in enumerate(stems)]
    images.sort(key=lambda image: (natural_key(image.name), image.name))
    kinds = _kinds(paths, of_fields=fields is not None)
    by_kind = {kind: [image for image in images if kinds[image.place] is kind] for kind in (None, *FieldKind)}
    remarks: list[Reason] = []
    if fields is None:
        by_kind[None], remarks = _sequence(by_kind[None])
    else:
        by_kind[None] = by_kind[None] or by_kind[fields]
    return {kind: [image.place for image in of_kind] for kind, of_kind in by_kind.items()}, remarks


def _kinds(paths: Sequence[str], *, of_fields: bool) -> list[FieldKind | None]:
    """Return the kind that each image's name or nearest folder states, not by a word that most of them have."""
    words = [[_field_words(part) for part in reversed(PurePosixPath(path).parts)] for path in paths]
    unsure = [set().union(*parts) for parts in words if not any("^" in word for part in parts for word in part)]
    counts = Counter(chain.from_iterable(unsure))
    usual = set() if of_fields else {word for word, count in counts.items() if 2 * count > len(unsure)}
    stated = ([{part[word] for word in part.keys() - usual} for part in parts] for parts in words)
    kinds = (next(filter(None, parts), set()) for parts in stated)
    return [kind.pop() if len(kind) == 1 else None for kind in kinds]


def _field_words(part: str) -> dict[str, FieldKind]:
    """Return a name's words that name fields, the first marked by ^: flat and dark tell more than other words."""
    stem = PurePosixPath(part).stem
    words = words_of(stem)
    kinds = {} if _OF_VIEWS.intersection(words) else kinds_in(words)
    sure = {word: kind for word, kind in kinds.items() if word.startswith(("flat", "dark"))}
    return {"^" * stem.lower().startswith(word) + word: kind for word, kind in sure.items()} or kinds


def _sequence(images: list[_Image]) -> tuple[list[_Image], list[Reason]]:
    """Return the views in their order, and remarks; a form of names that few images have is of no view."""
    forms = Counter(image.form for image in images)
    least = max([2, *forms.values()]) / 2
    sequences = [form for form, count in forms.items() if count > 1 and count >= least]
    views = [image for image in images if image.form in sequences]
    several = ReadingMessage.NAMES_OF_SEVERAL_FORMS
    if 2 * len(views) <= len(images):
        return images, [several(forms=len(forms), names=listed(forms))] if len(forms) > 1 else []
    if len(sequences) == 1:
        views, remarks = _by_numbers(views)
    else:
        last = {image.place: _decimals(image.numbers[-1:]) for image in views}
        if len({(image.form, last[image.place]) for image in views}) > len({*last.values()}):
            raise _several_scans(sequences)
        views.sort(key=lambda image: last[image.place])
        remarks = [several(forms=len(sequences), names=listed(sequences))]
    left_out = [image.name for image in images if image.form not in sequences]
    if left_out:
        remarks.append(ReadingMessage.IMAGES_LEFT_OUT(images=len(left_out), names=listed(left_out)))
    return views, remarks


def _several_scans(sequences: Iterable[str]) -> UnreadableScan:
    return UnreadableScan(
        "contradiction",
        f"several sequences of images have the same numbers in their names ({listed(sequences)}); give the views of "
        "one scan alone, and call flat and dark fields flat and dark",
    )


def _by_numbers(images: list[_Image]) -> tuple[list[_Image], list[Reason]]:
    """Sort images of one form, by the number that counts them where several numbers vary."""
    folders, files = zip(*(image.name.rpartition("/")[::2] for image in images), strict=True)
    if len({*files}) < len(files) > len({*folders}) > 1:
        raise _several_scans(dict.fromkeys(folders))
    rows = _rows(images)
    images.sort(key=lambda image: rows[image.place])
    columns = dict(enumerate(zip(*(rows[image.place] for image in images), strict=True)))
    varying = {place: column for place, column in columns.items() if len({*column}) > 1}
    counters = {place: spacing for place, column in varying.items() if (spacing := _spacing(column))}
    lengths = [len({*column}) for column in varying.values()]
    if len(lengths) == 2 and lengths[0] < lengths[1] and lengths[0] * lengths[1] == len(images):
        raise _several_scans([images[0].name, images[-1].name])  # each number before goes with all that count
    by = min(counters or varying, key=lambda place: place in counters and counters[place][0] != 1, default=0)
    remarks = counters[by][1] if by in counters else []
    in_order = all(before <= after for column in varying.values() for before, after in pairwise(column))
    if by in counters:
        in_order = [*varying[by]] == sorted(varying[by])
        images.sort(key=lambda image: rows[image.place][by])
    elif varying:  # angles in unequal steps, which may have been measured in another order
        in_order = in_order and not any(number % 1 for number in varying[by])
    # Numbers below 0 alone may count down.
    if varying and (not in_order or max(varying[by]) <= 0):
        names = listed((image.name for image in images), 3)
        remarks.append(ReadingMessage.SORTED_BY_NUMBER(position=by + 1, names=names))
    repeated = [pair for pair in pairwise(images) if rows[pair[0].place] == rows[pair[1].place]]
    if repeated:
        names = listed(image.name for image in repeated[0])
        remarks.append(ReadingMessage.NUMBERS_REPEATED(repeated=len(repeated), names=names))
    return images, remarks


def _decimals(texts: Iterable[str]) -> tuple[Decimal, ...]:
    return tuple(Decimal(text.replace(",", ".")) for text in texts)


def _rows(images: Sequence[_Image]) -> dict[int, tuple[Decimal, ...]]:
    """Return the numbers of each image by its place: 12.5 is one number, unless there are 12.1 and 12.10."""
    decimals = {image.place: _decimals(image.numbers) for image in images}
    integers = {image.place: _decimals(re.split("[.,]", ".".join(image.numbers))) for image in images}
    return integers if len({*decimals.values()}) < len({*integers.values()}) else decimals


def _spacing(column: Sequence[Decimal]) -> tuple[Decimal, list[Reason]] | None:
    """Return the step of equally spaced numbers, and a remark where some are missing; None for other numbers."""
    numbers = sorted({*column})
    steps = [after - before for before, after in pairwise(numbers)]
    if len(numbers) < len(column) or not steps or max(map(abs, numbers)) >= LARGEST_COUNTER:
        return None
    step = median_low(steps)
    times = [round(each / step) for each in steps]
    if any(not n or abs(each - n * step) > ROUNDING * step for n, each in zip(times, steps, strict=True)):
        return None
    missing = sum(times) - len(times)
    absent = (f"{number + n * step:f}" for number, up in zip(numbers, times, strict=False) for n in range(1, up))
    total = len(column) + missing
    gaps = [ReadingMessage.NUMBERS_LEFT_OUT(numbers=listed(absent), missing=missing, total=total)] if missing else []
    return step, gaps
