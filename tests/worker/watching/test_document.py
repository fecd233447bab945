"""The TOML of docs/do/watched-folder.md works as it stands there, with this machine's paths."""

import re
from pathlib import Path

from watching_process import no_progress

from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_worker.watching.command import watch
from sawmill_worker.watching.settings import Files, WatchedFolder, Watching

PAGE = Path(__file__).parents[3] / "docs/do/watched-folder.md"


def test_the_page_s_toml_takes_a_phantom_and_a_log(watched, tmp_path):
    (text,) = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
    key = watched.running.store.keys.create(KeyAsk(name="folder of line 2", scope=Scope.SUBMIT))
    (tmp_path / "watch.key").write_text(key.secret)
    for documented, here in {
        "https://sawmill.example": watched.running.url,
        "/etc/sawmill/watch.key": str(tmp_path / "watch.key"),
        "poll_s = 5": "poll_s = 0.02",
        "/srv/scanner-2": str(watched.folder),
        '"line-2"': f'"{watched.scanner_id}"',
    }.items():
        assert documented in text
        text = text.replace(documented, here)
    watched.settings.write_text(text)
    for name in ("phantom of week 10.h5", "log-1.h5"):
        watched.put(name, name.encode()).with_name(f"{name}.done").touch()
    assert watch(watched.settings, no_progress, once=True)
    assert {scan.name: scan.phantom_id for scan in watched.scans()} == {
        "phantom of week 10.h5": "l-shape",
        "log-1.h5": None,
    }


def test_the_page_s_table_has_every_field():
    (table,) = re.findall(r"^\| field \|.*?\n\n", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r"`([a-z_]+)`", table))
    fields = {*Watching.model_fields, *WatchedFolder.model_fields, *Files.model_fields}
    assert fields - named == {"folders", "files"}
