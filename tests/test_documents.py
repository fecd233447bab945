"""What the documents say is true: their commands run, their tables are the code's, their links lead somewhere."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import Field, fields
from pathlib import Path

import h5py
import httpx
import numpy as np
import pytest
import typer
from PIL import Image
from ports import free_port
from pydantic import TypeAdapter
from pydantic_core import PydanticUndefined
from pydantic_settings import BaseSettings
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_formats.input.reading import reading_scan
from sawmill_formats.output.volume_writer import new_reconstruction
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.settings import ServiceSettings
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.reconstruction.choosing import EXPECTED_ERRORS, VIEWS, seconds_a_slice
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.physics import Physics
from sawmill_worker.commands.geometry_options import theta_of

ROOT = Path(__file__).parents[1]
README, TOUR, HTTP = ROOT / "README.md", ROOT / "docs/start/demo.md", ROOT / "docs/look-up/http.md"
FIRST_CALIBRATION = ROOT / "docs/start/first-calibration.md"
PROGRAMS = ROOT / "docs/do/connect.md"
HEART = "The heart of it, with curl"
DOCUMENTS = [README, ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
SETTINGS: tuple[type[BaseSettings], ...] = (StorageSettings, ServiceSettings, ExecutionSettings)
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
THETA_FLAG = "146.1deg,714.7,319.9,43.7,15.7deg"
THETA = theta_of(THETA_FLAG)
DOCUMENTED = "http://127.0.0.1:8000"
# Limits that only a hang reaches.
START_TIMEOUT_S = STOP_TIMEOUT_S = 120.0
CURL_FLAGS = {"--data-binary"}

# Blocks that start what the tests start by themselves, or that would start the tests.
ELSEWHERE = ("make ", 'export PATH="$PWD/.venv/bin', "sawmill serve")


def sections(path: Path) -> dict[str, str]:
    """The text below each heading of the second level."""
    parts = re.split(r"^## (.+)$", path.read_text(), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def script(text: str) -> str:
    return "\n".join(block for block in blocks(text, "sh") if not block.startswith(ELSEWHERE))


def environment(**changes: str) -> dict[str, str]:
    """As a user's shell has it after the installation."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
    return kept | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "no_proxy": "*"} | changes


def run(commands: str, folder: Path) -> str:
    """Run a script in a folder which has the examples, as the repository does; its standard output."""
    if not (folder / "examples").exists():
        shutil.copytree(ROOT / "examples", folder / "examples")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, f"{commands}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """The README's `sawmill serve`, on a free port with a data folder of its own; yields its address."""
    port = free_port()
    (command,) = [block for block in blocks(sections(README)[HEART], "sh") if block.startswith(ELSEWHERE)]
    with (folder / "service.log").open("w") as log:
        service = subprocess.Popen(
            [*command.split(), "--port", str(port), "--no-examples", "--workers", "1"],
            env=environment(SAWMILL_DATA_FOLDER=str(folder / "data")),
            stdout=log,
            stderr=log,
        )
        try:
            wait_until_ready(f"http://127.0.0.1:{port}", service)
            yield f"http://127.0.0.1:{port}"
        finally:
            service.terminate()
            service.wait(STOP_TIMEOUT_S)


def wait_until_ready(address: str, service: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        assert service.poll() is None, "the service ended while starting"
        try:
            httpx.get(f"{address}/health/ready", trust_env=False).raise_for_status()
        except httpx.TransportError:  # it does not listen yet
            time.sleep(0.05)
        else:
            return
    raise AssertionError(f"the service was not ready within {START_TIMEOUT_S} s")


def ray_error_mm(frame: dict[str, float]) -> float:
    found = SourceFrame(**{name: value for name, value in frame.items() if name != "magnification"})
    return ray_error(SCANNER, THETA.source_frame(SCANNER.source_to_cor_mm), found).rms_mm


def check_log_volume(path: Path, slices: int) -> None:
    with h5py.File(path) as file:
        data = file["entry/reconstruction/data"]
        assert data.shape == (slices, 256, 256)
        assert data.attrs["units"] == "1/mm"
        # The middle of a log of green wood, with rings and knots.
        assert 0.010 < float(np.median(data[0][96:160, 96:160])) < 0.025


@pytest.mark.slow
def test_the_readme_s_block_and_the_example_script_work_with_curl_alone(tmp_path):
    block = script(sections(README)[HEART])
    assert block.count(DOCUMENTED) == 1
    example = """
examples/calibrate.sh "$API" "$scanner" phantom.h5 l-shape > log.txt; echo "$scanner" "$API" > used.txt
if examples/calibrate.sh "$API" no-such-scanner README.md l-shape 2> refused.txt; then exit 1; fi
"""
    simulate_phantom(tmp_path)
    shutil.copy(README, tmp_path)
    with serving(tmp_path) as address:
        reported = run(f"{block}\ncp calibration.json block.json\n{example}".replace(DOCUMENTED, address), tmp_path)
        scanner, api = (tmp_path / "used.txt").read_text().split()
        active = httpx.get(f"{api}/v1/scanners/{scanner}", trust_env=False).json()["active_calibration_id"]
    assert "event: end" in reported
    found = json.loads((tmp_path / "block.json").read_text())
    assert (found["state"], found["verdict"]) == ("succeeded", "pass")
    assert active == found["id"]
    assert ray_error_mm(found["source_frame"]) < 0.06
    assert ": pass" in (tmp_path / "log.txt").read_text()
    assert "there is no scanner 'no-such-scanner'" in (tmp_path / "refused.txt").read_text()
    check_pictures(tmp_path, "report.png")


def simulate_phantom(folder: Path) -> None:
    in_process("simulate", "l-shape", "--theta", THETA_FLAG, "--views", 90, "-o", folder / "phantom.h5")


def check_pictures(folder: Path, *names: str) -> None:
    for name in names:
        with Image.open(folder / name) as picture:
            assert picture.size >= (256, 256), name


@pytest.mark.nightly
def test_the_tour_and_the_http_page_work_with_curl_alone(tmp_path):
    tour = script(sections(README)[HEART]) + "\n" + script(sections(TOUR)["With curl"])
    further = "\n".join(blocks(HTTP.read_text(), "sh"))
    with serving(tmp_path) as address:
        run(f"{tour}\ncp calibration.json tour.json\n{further}".replace(DOCUMENTED, address), tmp_path)
    check_log_volume(tmp_path / "volume.h5", 3)
    assert (tmp_path / "first-bytes").read_bytes() == (tmp_path / "volume.h5").read_bytes()[:8]
    check_pictures(tmp_path, "report.png", "overlay.png", "slice.png", "slice16.png")
    check_either_file_is_enough(tmp_path)


# A command of curl up to its address, which may go on in the next line.
CURL = re.compile(r'\bcurl ((?:[^\n]|(?<=[\\|])\n)*?)"\$API(/v1/[^"]*)"')
# Each way to send a body, and its method; -X names another one.
SENDING = {"-d": "post", "--data-binary": "post", "-F": "post", "-T": "put", "-I": "head"}


@pytest.mark.parametrize("path", [README, TOUR, HTTP, PROGRAMS], ids=lambda path: path.name)
def test_every_curl_command_asks_for_a_route_of_the_contract_with_its_parameters(path):
    paths = json.loads((ROOT / "openapi/openapi.json").read_text())["paths"]
    commands = [found for block in blocks(path.read_text(), "sh") for found in CURL.findall(block)]
    assert commands
    for options, target in commands:
        route, _, query = re.sub(r"\$\([^)]*\)|\$\w+", "x", target).partition("?")
        named = re.search(r"-X (\w+)", options)
        sending = [method for flag, method in SENDING.items() if re.search(rf"(?<!\S){flag}(?!\S)", options)]
        method = named[1].lower() if named else next(iter(sending), "get")
        [operation] = [
            item.get(method) or item["get" if method == "head" else method]
            for pattern, item in paths.items()
            if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", pattern), route) and (method in item or method == "head")
        ][:1]
        known = {parameter["name"] for parameter in operation.get("parameters", []) if parameter["in"] == "query"}
        assert {part.partition("=")[0] for part in query.split("&") if part} <= known, target


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_sawmill_command_is_parsed(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for block in blocks(path.read_text(), "sh"):
        for line in re.findall(r"^sawmill (.+)$", block.replace("\\\n", " "), re.MULTILINE):
            arguments = shlex.split(line.partition(" > ")[0], comments=True)
            for name in arguments:
                if re.fullmatch(r"[\w$/-]+\.(?:h5|json|npz|png)", name) and not Path(name).exists():
                    Path(name).parent.mkdir(parents=True, exist_ok=True)
                    Path(name).touch()
            command = typer.main.get_command(main)
            while hasattr(command, "commands"):
                command = command.commands[arguments.pop(0)]
            with command.make_context(line, arguments):
                pass


def in_process(*arguments: object) -> str:
    """What needs no shell; its standard output."""
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def run_in_process(commands: str) -> None:
    """Run lines of `sawmill` in this folder, with the examples, as a shell would: that imports everything each time."""
    shutil.copytree(ROOT / "examples", "examples")
    for line in filter(None, commands.splitlines()):
        program, *arguments = shlex.split(line)
        assert program == "sawmill"
        command, redirected = (arguments[:-2], arguments[-1]) if ">" in arguments else (arguments, "unused")
        Path(redirected).write_text(in_process(*command))


@pytest.mark.nightly
def test_a_first_calibration_goes_as_its_page_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_in_process("".join(blocks(FIRST_CALIBRATION.read_text(), "sh")))
    found = json.loads((tmp_path / "result.json").read_text())
    assert (found["verdict"], found["predicted_ray_error_mm"]["upper_95"] < 0.1) == ("pass", True)
    assert found["scale_uncertainty_percent"] == pytest.approx(0.14, abs=0.01)
    measured_wrongly = ("--source-to-cor-mm", 855, "--phantom", "examples/phantom-measured.json", "--json")
    other = json.loads(in_process("calibrate", "phantom-scan.h5", "--data", "counts", *measured_wrongly))
    assert other["source_frame"] == pytest.approx(found["source_frame"], rel=1e-6)
    assert other["theta"]["source_shift_mm"] != pytest.approx(found["theta"]["source_shift_mm"], rel=0.1)


def check_either_file_is_enough(folder: Path) -> None:
    """The tour's calibration.h5 reconstructs the same slice as its calibration.json."""
    for calibration, volume in (("tour.json", "from-json.h5"), ("calibration.h5", "from-hdf5.h5")):
        flags = ("--data", "counts", "--rows", "3:4", "--calibration", folder / calibration, "-o", folder / volume)
        in_process("reconstruct", folder / "mill.h5", *flags)
    with h5py.File(folder / "from-json.h5") as one, h5py.File(folder / "from-hdf5.h5") as other:
        assert np.array_equal(*(file["entry/reconstruction/data"][()] for file in (one, other)))


@pytest.mark.nightly
def test_the_command_line_block_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_in_process(script(sections(TOUR)["The command line"]))
    found = json.loads((tmp_path / "result.json").read_text())
    assert found["verdict"] == "pass"
    assert ray_error_mm(found["source_frame"]) < 0.06
    check_log_volume(tmp_path / "log-volume.h5", 2)
    assert np.loadtxt(tmp_path / "geometry.txt").shape == (360, 6)
    assert "</svg>" in (tmp_path / "tee.svg").read_text()
    assert (tmp_path / "phantom-report.html").read_text().startswith("<!doctype html>")
    for name in ("log.png", "log-20-views.png"):
        with Image.open(tmp_path / name) as picture:
            assert picture.format == "PNG"


@pytest.mark.slow
def test_the_files_that_the_formats_page_makes_can_be_read(tmp_path):
    for block in blocks(sections(ROOT / "docs/look-up/formats.md")["What can be read"], "python"):
        subprocess.run([sys.executable, "-c", block], cwd=tmp_path, check=True)
    with (
        reading_scan(tmp_path / "scan.npz", counts=True) as compressed,
        reading_scan(tmp_path / "scan.h5", counts=True) as nxtomo,
    ):
        assert (compressed.format, nxtomo.format) == ("npz", "hdf5-nxtomo")
        assert nxtomo.detector_pitch_mm == pytest.approx(1.502864583)
        for one, other in zip(compressed.blocks(2**20), nxtomo.blocks(2**20), strict=True):
            assert np.array_equal(one.samples, other.samples)
        for part in ("flats", "darks", "angles_rad"):
            assert np.array_equal(getattr(compressed, part), getattr(nxtomo, part)), part


# napari brings a graphical toolkit: what it is given is looked at instead.
NAPARI = """
class Viewer:
    def add_image(self, data, *, scale, translate, axis_labels, units):
        print(data.shape, *scale, *translate, axis_labels, units)


def run():
    pass
"""


@pytest.mark.slow
def test_a_volume_opens_as_the_formats_page_has_it(tmp_path):
    with new_reconstruction(
        tmp_path / "volume.h5",
        (3, 6, 6),
        pixel_mm=1.5,
        row_pitch_mm=20.0,
        unit="1/mm",
        geometry={},
        parameters={},
        software_version="0",
        input_sha256="0",
        centre_mm=(10.0, -30.0),
        first_slice_mm=100.0,
    ) as volume:
        volume.write(0, np.ones((3, 6, 6), np.float32))
    (tmp_path / "napari.py").write_text(NAPARI)
    reported = [
        subprocess.run([sys.executable, "-c", block], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
        for block in blocks(sections(ROOT / "docs/look-up/formats.md")["Opening a volume"], "python")
    ]
    assert reported == [
        "(3, 6, 6) 20.0 1.5 1.5 100.0 6.25 -33.75 ('z', 'x', 'y') mm\n",
        "(6, 6) 1/mm 120.0\n",
    ]


# CIL is not to be had from the registry that the rest is installed from: its signatures, after its documentation.
CIL = """
class AcquisitionGeometry:
    @staticmethod
    def create_Cone2D(
        source_position, detector_position, detector_direction_x=(1, 0), rotation_axis_position=(0, 0), units="mm"
    ):
        geometry = AcquisitionGeometry()
        geometry.source = source_position
        return geometry

    def set_angles(self, angles, initial_angle=0, angle_unit="degree"):
        self.angles = angles

    def set_panel(self, num_pixels, pixel_size=(1, 1), origin="bottom-left"):
        self.num_pixels = num_pixels
"""


@pytest.mark.slow
def test_the_exported_files_are_read_as_the_export_page_has_it(tmp_path, monkeypatch):
    page = ROOT / "docs/do/export.md"
    monkeypatch.chdir(tmp_path)
    run_in_process("".join(blocks(page.read_text(), "sh")))
    (tmp_path / "cil").mkdir()
    (tmp_path / "cil/framework.py").write_text(CIL)
    for_astra, for_odl, for_cil, for_rtk = blocks(page.read_text(), "python")
    turned = "np.allclose(source @ [[0, -1], [1, 0]], np.loadtxt('astra.txt')[given['view_order'], :2])"
    checked = (
        f"{for_astra}\nassert projector.shape == (90 * 768, 256 * 256)",
        f"{for_odl}\nsource = geometry.src_position(geometry.angles)\nassert {turned}",
        f"{for_cil}\nassert (len(geometry.angles), geometry.num_pixels, geometry.source[1] < 0) == (90, 768, True)",
    )
    for script in checked:
        subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    assert "rtk.xml" in for_rtk
    assert (tmp_path / "rtk.xml").read_text().count("<Projection>") == 90


@pytest.mark.slow
def test_scans_are_simulated_as_their_page_has_it(tmp_path, monkeypatch, capsys):
    page = (ROOT / "docs/do/simulate.md").read_text()
    monkeypatch.chdir(tmp_path)
    run_in_process("".join(blocks(page, "sh")))
    assert (tmp_path / "bad-day.h5").stat().st_size > 0
    (program,) = blocks(page, "python")
    exec(program, {})  # noqa: S102 - the page's
    assert "The phantom moved at view 36, by 1.5 mm" in capsys.readouterr().out


def test_the_table_of_methods_is_that_of_auto():
    rows = [
        f"| {views} | " + " | ".join(expected_errors(errors, number) for errors in EXPECTED_ERRORS.values()) + " |"
        for number, views in enumerate(VIEWS)
    ]
    times = (f"{milliseconds(method, VIEWS[0])}, {milliseconds(method, VIEWS[-1])}" for method in EXPECTED_ERRORS)
    rows.append(f"| {VIEWS[0]} and {VIEWS[-1]} views, ms | " + " | ".join(times) + " |")
    table = "\n".join(rows)
    assert table in (ROOT / "docs/do/methods.md").read_text(), f"docs/do/methods.md needs these rows:\n{table}"


def expected_errors(errors: tuple[tuple[float, ...], ...], number: int) -> str:
    return ", ".join(f"{error:#.2g}" for error in errors[number]) if number < len(errors) else "not measured"


def milliseconds(method: ReconstructionMethod, views: int) -> str:
    return f"{float(f'{1e3 * seconds_a_slice(method, views, 768, 256):.2g}'):g}"


def test_every_shell_block_is_run_by_a_test():
    run_here = {
        *blocks(sections(README)[HEART], "sh"),
        *blocks(TOUR.read_text(), "sh"),
        *blocks(FIRST_CALIBRATION.read_text(), "sh"),
        *blocks(HTTP.read_text(), "sh"),
        *blocks((ROOT / "docs/do/export.md").read_text(), "sh"),
        *blocks(PROGRAMS.read_text(), "sh"),  # by test_generated_client.py
        *blocks((ROOT / "docs/understand/measured.md").read_text(), "sh"),  # by test_measured.py
        *blocks((ROOT / "docs/do/simulate.md").read_text(), "sh"),
    }
    others = [block for path in DOCUMENTS for block in blocks(path.read_text(), "sh") if block not in run_here]
    # `make` is looked at below, a cluster's commands in test_compose.py; test_composed.py makes compose's secrets.
    assert all(block.startswith((*ELSEWHERE, "export SAWMILL_BROKER_URL", "celery ", "mkdir")) for block in others)


def test_every_make_target_that_is_named_exists():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    named = {name for path in DOCUMENTS for name in re.findall(r"\bmake ([a-z-]+)[`\n]", path.read_text())}
    assert {"demo", "test"} <= named <= set(targets)


def test_every_flag_that_is_named_exists():
    root = typer.main.get_command(main)
    groups = [root.commands[name].commands.values() for name in ("phantom", "key")]
    commands = (root, *root.commands.values(), *(command for group in groups for command in group))
    flags = {
        flag for command in commands for option in command.params for flag in (*option.opts, *option.secondary_opts)
    }
    for path in DOCUMENTS:
        prose = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
        for code in re.findall(r"`((?:sawmill |--)[^`]+)`", prose):
            named = {flag for flag in re.findall(r"(?<!\S)--?[a-z][a-z-]*", code) if flag not in CURL_FLAGS}
            assert named <= flags | {"--help"}, code


def settings_table(settings: type[BaseSettings]) -> str:
    """As docs/do/run.md has it."""
    rows = ["| variable | default | what |", "|---|---|---|"]
    for name, field in settings.model_fields.items():
        default = shown_default(field.get_default(call_default_factory=True))
        rows.append(f"| `SAWMILL_{name.upper()}` | {default} | {field.description} |")
    return "\n".join(rows)


def shown_default(value: object) -> str:
    assert value is not PydanticUndefined
    if value is None:
        return "null"
    if isinstance(value, Path):
        return f"`~/{value.relative_to(Path.home())}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: settings.__name__)
def test_the_settings_table_is_the_code_s(settings):
    table = settings_table(settings)
    assert table in (ROOT / "docs/do/run.md").read_text(), f"docs/do/run.md needs this table:\n{table}"


def physics_row(group: str, field: "Field[float]") -> str:
    """As docs/do/simulate.md has it."""
    bounds = field.metadata
    least = bounds["ge"] if "ge" in bounds else bounds.get("gt")
    limits = "12, 16" if least is None else f"{'above ' if 'gt' in bounds else ''}{least:g} to {bounds['le']:g}"
    default = "null" if field.default is None else f"{field.default:g}"
    return f"| `{group}.{field.name}` | {default} | {limits} | {bounds['description']} |"


def test_the_table_of_physics_is_the_code_s():
    table = "\n".join(physics_row(group.name, field) for group in fields(Physics) for field in fields(group.default))
    assert table in (ROOT / "docs/do/simulate.md").read_text(), f"docs/do/simulate.md needs this table:\n{table}"


def test_the_table_of_routes_is_the_openapi_document_s():
    paths = json.loads((ROOT / "openapi/openapi.json").read_text())["paths"]
    rows = [
        f"| {method.upper()} | `{path}` | {operation['summary']} |"
        for path, item in paths.items()
        for method, operation in item.items()
    ]
    methods = r"^\| (?:GET|PUT|PATCH|POST|DELETE) \|.*$"
    documented = re.findall(methods, HTTP.read_text(), re.MULTILINE)
    assert documented == rows, "docs/look-up/http.md needs these rows:\n" + "\n".join(rows)


def test_the_example_inputs_are_valid():
    contracts = {"bad-day": Physics, "scanner": ScannerSpec, "schedule": ScheduleSpec}
    contracts |= dict.fromkeys(("phantom-measured", "phantom-tee"), PhantomDrawing)
    files = {path.stem: path for path in (ROOT / "examples").glob("*.json")}
    assert files.keys() == contracts.keys()
    for name, contract in contracts.items():
        TypeAdapter(contract).validate_json(files[name].read_bytes())


def test_every_test_that_shows_a_figure_exists():
    named = re.findall(r"(tests/[\w/]+\.py)::(\w+)", (ROOT / "docs/understand/accuracy.md").read_text())
    assert named
    for file, function in named:
        assert re.search(rf"^def {function}\(", (ROOT / file).read_text(), re.MULTILINE), f"{file}::{function}"


def texts() -> Iterator[tuple[Path, str]]:
    """Every text file that belongs to the project."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        try:
            if path.is_file():
                yield path, path.read_text()
        except UnicodeDecodeError:  # a picture
            continue


def test_no_file_names_a_registry_or_a_folder_of_one_machine():
    # Put together here, so that this file does not name them either.
    registries = [("pypi", "org"), ("pythonhosted", "org"), ("npmjs", "org"), ("docker", "io"), ("ghcr", "io")]
    registries += [("quay", "io"), ("anaconda", "org"), ("conda", "io")]
    hosts = "|".join(re.escape(".".join(parts)) for parts in registries)
    forbidden = re.compile(rf"\b(?:{hosts})\b|(?<![\w.~$}}])/(?:home|root|work|Users)/\w")
    found = [f"{path.relative_to(ROOT)}: {match[0]}" for path, text in texts() for match in forbidden.finditer(text)]
    assert not found
