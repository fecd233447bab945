"""The programs of examples/clients do the whole job of docs/do/connect.md over a line that breaks, with one scan."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import h5py
import numpy as np
import pytest
from cutting_proxy import cutting
from live_service import wait_until
from PIL import Image
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_vocabulary.version import VERSION
from sawmill_worker.commands.geometry_options import theta_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PROGRAMS = ROOT / "examples/clients"
FIRST_PROGRAM = ROOT / "docs/start/first-program.md"
DOCUMENTED = "http://127.0.0.1:8000"
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
CUTS = 3  # of the line, in the middle of parts
WRONG_OFFSETS = 1  # parts that then arrive with another offset, which the service refuses by 409 wrong-offset
# Operations that the programs do without: those that answer a file, a page, a schedule.
OTHER_OPERATIONS = """
from sawmill_calibration_client.api.calibrations import get_log_after, get_log_before, get_overlay
from sawmill_calibration_client.api.keys import get_audit_file
from sawmill_calibration_client.api.phantoms import create_phantom, get_drawing, get_phantom, upload_phantom_picture
from sawmill_calibration_client.api.reconstructions import get_mosaic, get_side_array, get_side_view, get_slice_array
from sawmill_calibration_client.api.scans import get_sinogram, list_scans
from sawmill_calibration_client.api.schedules import create_schedule
from sawmill_calibration_client.models import DriftOptions, PhantomRequest, Polygon, ScheduleRequest, ScheduleKind

for array in (get_side_array.sync(log.id, client=api), get_slice_array.sync(log.id, 0, client=api)):
    assert array.payload.read(6) == b"\\x93NUMPY"
corners = [[-100.1, 51.5], [-0.1, 51.5], [-0.1, -150.0], [100.1, -150.0], [100.1, 150.9], [-100.1, 150.9]]
phantom = once(create_phantom, body=PhantomRequest(name="our L", shapes=[Polygon(kind="polygon", vertices_mm=corners)]))
assert b"</svg>" in get_drawing.sync(phantom.id, client=api).payload.read()
pictures = [
    *(ask.sync(calibration.id, client=api) for ask in (get_log_after, get_log_before, get_overlay)),
    *(ask.sync(log.id, client=api) for ask in (get_mosaic, get_side_view)),
    get_sinogram.sync(scan.id, client=api),
]
for picture in pictures:
    assert picture.payload.read(4) == b"\\x89PNG"
assert get_audit_file.sync(client=api).code == "scope-too-small"
drawn = api.get_httpx_client().get("/static/phantom.png").content
traced = upload_phantom_picture.sync(client=api, body=File(payload=drawn), name="from a picture", width_mm=400.0)
while again(get_phantom, traced.id, wait=30).state != "ready":
    pass
page = list_scans.sync(client=api, scanner_id=scanner.id, limit=1)
rest = list_scans.sync(client=api, scanner_id=scanner.id, limit=1, after=page.next_)
assert [item.id for item in (*page.items, *rest.items)] == [mean_scan.id, scan.id]
daily = {"cron": "30 5 * * 1-6", "time_zone": "Europe/Helsinki", "drift_options": DriftOptions(rows="0:8")}
checks = ScheduleRequest(scanner_id=scanner.id, kind=ScheduleKind.CHECK_DRIFT, **daily)
made = once(create_schedule, body=checks)
assert (made.kind, made.time_zone, made.drift_options.rows) == (checks.kind, checks.time_zone, "0:8")
refused = create_calibration.sync(client=api, body=CalibrationRequest(scan_id="no-such-scan"))
assert (refused.status, refused.code, refused.detail) == (404, "scan-not-found", "there is no scan 'no-such-scan'")
"""


def block(page: str, language: str, beginning: str = "") -> str:
    [found] = re.findall(rf"^```{language}\n({re.escape(beginning)}.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    return found


@pytest.fixture(scope="module")
def simulate():
    """The command of the page of the first program, which names the scan of all programs."""
    return block(FIRST_PROGRAM.read_text(), "sh", "sawmill simulate").split()


@pytest.fixture(scope="module")
def stack(tmp_path_factory, simulate):
    _, *arguments, _, name = simulate
    path = tmp_path_factory.mktemp("scan") / name
    simulated = CliRunner().invoke(main, [*arguments, "-o", str(path)])
    assert simulated.exit_code == 0, simulated.output
    return path


def run(command: list[str | Path], folder: Path, *, exit_code: int = 0, **environment: str) -> str:
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    variables = {**os.environ, "PATH": path, "no_proxy": "*", **environment}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=150, check=False)
    assert done.returncode == exit_code, f"{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def do_the_whole_job(command, stack, folder, service, **environment) -> str:
    """Run a program on a line that breaks, check its files and its sentences, and return what it prints."""
    url = service.client.base_url
    key = service.post("/v1/keys", json={"name": "program", "scope": "activate"})["secret"]
    with cutting((url.host, url.port), cuts=CUTS, after_bytes=100_000, wrong_offsets=WRONG_OFFSETS) as line:
        printed = run([*command, line.address, stack], folder, SAWMILL_KEY=key, **environment)
        assert (line.cuts_left, line.wrong_offsets_left) == (0, 0)
    assert printed.startswith("calibration: pass")
    assert "next step: The calibration is good.\n" in printed
    assert "drift: A log shows that nothing has moved." in printed
    assert re.search(r"^(\d+ calibration )?calibration-activated$", printed, re.MULTILINE)
    for name in ("report.png", "slice.png"):
        with Image.open(folder / name) as picture:
            assert picture.size >= (256, 256), name
    with h5py.File(folder / "volume.h5") as file:
        assert file["entry/reconstruction/data"].shape == (3, 256, 256)
    return printed


@pytest.mark.nightly
@pytest.mark.timeout(240)
def test_the_python_program_does_the_whole_job(tmp_path, embedded, stack):
    run([sys.executable, ROOT / "openapi/clients/generate.py", tmp_path], tmp_path)
    wheel = tmp_path / f"sawmill_calibration_client-{VERSION}-py3-none-any.whl"
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index", "--no-deps")
    client = tmp_path / "installed"
    run([*pip, "--target", client, wheel], tmp_path)
    (readme,) = (path.read_text() for path in client.glob("*.dist-info/METADATA"))
    program = "\n".join(((PROGRAMS / "whole_job.py").read_text(), OTHER_OPERATIONS, block(readme, "python")))
    program = program.replace(f'"{DOCUMENTED}"', "address")
    do_the_whole_job([sys.executable, "-c", program], stack, tmp_path, embedded, PYTHONPATH=str(client))


@pytest.mark.timeout(240)
def test_the_shell_program_does_the_whole_job(tmp_path, embedded, stack, simulate):
    do_the_whole_job([PROGRAMS / "whole_job.sh"], stack, tmp_path, embedded)
    found = json.loads((tmp_path / "calibration.json").read_text())
    frame = SourceFrame(**{name: value for name, value in found["source_frame"].items() if name != "magnification"})
    truth = theta_of(simulate[simulate.index("--theta") + 1]).source_frame(SCANNER.source_to_cor_mm)
    assert ray_error(SCANNER, truth, frame).rms_mm < 0.06
    check_either_file_is_enough(tmp_path, stack, embedded, found["id"])
    refused = run([PROGRAMS / "whole_job.sh", str(embedded.client.base_url), PROGRAMS], tmp_path, exit_code=1)
    assert "Is a directory" in refused


def test_the_shell_program_repeats_what_is_refused_and_takes_no_part_of_a_volume_for_the_whole(tmp_path):
    answers = [503, 503]

    class Cut(BaseHTTPRequestHandler):
        """Refuses twice to report a calibration, says that each job succeeded, and cuts each volume."""

        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            body = b'{"id":"a","state":"succeeded","verdict":"pass","headline":"b","reason":"c"}'
            self.send_response(answers.pop() if answers and "wait" in self.path else 200)
            self.send_header("Retry-After", "1")
            self.send_header("Upload-Offset", "0")
            self.send_header("Content-Length", str(len(body) + self.path.endswith("volume.h5")))
            self.end_headers()
            self.wfile.write(b"" if self.command == "HEAD" else body)

        do_HEAD = do_POST = do_PATCH = do_GET  # noqa: N815 - as the library calls them

    (tmp_path / "scan.h5").touch()
    (tmp_path / "sleep").write_text("#!/bin/sh\n")
    (tmp_path / "sleep").chmod(0o755)
    with HTTPServer(("127.0.0.1", 0), Cut) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        command = [PROGRAMS / "whole_job.sh", f"http://127.0.0.1:{server.server_port}", "scan.h5"]
        printed = run(command, tmp_path, exit_code=1, PATH=f"{tmp_path}:{os.environ['PATH']}")
        server.shutdown()
    assert "volume.h5 was not received whole" in printed
    assert "drift" not in printed
    assert json.loads((tmp_path / "calibration.json").read_text())["verdict"] == "pass"


def check_either_file_is_enough(folder: Path, stack: Path, service, calibration: str) -> None:
    """A calibration's HDF5 file reconstructs the same slice as its JSON."""
    result = service.client.get(f"/v1/calibrations/{calibration}/result.h5")
    (folder / "result.h5").write_bytes(result.raise_for_status().content)
    for name in ("calibration.json", "result.h5"):
        arguments = ["reconstruct", stack, "--data", "counts", "--rows", "3:4", "--calibration", folder / name]
        arguments += ["--method", "fbp"]
        made = CliRunner().invoke(main, [*map(str, arguments), "-o", f"{folder}/{name}.volume"])
        assert made.exit_code == 0, made.output
    volumes = []
    for path in sorted(folder.glob("*.volume")):
        with h5py.File(path) as file:
            volumes.append(file["entry/reconstruction/data"][()])
    assert np.array_equal(*volumes)


@pytest.mark.nightly
@pytest.mark.timeout(240)
@pytest.mark.skipif(shutil.which("mcs") is None, reason="no C# compiler: apt-get install mono-devel")
def test_the_csharp_program_does_the_whole_job(tmp_path, embedded, stack):
    source = PROGRAMS / "whole_job.cs"
    [command] = re.findall(r"^// {3}(mcs .+) whole_job\.cs$", source.read_text(), re.MULTILINE)
    run([*command.split(), "-warnaserror", f"-out:{tmp_path}/whole_job.exe", source], tmp_path)
    do_the_whole_job(["mono", tmp_path / "whole_job.exe"], stack, tmp_path, embedded)


@pytest.mark.nightly
@pytest.mark.timeout(600)
@pytest.mark.skipif(shutil.which("npm") is None, reason="no npm: apt-get install npm")
def test_the_typescript_program_does_the_whole_job(tmp_path, embedded, stack):
    source = PROGRAMS / "whole_job.ts"
    for file in (source, ROOT / "openapi/openapi.json"):
        shutil.copy(file, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    installing, *compiling = re.findall(r"^// {3}(np[mx] .+)$", source.read_text(), re.MULTILINE)
    installed = subprocess.run(installing.split(), cwd=tmp_path, capture_output=True, text=True, check=False)
    if installed.returncode and not os.environ.get("CI"):
        pytest.skip(f"npm installs nothing here: {installed.stderr:.200}")
    for command in compiling:
        run(command.split(), tmp_path)
    do_the_whole_job(["node", tmp_path / "whole_job.js"], stack, tmp_path, embedded)


@pytest.mark.nightly
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("language", "file"), [("csharp", "WebhooksApi.cs"), ("python", "webhooks_api.py")])
def test_openapi_generator_reads_the_contract_without_loss(tmp_path, language, file):
    package = importlib.util.find_spec("openapi_generator_cli")
    if package is None or shutil.which("java") is None:
        pytest.skip("no openapi-generator-cli, which `make nightly` installs, or no Java")
    [jar] = Path(package.submodule_search_locations[0]).glob("*.jar")
    run(["java", "-jar", jar, "generate", "-i", ROOT / "openapi/openapi.json", "-g", language], tmp_path)
    [webhooks] = [path for path in tmp_path.rglob(file) if "Test" not in str(path.relative_to(tmp_path))]
    assert re.search(r"create_?webhook", webhooks.read_text(), re.IGNORECASE)
    # A class for each schema, and one for the shapes of a drawing, which are two kinds; none for "X or null".
    schemas = json.loads((ROOT / "openapi/openapi.json").read_text())["components"]["schemas"]
    classes = [path for path in tmp_path.rglob("*") if path.suffix in {".cs", ".py"}]
    models = [path for path in classes if path.parent.name.lower() in {"model", "models"}]
    models = [path for path in models if "Test" not in str(path.parent.relative_to(tmp_path))]
    assert abs(len(models) - len(schemas)) < 6, sorted(path.stem for path in models)


def test_the_watcher_of_another_machine_sends_each_file_once(tmp_path, embedded):
    scanner_id = embedded.create_scanner(name="elsewhere")
    (tmp_path / "log.npy").write_bytes(b"not read here")
    (tmp_path / "page.npy").write_bytes(b"<html>")
    key = embedded.post("/v1/keys", json={"name": "elsewhere", "scope": "submit"})["secret"]
    fields = [f"scanner_id={scanner_id}", "data=line-integrals", "angles_deg=0:1"]
    address = str(embedded.client.base_url).rstrip("/")
    command = [sys.executable, PROGRAMS / "watch_folder.py", address, tmp_path, *fields]
    environment = {**os.environ, "no_proxy": "*", "SAWMILL_KEY": key, "STILL_FOR_S": "0.05"}

    def sent(done: int) -> None:
        with subprocess.Popen(command, env=environment) as program:
            wait_until(lambda: list(tmp_path.glob("refused/*-page.npy")) and len(list(tmp_path.glob("done/*"))) >= done)
            assert program.poll() is None
            program.kill()

    sent(1)
    (file,) = tmp_path.glob("done/*-log.npy")
    file.rename(tmp_path / "log.npy")  # as after a kill between the answer and the move
    sent(1)
    scans = embedded.get("/v1/scans", params={"scanner_id": scanner_id}).json()["items"]
    assert [scan["name"] for scan in scans] == ["log.npy"]


def test_the_first_program_prints_what_its_page_shows(stack, embedded):
    page = FIRST_PROGRAM.read_text()
    program = block(page, "python").replace(DOCUMENTED, str(embedded.client.base_url))
    assert run([sys.executable, "-c", program], stack.parent) == block(page, "text")
