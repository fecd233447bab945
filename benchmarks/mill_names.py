"""Causes that an answer's sentences name, and the causes that belong to each effect."""

import re
from collections.abc import Iterable, Mapping

# Causes by the words of a sentence of adjustments or reasons. One sentence may name several causes.
CAUSES: Mapping[str, str] = {
    "hardening": r"harden",
    "scatter": r"scatter|glare",
    "blur": r"\bblur",
    "exposure": r"while a view is exposed|during the exposure",
    "tube": r"gain (and|or) (offset|background)|views' gain|gain of each view|tube|source's output",
    "lag": r"\blag\b|afterglow",
    "flat field": r"flat.field|flat fields",
    "faulty cells": r"detector cells|single cells|unequal gain",
    "saturation": r"saturat|largest value|full scale",
    "corrupt views": r"corrupt views|views that do not fit|few views do not fit",
    "slip": r"phantom moved|slip|angles jump",
    "wobble": r"wobbl",
    "creep": r"creep",
    "encoder": r"ahead and behind",
    "angle jitter": r"jitter|angles scatter|uneven angles",
    "pace": r"times as far|run away|\bpace\b",
    "aspect": r"aspect|shear|longer in|\bwet\b|not square",
    "drawing": r"drawing that is not its shape|coarse picture",
    "corners": r"corner",
    "bow": r"bent in its plane|wider at one end",
    "wood": r"\bknot|not uniform|moisture|\brings?\b|\bgrain\b|of the surface is",
    "density slope": r"density slopes",
    "metal": r"metal|steel|screw|nail",
    "outliers": r"outlier",
}
# Sentences that are no finding about the scan.
NO_FINDING = r"predicted ray error|source shift is not resolved|source distance was held|Sizes are not certain"
# Causes that name an effect; empty where no cause needs to.
NAMED_BY: Mapping[str, frozenset[str]] = {
    "hardening": frozenset({"hardening", "scatter"}),
    "scatter": frozenset({"scatter", "hardening"}),
    "blur": frozenset({"blur"}),
    "exposure": frozenset({"exposure", "blur"}),
    "tube": frozenset({"tube"}),
    "past the end": frozenset({"scatter", "hardening"}),
    "thin row": frozenset(),
    "lag": frozenset({"lag"}),
    "flat field": frozenset({"flat field"}),
    "faulty cells": frozenset({"faulty cells"}),
    "12 bits": frozenset(),
    "saturation": frozenset({"saturation"}),
    "slip": frozenset({"slip"}),
    "wobble once": frozenset({"wobble"}),
    "wobble twice": frozenset({"wobble"}),
    "creep": frozenset({"creep"}),
    "encoder": frozenset({"encoder"}),
    "angle jitter": frozenset({"angle jitter", "corrupt views"}),
    "pace": frozenset({"pace"}),
    "aspect": frozenset({"aspect"}),
    "tilted plane": frozenset({"aspect"}),
    "corners": frozenset({"corners", "drawing"}),
    "roughness": frozenset({"drawing", "corners"}),
    "rings": frozenset({"wood", "density slope"}),
    "knots": frozenset({"wood", "density slope"}),
    "density slope": frozenset({"density slope"}),
    "screws": frozenset({"metal"}),
}
# At most this number of causes may be named for one.
MOST_CAUSES = 3


def causes(sentences: Iterable[str]) -> frozenset[str]:
    """Find the causes that the headlines of the sentences name."""
    findings = [re.split(r"[;:]|\. ", one)[0].lower() for one in sentences if not re.search(NO_FINDING, one)]
    return frozenset(name for name, said in CAUSES.items() if any(re.search(said, one) for one in findings))


def names_it(effect: str, named: frozenset[str]) -> bool:
    """Return whether the effect is named, alone or among few."""
    return bool(NAMED_BY[effect] & named) and len(named) <= MOST_CAUSES
