"""The TOML of a watched folder: what is wrong in it is reported with its key and what would be right."""

import re

import pytest

from sawmill_worker.watching.settings import WrongFileError, read_settings

RIGHT = """\
service = "http://127.0.0.1:8000"

[[folders]]
folder = "/srv/scanner-2"
scanner_id = "line-2"

[[folders.files]]
match = "*.h5"
data = "counts"
phantom_rows = "10:30"
"""


def read(tmp_path, text):
    path = tmp_path / "watch.toml"
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


@pytest.mark.parametrize("switched_off", ["still_for_s", "done_suffix"])
def test_one_way_to_know_whole_files_may_be_switched_off(tmp_path, switched_off):
    (folder,) = read(tmp_path, RIGHT.replace("\n[[folders.files", f"{switched_off} = false\n\n[[folders.files")).folders
    assert getattr(folder, switched_off) is None


@pytest.mark.parametrize(
    ("was", "is_now", "sentence"),
    [
        ('"counts"', '"count"', "folders.0.files.0.data: should be 'counts' or 'line-integrals', not 'count'"),
        ("scanner_id =", "scaner_id =", "folders.0.scaner_id is not a known field: 'scanner_id' is"),
        ('scanner_id = "line-2"', "scanner_id = 2", "folders.0.scanner_id: should be a valid string, not 2"),
        ('scanner_id = "line-2"\n', "", "folders.0.scanner_id is missing"),
        ("/srv/scanner-2", "scanner-2", "must be an absolute path, as in /srv/scanner-2, not 'scanner-2'"),
        ("http://127.0.0.1:8000", "ftp://mill", "service: must be the service's address, as in https://"),
        ('"*.h5"', '"logs/*.h5"', "must match names in the folder itself, so without /, not 'logs/*.h5'"),
        ("10:30", "30:10", "rows must be A:B with 0 <= A < B, as in 0:16"),
        ('"10:30"', "[1, 2]", "should be a valid string, not [1, 2]"),
        ('"10:30"', "10:30:00", "phantom_rows: should be a valid string, not {'date or time': '10:30:00'}"),
        (
            '"line-2"',
            "2026-03-31",
            "folders.0.scanner_id: should be a valid string, not {'date or time': '2026-03-31'}",
        ),
        (
            '"line-2"',
            '"line-2"\ndone = 2026-03-31T05:30:00Z',
            "folders.0.done: should be a valid string, not {'date or",
        ),
        ('"line-2"', '"line-2"\nstill_for_s = "on"', "folders.0.still_for_s: should be a valid number, not 'on'"),
        ('"line-2"', '"line-2"\nstill_for_s = inf', "folders.0.still_for_s: should be a finite number, not inf"),
        ('"line-2"', '"line-2"\nstill_for_s = true', "folders.0.still_for_s: should be a valid number, not True"),
        ('"line-2"', '"line-2"\ndone = "refused"', "must be three folders"),
        ("http://127.0.0.1:8000", "https://mill:80000", "service: port out of range 0-65535"),
        ('"10:30"', '"0:3"\n[[folders]]\nfolder = "/x"\nscanner_id = "x"\nfiles = []', "should have at least 1 item"),
    ],
)
def test_a_wrong_value_is_reported_with_its_key(tmp_path, was, is_now, sentence):
    assert was in RIGHT
    with pytest.raises(WrongFileError, match=re.escape(sentence)):
        read(tmp_path, RIGHT.replace(was, is_now, 1))


@pytest.mark.parametrize(
    ("was", "is_now", "line"),
    [
        ('data = "counts"', "data = counts", 9),
        ('data = "counts"', 'data = "counts"\ndata = "counts"', 10),
        ('"/srv/scanner-2"', '"/srv/scanner-2', 4),
    ],
    ids=["no quotes", "a key twice", "an open quote"],
)
def test_what_is_no_toml_is_reported_with_its_line(tmp_path, was, is_now, line):
    assert was in RIGHT
    with pytest.raises(WrongFileError, match=rf"watch\.toml is no TOML: .+ \(at line {line}, column \d+\)$"):
        read(tmp_path, RIGHT.replace(was, is_now, 1))


def test_a_folder_stands_there_once_and_is_known_to_be_whole_somehow(tmp_path):
    twice = RIGHT + RIGHT[RIGHT.index("[[folders]]") :]
    with pytest.raises(WrongFileError, match="stands here twice"):
        read(tmp_path, twice)
    never = RIGHT.replace('"line-2"', '"line-2"\nstill_for_s = false\ndone_suffix = false')
    with pytest.raises(WrongFileError, match="no file is ever known to be whole"):
        read(tmp_path, never)


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "a" + ".a" * 4_000 + " = 1"], ids=["brackets", "a key"])
def test_many_levels_are_refused_in_a_sentence(tmp_path, text):
    with pytest.raises(WrongFileError, match=r"watch\.toml has too many levels: [^\n]+$"):
        read(tmp_path, text)


@pytest.mark.parametrize("suffix", ["yaml", "yml"])
def test_yaml_is_refused_with_the_name_of_the_toml_file(tmp_path, suffix):
    (tmp_path / f"line2.{suffix}").write_text("service: http://127.0.0.1:8000\n")
    sentence = (
        f"{tmp_path}/line2.{suffix}: write {tmp_path}/line2.toml instead, in TOML as docs/do/watched-folder.md shows"
    )
    with pytest.raises(WrongFileError, match=re.escape(sentence)):
        read_settings(tmp_path / f"line2.{suffix}")


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(WrongFileError, match="cannot be read: No such file"):
        read_settings(tmp_path / "absent.toml")
    (tmp_path / "watch.toml").write_bytes(b"service: \xff")
    with pytest.raises(WrongFileError, match="no text in UTF-8: byte 9"):
        read_settings(tmp_path / "watch.toml")
