"""The YAML of a watched folder: what is wrong in it is said with its line and what would be right."""

import pytest

from sawmill_worker.watching.settings import read_settings
from sawmill_worker.watching.strict_yaml import WrongYaml, read_yaml

RIGHT = """\
service: http://127.0.0.1:8000
folders:
  - folder: /srv/scanner-2
    scanner_id: line-2
    files:
      - match: "*.h5"
        data: counts
        phantom_rows: 10:30
"""


def read(tmp_path, text):
    path = tmp_path / "watch.yaml"
    path.write_text(text)
    return read_settings(path)


def test_what_is_left_out_has_its_default(tmp_path):
    watching = read(tmp_path, RIGHT)
    (folder,) = watching.folders
    assert (folder.still_for_s, folder.done_suffix, str(folder.done_folder)) == (10.0, ".done", "/srv/scanner-2/done")
    assert folder.files_named("Scan 7.h5").query("line-2", "Scan 7.h5") == {
        "data": "counts",
        "phantom_rows": "10:30",
        "scanner_id": "line-2",
        "name": "Scan 7.h5",
    }
    assert folder.files_named("scan.tif") is None


@pytest.mark.parametrize(
    ("was", "is_now", "line", "sentence"),
    [
        ("data: counts", "data: count", 7, "data: should be 'counts' or 'line-integrals', not 'count'"),
        ("scanner_id:", "scaner_id:", 4, "folders.0.scaner_id is not a known field: 'scanner_id' is"),
        ("scanner_id: line-2", "scanner_id: 2", 4, "folders.0.scanner_id: should be a valid string, not 2"),
        ("    scanner_id: line-2\n", "", 3, "folders.0.scanner_id is missing"),
        ("/srv/scanner-2", "scanner-2", 3, "must be an absolute path, as in /srv/scanner-2, not 'scanner-2'"),
        ("http://127.0.0.1:8000", "ftp://mill", 1, "service: must be the service's address, as in https://"),
        ('"*.h5"', '"logs/*.h5"', 6, "must match names in the folder itself, so without /, not 'logs/*.h5'"),
        ("10:30", "30:10", 8, "rows must be A:B with 0 <= A < B, as in 0:16"),
        ("10:30", "[1, 2]", 8, "should be a valid string, not [1, 2]"),
        ("data: counts", "data: counts\n        data: counts", 8, "'data' stands here already, in line 7"),
        ("data: counts", "data: &a counts\n        rings: *a", 7, "an alias takes this value again"),
        ("scanner_id: line-2", "scanner_id: line-2\n    still_for_s: on", 5, "must be a number, not 'on'"),
        ("scanner_id: line-2", "scanner_id: line-2\n    still_for_s: .inf", 5, "must be a number, not '.inf'"),
        ("scanner_id: line-2", "scanner_id: line-2\n    done: refused", 3, "must be three folders"),
        ("scanner_id: line-2", "scanner_id: line-2\n    still_for_s: !!int ten", 5, "'ten' is given the tag"),
        ("scanner_id: line-2", "scanner_id: line-2\n    still_for_s: !!null 10", 5, "'10' is given the tag"),
        ("http://127.0.0.1:8000", "https://mill:80000", 1, "service: port out of range 0-65535"),
        ("data: counts", "data: !!python/object:os.system counts", 7, "the tag"),
        ("10:30", "0:3\n  - folder: /srv/3\n    scanner_id: x\n    files: []", 11, "should have at least 1 item"),
        ("files:", "files: [", 6, "this is no YAML"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, was, is_now, line, sentence):
    assert was in RIGHT
    with pytest.raises(WrongYaml) as wrong:
        read(tmp_path, RIGHT.replace(was, is_now, 1))
    found = str(wrong.value)
    assert sentence in found
    assert f"line {line}: " in found, found


def test_an_alias_is_refused_before_it_multiplies():
    with pytest.raises(WrongYaml, match="line 1: an alias takes this value again"):
        read_yaml("a: &a [1]\nb: [*a, *a]\n")
    with pytest.raises(WrongYaml, match="bytes"):
        read_yaml("a: " + "x" * 300_000)
    with pytest.raises(WrongYaml, match="it is empty"):
        read_yaml("# nothing\n")


def test_words_are_those_of_json():
    text = "a: on\nb: 10:30\nc: 0o7\nd: 1_000\ne: 2026-01-01\nf: [1, 1.5, 1e3, true, null, ~, '1']\n"
    assert read_yaml(text).value == {
        "a": "on",
        "b": "10:30",
        "c": "0o7",
        "d": "1_000",
        "e": "2026-01-01",
        "f": [1, 1.5, 1000.0, True, None, None, "1"],
    }


def test_a_folder_stands_there_once_and_is_known_to_be_whole_somehow(tmp_path):
    twice = RIGHT + RIGHT[RIGHT.index("  - folder") :]
    with pytest.raises(WrongYaml, match="stands here twice"):
        read(tmp_path, twice)
    never = RIGHT.replace("scanner_id: line-2", "scanner_id: line-2\n    still_for_s: null\n    done_suffix: null")
    with pytest.raises(WrongYaml, match="no file is ever known to be whole"):
        read(tmp_path, never)


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(WrongYaml, match="cannot be read: No such file"):
        read_settings(tmp_path / "absent.yaml")
    (tmp_path / "watch.yaml").write_bytes(b"service: \xff")
    with pytest.raises(WrongYaml, match="no text in UTF-8: byte 9"):
        read_settings(tmp_path / "watch.yaml")
