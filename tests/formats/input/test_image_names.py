"""Names of images as other programs write them: which are views, in which order, and which are fields."""

import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.contents import FieldKind
from sawmill_formats.input.image_names import sorted_images
from sawmill_vocabulary.reading_messages import ReadingMessage

ANGLES = [f"{angle:g}" for angle in np.arange(0.5, 360.0, 4.0)]
GOLDEN = [f"{angle:.2f}" for angle in np.mod(np.arange(90) * 222.4922359, 360.0)]
FLATS, DARKS = FieldKind.FLATS, FieldKind.DARKS


def count(form, number=90, first=0):
    return [form.format(n) for n in range(first, first + number)]


def of_angles(form, angles):
    return [form.format(n, angle) for n, angle in enumerate(angles)]


VIEWS = count("scan_{:03d}.tif")


def sort(names, **given):
    """Sort shuffled names: the views, flats and darks by name, and the remarks."""
    shuffled = [names[n] for n in np.random.default_rng(48).permutation(len(names))]
    places, remarks = sorted_images(shuffled, **given)
    return *([shuffled[n] for n in places[kind]] for kind in (None, FLATS, DARKS)), tuple(remarks)


# Views in the order of their numbers, without a remark.
HONEST = {
    "zeros before": VIEWS,
    "no zeros before": count("proj{}.tiff"),
    "a hyphen before": count("scan-{}.TIF", first=2),
    "two hyphens before": count("scan--{:04d}.tif"),
    "dates before": count("scan-2024-01-05-{}.tif"),
    "decimals": [f"view_{angle}.tif" for angle in ANGLES],
    "decimals with commas": [f"view_{angle}.tif".replace(".", ",", 1) for angle in ANGLES],
    "quarters of a degree": [f"{n * 0.25:g}.tif" for n in range(41)],
    "thirds of a degree, rounded": [f"{n / 3:.2f}.tif" for n in range(1080)],
    "signs": [f"view_{float(angle) - 180:.1f}.tif" for angle in ANGLES],
    "signs after letters": [f"ang{float(angle) - 180:.1f}.tif" for angle in ANGLES],
    "signs before all numbers": [f"a{float(angle) - 180:+.1f}.tif" for angle in ANGLES],
    "angles with their unit": [f"scan_{angle:03d}deg.tif" for angle in range(0, 360, 4)],
    "a counter and the angle": of_angles("scan_{:04d}_{}.tif", ANGLES),
    "a counter and golden angles": of_angles("scan_{:04d}_{}.tif", GOLDEN),
    "a counter and angles that fall": of_angles("scan_{:04d}_{}.tif", ANGLES[::-1]),
    "times and a counter": [f"scan_{101507 + n * n}_{n:04d}.tif" for n in range(40)],
    "midnight and a counter": [*count("0105_235958_{:04d}.tif", 3), *count("0106_000001_{:04d}.tif", 2, first=3)],
    "times alone": [f"{20240105101500 + n * n}.tif" for n in range(40)],
    "a number before and after": count("log12.{}_of_90.tif", first=1),
    "dots between": count("log.12.0.{}.tif", first=1),
    "images of a log that is white oak": count("white_oak_{}.tif"),
    "flat-sawn wood": count("Oak_flat_sawn_{}.tif"),
    "corrected by flat and dark fields": count("flat_dark_corrected_{}.tif"),
    "an observation that is no open beam": count("scan_ob12_{}.tif"),
    "folders around all": count("LOG_in_dark_room/1/view_{}.tif"),
    "a folder for each view": count("v{}/image.tif"),
    "a folder for every ten views": [f"{n // 10:02d}/{n:04d}.tif" for n in range(90)],
    "capitals and none": [f"{'IMG' if n % 2 else 'img'}_{n}.tif" for n in range(90)],
    "one file": ["all.tif"],
    "letters": ["a.tif"],
    "one view": ["a.tif"],
}


@pytest.mark.parametrize("names", HONEST.values(), ids=HONEST)
def test_views_are_sorted_by_their_numbers_without_a_remark(names):
    assert sort(names) == (names, [], [], ())


FIELDS = {
    "words before": (count("flat_{}.tif", 9), count("dark_{}.tif", 9)),
    "words without a space": (count("FlatField{:02d}.tif", 9), count("darkfield{:02d}.tif", 9)),
    "words in the middle": (count("LOG_Flat_Before_{}.tif", 9), count("LOG_Dark_After_{}.tif", 9)),
    "white and offset": (count("white{}.tif", 9), count("Offset_{}.tif", 9)),
    "bright and bias": (count("bright_field_{}.tif", 9), count("bias_{}.tif", 9)),
    "two letters": (count("io{:04d}.tif", 9), count("di{:04d}.tif", 9)),
    "i zero": (count("I0_{:04d}.tif", 9), count("DF_{:04d}.tif", 9)),
    "open beam": (count("openbeam_{}.tif", 9), count("DarkCurrent_{}.tif", 9)),
    "ob and df": (count("OB_{}.tif", 9), count("df{}.tif", 9)),
    "ff": (count("ff-{}.tif", 9), []),
    "air": (count("air_{}.tif", 3), []),
    "folders": (count("Flat_Before/IMG_{}.tif", 9), count("Dark_After/IMG_{}.tif", 9)),
    "folders of Windows": (count("scan\\Flats\\{}.tif", 9), count("scan\\Darks\\{}.tif", 9)),
    "the log's name too": (count("white_oak_flat_{}.tif", 9), count("white_oak_dark_{}.tif", 9)),
}


@pytest.mark.parametrize(("flats", "darks"), FIELDS.values(), ids=FIELDS)
@pytest.mark.parametrize("views", [VIEWS, count("scan/proj/IMG_{:04d}.tif")])
def test_fields_are_recognised_by_the_words_of_other_programs(views, flats, darks):
    assert sort([*views, *flats, *darks]) == (views, flats, darks, ())


# Names that are no views, beside views; each is left out and named.
OTHERS = {
    "half a turn": (VIEWS, ["scan_180deg.tif", "scan_360deg.tif"]),
    "half a turn in a folder": (count("Tomo/LOG_{:04d}.tif"), ["180deg/LOG_180_0000.tif"]),
    "averages": (VIEWS, ["a/thumb_1.tif", "average.tif"]),
    "fields of an unclear name": (VIEWS, count("background_{}.tif", 2)),
    "flat and dark": (VIEWS, ["flat_dark_1.tif"]),
    "a copy": (VIEWS, ["scan_007 (1).tif"]),
}


@pytest.mark.parametrize(("views", "others"), OTHERS.values(), ids=OTHERS)
def test_names_that_differ_are_left_out_and_named(views, others):
    left_out = ReadingMessage.IMAGES_LEFT_OUT(images=len(others), names=", ".join(others))
    assert sort([*views, *others]) == (views, [], [], (left_out,))


GAP, REPEATED = ReadingMessage.NUMBERS_LEFT_OUT, ReadingMessage.NUMBERS_REPEATED
FORMS, SORTED = ReadingMessage.NAMES_OF_SEVERAL_FORMS, ReadingMessage.SORTED_BY_NUMBER
BY_ANGLE = of_angles("a_{1}_{0:04d}.tif", GOLDEN)
MANY = "90, 91, 92, 93, 94, 95, 96, 97, 98, 99, ..."
# The views in their order, and the remark.
REMARKED = {
    "a gap": (VIEWS[:30] + VIEWS[31:], GAP(numbers="30", missing=1, total=90)),
    "a gap in angles": ([f"{a}.tif" for a in ANGLES[:2] + ANGLES[4:]], GAP(numbers="8.5, 12.5", missing=2, total=90)),
    "half a turn by its number": ([*count("{}.tif"), "180.tif"], GAP(numbers=MANY, missing=90, total=181)),
    "a number twice": ([*VIEWS[:8], "scan_7.tif", *VIEWS[8:]], REPEATED(repeated=1, names="scan_007.tif, scan_7.tif")),
    "golden angles before a counter": (
        BY_ANGLE,
        SORTED(position=2, names="a_0.00_0000.tif, a_222.49_0001.tif, a_84.98_0002.tif, ..."),
    ),
    "golden angles alone": (
        [f"{angle}.tif" for angle in sorted(GOLDEN, key=float)],
        SORTED(position=1, names="0.00.tif, 1.81.tif, 4.74.tif, ..."),
    ),
    "two numbers that do not agree": (
        ["1_5.tif", "2_5.tif", "2_9.tif", "4_1.tif"],
        SORTED(position=1, names="1_5.tif, 2_5.tif, 2_9.tif, ..."),
    ),
    "a number of two parts": (
        [f"a{n // 2}_{n % 2 * 5}.tif" for n in range(90)],
        SORTED(position=1, names="a0_0.tif, a0_5.tif, a1_0.tif, ..."),
    ),
    "numbers below 0 alone": (
        [f"turn_{n - 4}.tif" for n in range(5)],
        SORTED(position=1, names="turn_-4.tif, turn_-3.tif, turn_-2.tif, ..."),
    ),
    "a sequence that continues under another name": (
        [*count("a_{}.tif", 45), *count("b_{}.tif", 45, first=45)],
        FORMS(forms=2, names="a_#, b_#"),
    ),
    "letters": (["a.tif", "b.tif", "c.tif"], FORMS(forms=3, names="a, b, c")),
}


@pytest.mark.parametrize(("views", "remark"), REMARKED.values(), ids=REMARKED)
def test_numbers_that_are_missing_repeated_or_contradictory_are_named(views, remark):
    *images, (found,) = sort(views)
    assert (images, found.message) == ([views, [], []], remark.message)
    assert found.values == remark.values


SEVERAL = {
    "folders": (count("monday/scan_{}.tif") + count("tuesday/scan_{}.tif"), "monday/scan_#, tuesday/scan_#"),
    "numbered folders": (count("part1/scan_{}.tif") + count("part2/scan_{}.tif"), "part1, part2"),
    "numbers before": (count("log7_{}.tif") + count("log8_{}.tif"), "log7_0, log8_89"),
    "prefixes": (count("top_{}.tif") + count("bottom_{}.tif", 60), "#"),
    "more fields than views can have": (count("scan_{}.tif") + count("blank_{}.tif", 60), "blank_#"),
}


@pytest.mark.parametrize(("names", "named"), SEVERAL.values(), ids=SEVERAL)
def test_several_scans_are_refused_by_their_names(names, named):
    with pytest.raises(UnreadableScan) as refused:
        sort(names)
    assert refused.value.code == "contradiction"
    assert all(part in str(refused.value) for part in named.split(", "))


@pytest.mark.parametrize("fields", FieldKind)
def test_fields_alone_are_of_the_kind_that_their_names_state(fields):
    flats, darks = count("io_{}.tif", 9), count("di_{}.tif", 5)
    assert sort([*flats, *darks], fields=fields) == ({FLATS: flats, DARKS: darks}[fields], flats, darks, ())
    assert sort(count("IMG_{}.tif", 3), fields=fields) == (count("IMG_{}.tif", 3), [], [], ())
    flats = count("Flats/{}.tif", 3)
    assert sort(flats, fields=fields) == (flats if fields is FLATS else [], flats, [], ())
