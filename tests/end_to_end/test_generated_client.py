"""The programs of docs/do/connect.md do the whole job with the generated client and with curl."""

import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from cutting_proxy import cutting
from PIL import Image
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_vocabulary.version import VERSION

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/do/connect.md"
DOCUMENTED = "http://127.0.0.1:8000"
SIMULATED = ("log-with-phantom", "--theta", "146.1deg,714.7,319.9,43.7,15.7deg", "--views", "90", "--rows", "4")
CUTS = 3  # of the line, in the middle of parts
# Operations that the page does without: those that answer a file, a form, a schedule.
OTHER_OPERATIONS = """
from sawmill_calibration_client.api.calibrations import get_log_after, get_log_before
from sawmill_calibration_client.api.keys import get_audit_file
from sawmill_calibration_client.api.phantoms import get_drawing, get_phantom
from sawmill_calibration_client.api.reconstructions import get_mosaic, get_side_array, get_side_view
from sawmill_calibration_client.api.scans import get_sinogram, upload_scan_form
from sawmill_calibration_client.api.schedules import create_schedule
from sawmill_calibration_client.models import DriftOptions, ScanForm, ScheduleAsk, ScheduleKind

assert get_side_array.sync(slices.id, client=api).payload.read(6) == b"\\x93NUMPY"
assert b"</svg>" in get_drawing.sync(phantom.id, client=api).payload.read()
for picture in (
    *(ask.sync(calibration.id, client=api) for ask in (get_log_after, get_log_before)),
    *(ask.sync(slices.id, client=api) for ask in (get_mosaic, get_side_view)),
    get_sinogram.sync(scan.id, client=api),
):
    assert picture.payload.read(4) == b"\\x89PNG"
assert get_audit_file.sync(client=api).code == "scope-too-small"
finished(traced.job_id)
assert answered(get_phantom.sync(traced.id, client=api)).state == "ready"
with Path("mill.h5").open("rb") as stream:
    form = ScanForm(scanner_id=scanner.id, data=DataKind.COUNTS, file=File(payload=stream, file_name="form.h5"))
    assert answered(upload_scan_form.sync(client=api, body=form)).name == "form.h5"
checks = ScheduleAsk(
    scanner_id=scanner.id,
    kind=ScheduleKind.CHECK_DRIFT,
    cron="30 5 * * 1-6",
    time_zone="Europe/Helsinki",
    drift_options=DriftOptions(rows="0:8"),
)
made = answered(create_schedule.sync(client=api, body=checks))
assert (made.kind, made.time_zone, made.drift_options.rows) == (checks.kind, checks.time_zone, "0:8")
"""


def blocks(page: str, language: str) -> str:
    return "\n".join(re.findall(rf"^```{language}\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """The folder that the client is installed in."""
    folder = tmp_path_factory.mktemp("client")
    run([sys.executable, str(ROOT / "openapi/clients/generate.py"), str(folder)], folder)
    wheel = folder / f"sawmill_calibration_client-{VERSION}-py3-none-any.whl"
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index", "--no-deps")
    run([*pip, "--target", str(folder / "installed"), str(wheel)], folder)
    return folder / "installed"


def run(command: list[str], folder: Path, **environment: str) -> str:
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    variables = {**os.environ, "PATH": path, "no_proxy": "*", **environment}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def check_files(folder: Path) -> None:
    for name in ("report.png", "overlay.png", "slice.png"):
        with Image.open(folder / name) as picture:
            assert picture.size >= (256, 256), name
    assert (np.load(folder / "slice.npy").shape, np.load(folder / "slice.npy").dtype) == ((256, 256), np.float32)
    with h5py.File(folder / "volume.h5") as file:
        assert file["entry/reconstruction/data"].shape == (1, 256, 256)
    with h5py.File(folder / "calibration.h5") as file:
        assert len(file) > 0


@pytest.mark.timeout(180)
def test_the_page_s_programs_do_the_whole_job(tmp_path, embedded, client):
    simulated = CliRunner().invoke(main, ["simulate", *SIMULATED, "--phantom-rows", "3", "-o", f"{tmp_path}/mill.h5"])
    assert simulated.exit_code == 0, simulated.output
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "python").mkdir()
    url = embedded.client.base_url
    page, (readme,) = PAGE.read_text(), (path.read_text() for path in client.glob("*.dist-info/METADATA"))
    with cutting((url.host, url.port), cuts=CUTS, after_bytes=100_000) as line:
        shell = blocks(page, "sh").replace(DOCUMENTED, line.address)
        printed = run(["bash", "-euo", "pipefail", "-c", shell], tmp_path)
        assert line.cuts_left == 0
    for name in ("mill.h5", "phantom.png"):
        (tmp_path / "python" / name).symlink_to(tmp_path / name)
    program = "\n".join((blocks(page, "python"), OTHER_OPERATIONS, blocks(readme, "python")))
    key = embedded.post("/v1/keys", json={"name": "program", "scope": "activate"})["secret"]
    variables = {"SAWMILL_KEY": key, "PYTHONPATH": str(client)}
    with cutting((url.host, url.port), cuts=CUTS, after_bytes=100_000) as line:
        program = program.replace(DOCUMENTED, line.address)
        said = run([sys.executable, "-c", program], tmp_path / "python", **variables)
        assert line.cuts_left == 0
    for folder in (tmp_path, tmp_path / "python"):
        check_files(folder)
    assert "pass\n" in printed
    assert all("Nothing moved that this scan can show" in each for each in (printed, said))
    assert "there is no scan 'no-such-scan'" in printed
    assert '"code":"scan-not-found"' in (tmp_path / "problem.json").read_text()
    assert said.startswith("pass 3")
    assert "404 scan-not-found there is no scan 'no-such-scan'" in said
    sent = 2 * (tmp_path / "mill.h5").stat().st_size + (tmp_path / "mean.npy").stat().st_size
    assert f"{sent} bytes in scans" in said  # the stack once whole, once in parts; its log's mean
