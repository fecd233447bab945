"""What the documents say is true: their commands run, tables and steps are the code's and the contract's."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import typer
from generate import PAGES as GENERATED
from page_blocks import in_process
from PIL import Image
from pydantic import TypeAdapter
from scan_files import new_volume

from sawmill_command.commands import main
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_formats.input.reading import reading_scan
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.reconstruction.choosing import EXPECTED_ERRORS, VIEWS, seconds_a_slice
from sawmill_vocabulary import PairedScanner
from sawmill_vocabulary.physics import Physics
from sawmill_worker.commands.geometry_options import theta_of

ROOT = Path(__file__).parents[1]
README, DEMO = ROOT / "README.md", ROOT / "docs/start/demo.md"
FIRST_CALIBRATION, PHANTOM = ROOT / "docs/start/first-calibration.md", ROOT / "docs/do/phantom.md"
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
THETA_FLAG = "146.1deg,714.7,319.9,43.7,15.7deg"
THETA = theta_of(THETA_FLAG)
OTHER_PROGRAMS_FLAGS = {"--data-binary", "--default-non-nullable"}

# Blocks that start what the tests start by themselves, or that would start the tests.
ELSEWHERE = ("make ", 'export PATH="$PWD/.venv/bin', "sawmill serve", ".venv/bin/python -m pytest")


def sections(path: Path) -> dict[str, str]:
    parts = re.split(r"^## (.+)$", path.read_text(), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def script(text: str) -> str:
    return "\n".join(block for block in blocks(text, "sh") if not block.startswith(ELSEWHERE))


def ray_error_mm(frame: dict[str, float]) -> float:
    found = SourceFrame(**{name: value for name, value in frame.items() if name != "magnification"})
    return ray_error(SCANNER, THETA.source_frame(SCANNER.source_to_cor_mm), found).rms_mm


@pytest.mark.slow
def test_the_readme_s_block_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_in_process(script(README.read_text()))
    with Image.open(tmp_path / "report.png") as picture:
        assert picture.size >= (256, 256)


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
    run_in_process("".join(blocks(PHANTOM.read_text(), "sh") + blocks(FIRST_CALIBRATION.read_text(), "sh")))
    assert "</svg>" in (tmp_path / "our-phantom.svg").read_text()
    found = json.loads((tmp_path / "result.json").read_text())
    assert (found["verdict"], found["predicted_ray_error_mm"]["upper_95"] < 0.1) == ("pass", True)
    assert found["scale_uncertainty_percent"] == pytest.approx(0.14, abs=0.01)
    measured_wrongly = ("--source-to-cor-mm", 855, "--phantom", "examples/phantom-measured.json", "--json")
    other = json.loads(in_process("calibrate", "phantom-scan.h5", "--data", "counts", *measured_wrongly))
    assert other["source_frame"] == pytest.approx(found["source_frame"], rel=1e-6)
    assert other["theta"]["source_shift_mm"] != pytest.approx(found["theta"]["source_shift_mm"], rel=0.1)


@pytest.mark.nightly
def test_the_command_line_block_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_in_process(script(sections(DEMO)["The command line"]))
    found = json.loads((tmp_path / "result.json").read_text())
    assert found["verdict"] == "pass"
    assert ray_error_mm(found["source_frame"]) < 0.06
    with h5py.File(tmp_path / "log-volume.h5") as file:
        data = file["entry/reconstruction/data"]
        assert (data.shape, data.attrs["units"]) == ((2, 256, 256), "1/mm")
        # The middle of a log of green wood, with rings and knots.
        assert 0.010 < float(np.median(data[0][96:160, 96:160])) < 0.025
    assert np.loadtxt(tmp_path / "geometry.txt").shape == (360, 6)
    assert (tmp_path / "phantom-report.html").read_text().startswith("<!doctype html>")
    for name in ("log.png", "log-20-views.png"):
        with Image.open(tmp_path / name) as picture:
            assert picture.format == "PNG"


@pytest.mark.slow
def test_the_files_that_the_formats_page_makes_can_be_read(tmp_path):
    for block in blocks(sections(ROOT / "docs/look-up/formats.md")["Input"], "python"):
        subprocess.run([sys.executable, "-c", block], cwd=tmp_path, check=True)
    paths = (tmp_path / "scan.npz", tmp_path / "scan.h5")
    with reading_scan(paths[0], counts=True) as compressed, reading_scan(paths[1], counts=True) as nxtomo:
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
    places = {"row_pitch_mm": 20.0, "centre_mm": (10.0, -30.0), "first_slice_mm": 100.0}
    with new_volume(tmp_path / "volume.h5", (3, 6, 6), **places) as volume:
        volume.write(0, np.ones((3, 6, 6), np.float32))
    (tmp_path / "napari.py").write_text(NAPARI)
    assert [
        subprocess.run([sys.executable, "-c", block], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
        for block in blocks(sections(ROOT / "docs/look-up/formats.md")["Opening a volume"], "python")
    ] == ["(3, 6, 6) 20.0 1.5 1.5 100.0 6.25 -33.75 ('z', 'x', 'y') mm\n", "(6, 6) 1/mm 120.0\n"]


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
    for script in (
        f"{for_astra}\nassert projector.shape == (90 * 768, 256 * 256)",
        f"{for_odl}\nsource = geometry.src_position(geometry.angles)\nassert {turned}",
        f"{for_cil}\nassert (len(geometry.angles), geometry.num_pixels, geometry.source[1] < 0) == (90, 768, True)",
    ):
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


@pytest.mark.slow
def test_fixed_pairs_are_calibrated_as_their_page_has_it(tmp_path, monkeypatch):
    page = (ROOT / "docs/do/fixed-pairs.md").read_text()
    monkeypatch.chdir(tmp_path)
    simulated, calibrated, *of_log = script(page).splitlines()
    run_in_process(simulated)
    answer = in_process(*shlex.split(calibrated)[1:])
    assert "4 pairs with L-shape: pass" in answer
    (said,) = blocks(page, "text")
    # Other machines round elsewhere, so that the last digits may differ.
    shown, written = (re.split(r"(\d[\d.]*\d)", text[text.index("All rays") :]) for text in (answer, said))
    assert [" ".join(words.split()) for words in shown[::2]] == [" ".join(words.split()) for words in written[::2]]
    assert np.array(shown[1::2], float) == pytest.approx(np.array(written[1::2], float), abs=0.004, rel=1e-3)
    assert (tmp_path / "ring.png").read_bytes().startswith(b"\x89PNG")
    Path("calibrated.json").write_text(in_process(*shlex.split(calibrated)[1:], "--json"))
    for line in filter(None, of_log):
        in_process(*shlex.split(line)[1:])
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")


def test_two_scans_are_packed_as_their_page_has_it(tmp_path, monkeypatch):
    page, given = script((ROOT / "docs/do/send-a-scan.md").read_text()), ("--theta", THETA_FLAG, "--views", 60)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "phantom.json").write_text((ROOT / "examples/phantom-measured.json").read_text())
    for body, name in (("phantom.json", "board.h5"), ("log", "log.h5")):
        in_process("simulate", body, *given, "-o", name)
    run_in_process(page)
    assert "pass" in in_process(*shlex.split(page.splitlines()[-1])[1:])


def test_the_table_of_methods_is_that_of_auto():
    rows = [
        f"| {views} | " + " | ".join(expected_errors(errors, number) for errors in EXPECTED_ERRORS.values()) + " |"
        for number, views in enumerate(VIEWS)
    ]
    times = (f"{milliseconds(method, VIEWS[0])}, {milliseconds(method, VIEWS[-1])}" for method in EXPECTED_ERRORS)
    rows.append(f"| {VIEWS[0]} and {VIEWS[-1]} views, ms | " + " | ".join(times) + " |")
    table = "\n".join(rows)
    assert table in (ROOT / "docs/do/methods.md").read_text(), f"docs/do/methods.md needs these rows:\n{table}"


def expected_errors(errors, number):
    return ", ".join(f"{error:#.2g}" for error in errors[number]) if number < len(errors) else "not measured"


def milliseconds(method, views):
    return f"{float(f'{1e3 * seconds_a_slice(method, views, 768, 256):.2g}'):g}"


def test_every_shell_block_is_run_by_a_test():
    others = [ROOT / f"docs/do/{name}.md" for name in ("export", "fixed-pairs", "simulate", "send-a-scan")]
    run = [README, DEMO, FIRST_CALIBRATION, PHANTOM, *others]
    run += [ROOT / "docs/start/first-program.md"]  # by test_client_programs.py
    run += [ROOT / "docs/understand/measured.md"]  # by test_measured.py
    run += [ROOT / "docs/do/image-quality.md"]  # by test_image_quality.py
    run_here = {block for path in run for block in blocks(path.read_text(), "sh")}
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
            named = {flag for flag in re.findall(r"(?<!\S)--?[a-z][a-z-]*", code) if flag not in OTHER_PROGRAMS_FLAGS}
            assert named <= flags | {"--help"}, code


@pytest.mark.parametrize("name", GENERATED)
def test_the_generated_pages_are_current(name):
    assert (ROOT / "docs" / name).read_text() == GENERATED[name](), "run make docs"


def test_the_example_inputs_are_valid():
    contracts = {"bad-day": Physics, "scanner": ScannerSpec, "schedule": ScheduleSpec, "fixed-pairs": PairedScanner}
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


def texts():
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
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
    assert not [f"{path.relative_to(ROOT)}: {match[0]}" for path, text in texts() for match in forbidden.finditer(text)]


PAGE = (ROOT / "docs/do/connect.md").read_text()
PROGRAMS = sorted((ROOT / "examples/clients").glob("whole_job.*"))
DOCUMENT = json.loads((ROOT / "openapi/openapi.json").read_text())
ROUTES = {re.sub(r"\{\w+\}", "{}", path): methods for path, methods in DOCUMENT["paths"].items()}


def fields(schema: str) -> set[str]:
    return set(DOCUMENT["components"]["schemas"][schema]["properties"])


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_a_program_has_the_steps_of_the_page(path):
    steps = re.findall(r"^## (Repeats and refusals|\d\. .+)$", PAGE, re.MULTILINE)
    assert len(steps) == 10
    assert re.findall(r"^ *(?:#|//) (Repeats and refusals|\d\. .+)$", path.read_text(), re.MULTILINE) == steps


def test_the_page_s_routes_are_the_contract_s():
    requests = re.findall(r"`(GET|POST|PUT|PATCH|DELETE) (/[^`?]*)", PAGE)
    assert len(requests) > 10
    assert [each for each in requests if each[0].lower() not in ROUTES.get(re.sub(r"\{\w+\}", "{}", each[1]), {})] == []


@pytest.mark.parametrize("path", [path for path in PROGRAMS if path.suffix != ".py"], ids=lambda path: path.name)
def test_a_program_s_paths_are_the_contract_s(path):
    sent = re.findall(r"/v1/[^\"?`]*", re.sub(r"\$?\{[^{}]*\}|\$\w+", "x", path.read_text()))
    assert len(sent) > 10
    patterns = [re.sub(r"\{\w+\}", "[^/]+", known) for known in DOCUMENT["paths"]]
    assert {each for each in sent if not any(re.fullmatch(pattern, each) for pattern in patterns)} == set()


def test_the_page_s_answers_have_the_contract_s_fields():
    failure, calibration = (json.loads(text) for text in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL))
    assert failure.keys() <= fields("Failure")
    assert calibration.keys() <= fields("CalibrationSucceeded")
    assert calibration["predicted_ray_error_mm"].keys() <= fields("PredictedRayError")


def test_the_page_has_every_type_of_a_file_for_generators():
    operations = [operation for methods in DOCUMENT["paths"].values() for operation in methods.values()]
    answers = [answer for operation in operations for answer in operation["responses"].values()]
    types = {kind for answer in answers for kind in answer.get("content", {}) if not kind.startswith("text/")}
    types -= {"application/json", "application/problem+json"}
    [row] = re.findall(r"^\| others \|.*$", PAGE, re.MULTILINE)
    assert set(re.findall(r"`([a-z]+/[\w+-]+)`", row)) == types
