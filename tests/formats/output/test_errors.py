import pytest

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_platform.files.whole_files import DISK_AWAY

NO_USE = "its structure makes no sense"


@pytest.mark.parametrize(
    ("error", "passed_on"),
    [
        (ValueError("bad\nheader"), "bad header"),
        (ValueError("To allow loading, fully trust the file using `allow_pickle=True`"), NO_USE),
        (TypeError("'NoneType' object is not subscriptable"), NO_USE),
        (KeyError("databytecounts"), NO_USE),
        (ValueError("malformed node <ast.Name object at 0x7f5ed2a1e010>"), NO_USE),
        (OSError("can't open '/var/lib/sawmill/uploads/1f3a', at 1/2"), "can't open '...', at 1/2"),
        (ValueError("incorrect data check"), "incorrect data check"),
    ],
)
def test_of_a_parser_only_what_it_says_of_the_file_is_passed_on(error, passed_on):
    with pytest.raises(UnreadableScan) as refusal, library_errors_translated("NPY"):
        raise error
    assert str(refusal.value) == f"this NPY file is incomplete or damaged ({passed_on}); export it again"
    assert (refusal.value.code, refusal.value.__cause__) == ("broken-file", error)


TROUBLES = [MemoryError(), *(OSError(number, "gone") for number in sorted(DISK_AWAY))]


@pytest.mark.parametrize("trouble", TROUBLES)
def test_the_machines_troubles_are_not_the_files(trouble):
    with pytest.raises(type(trouble)) as raised, library_errors_translated("NPY"):
        raise trouble
    assert raised.value is trouble


def test_foreign_text_is_quoted_on_one_short_printable_line():
    assert quoted("a\x1b[31m\n b") == "a [31m b"
    assert len(quoted("x" * 1000)) == 200
