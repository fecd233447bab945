"""The load of a line: the amounts of a day, and a quick study that measures everything that the page shows."""

import json

import line_day
import load
import pytest
from measurement import RESULTS


def test_the_table_of_machines_follows_from_what_the_results_hold():
    price, cells = (json.loads((RESULTS / f"{name}.json").read_text()) for name in ("log-price", "load"))
    tables = line_day.log_tables(price["values"]["log"], cells["values"]["cells"], price["cores"])
    assert price["values"] == {"log": price["values"]["log"], **tables}


@pytest.mark.nightly
def test_the_quick_study_measures_everything(tmp_path):
    load.main(["--quick", "--results", str(tmp_path)], reference=lambda: 1.0)
    files = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("load", "log-price"))
    load_values, values = (file["values"] for file in files)
    (cell,), log = load_values["cells"], values["log"]
    assert (cell["database"], cell["workers"], cell["queued"]) == ("sqlite", 1, 10)
    assert all(cell[name] > 0.0 for name in cell.keys() - {"database"})
    assert log["upload_bytes"] > log["rows"] * 22 * 768 * 2
    assert min(log["scan_bytes"], log["volume_bytes"], log["read_processor_s"], log["fbp_processor_s"]) > 0
    assert "| samples of a day | 2000 logs x 76.8 MB | 154 GB |" in values["day"]
    assert load_values.keys() == {"cells", "sqlite", "claim_growth", "first_page_growth"}
    assert values.keys() == {"log", "day", "sizing", "stay", "ends"}
