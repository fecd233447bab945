"""The command line in this process, and small scans that it made itself."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from results import write_answer
from typer.testing import CliRunner, Result

from sawmill_command.commands import main
from sawmill_contracts.calibrations import CalibrationFile

THETA = "2.55,714.7,319.9,43.7,0.281"
SCANNER = ("--source-to-cor-mm", "859.46", "--detector-pitch-mm", "4.508593749")
CELLS, VIEWS = 256, 60
Run = Callable[..., Result]


def invoke(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments], terminal_width=200)
    assert result.exit_code == code, f"{result.output}\n{result.exception!r}"
    return result


@pytest.fixture(scope="session")
def run() -> Run:
    return invoke


@pytest.fixture(scope="session")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scans")


def simulated(path: Path, body: str, *flags: object) -> Path:
    cells = ("--detector-pixels", CELLS, "--views", VIEWS)
    invoke("simulate", body, "--theta", THETA, *SCANNER, *cells, "-o", path, *flags)
    return path


@pytest.fixture(scope="session")
def phantom_scan(scans: Path) -> Path:
    """Line integrals of the L with 1 % noise; the file carries angles and pitches."""
    return simulated(scans / "phantom.h5", "l-shape", "--data", "line-integrals", "--noise", 0.01, "--rows", 2)


@pytest.fixture(scope="session")
def bare_scan(scans: Path, phantom_scan: Path) -> Path:
    """The same as an array that carries nothing else."""
    with h5py.File(phantom_scan) as file:
        np.save(scans / "bare.npy", file["entry/instrument/detector/data"][()])
    return scans / "bare.npy"


@pytest.fixture(scope="session")
def stack(scans: Path) -> Path:
    """Counts of a log with the L on its end: rows 0 and 1 show the phantom, 2 and 3 the log."""
    return simulated(scans / "stack.h5", "log-with-phantom", "--rows", 4, "--phantom-rows", 2)


@pytest.fixture(scope="session")
def result_file(scans: Path, phantom_scan: Path) -> Path:
    """What `calibrate --json` printed of the phantom's scan."""
    flags = ("--data", "line-integrals", "--source-to-cor-mm", 859.46, "--phantom", "l-shape", "--json")
    (scans / "result.json").write_text(invoke("calibrate", phantom_scan, *flags).stdout)
    return scans / "result.json"


@pytest.fixture(scope="session")
def result_hdf5(scans: Path, result_file: Path) -> Path:
    """The same answer as the service's `result.h5` has it."""
    write_answer(scans / "result.h5", CalibrationFile.read(result_file.read_text()))
    return scans / "result.h5"


@pytest.fixture
def wrong_use() -> Callable[..., str]:
    """The complaint about wrong use, on standard error alone."""

    def reported(*arguments: object) -> str:
        result = invoke(*arguments, code=2)
        assert result.stdout == ""
        return " ".join(result.stderr.replace("│", " ").split())

    return reported


@pytest.fixture
def failure() -> Callable[..., dict[str, str]]:
    def reported(*arguments: object) -> dict[str, str]:
        document = json.loads(invoke(*arguments, "--json", code=1).stdout)
        assert document["state"] == "failed"
        return document["failure"]

    return reported
