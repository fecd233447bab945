import pytest

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_platform.files.whole_files import DISK_AWAY


def test_a_librarys_complaint_becomes_one_sentence_with_its_cause():
    cause = ValueError("bad\nheader")
    sentence = r"this NPY file is incomplete or damaged \(bad header\)"
    with pytest.raises(UnreadableScan, match=sentence) as refusal, library_errors_translated("NPY"):
        raise cause
    assert refusal.value.code == "broken-file"
    assert refusal.value.__cause__ is cause


TROUBLES = [MemoryError(), *(OSError(number, "gone") for number in sorted(DISK_AWAY))]


@pytest.mark.parametrize("trouble", TROUBLES)
def test_the_machines_troubles_are_not_the_files(trouble):
    with pytest.raises(type(trouble)) as raised, library_errors_translated("NPY"):
        raise trouble
    assert raised.value is trouble


def test_foreign_text_is_quoted_on_one_short_printable_line():
    assert quoted("a\x1b[31m\n b") == "a [31m b"
    assert len(quoted("x" * 1000)) == 200
