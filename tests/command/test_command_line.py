"""How every command reads its line, what a shell completes, and how a command reports that it has no answer."""

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import redirect_stderr
from pathlib import Path

import pytest
import typer
from missing_parts import first_by_day
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_contracts.calibrations import CalibrationOptions, PaperOptions
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_contracts.scans import PrepareOptions
from sawmill_vocabulary import Progress
from sawmill_worker.commands.terminal import answering, say, showing_progress

SAWMILL = Path(sys.executable).with_name("sawmill")


@pytest.fixture
def scan(tmp_path):
    path = tmp_path / "scan.h5"
    path.write_text("whoever reads this finds that it is no scan")
    return path


@pytest.mark.parametrize(
    ("command", "contract", "prefix"),
    [
        ("calibrate", CalibrationOptions, ""),
        ("calibrate", PaperOptions, "paper_"),
        ("calibrate", PrepareOptions, ""),
        ("drift", PrepareOptions, ""),
        ("reconstruct", ReconstructionOptions, ""),
    ],
)
def test_every_field_of_a_contract_is_a_flag_with_its_description(command, contract, prefix):
    options = {parameter.name: parameter for parameter in typer.main.get_command(main).commands[command].params}
    fields = {name: field for name, field in contract.model_fields.items() if name != "paper"}
    for name, field in fields.items():
        flag = options[prefix + name]
        assert f"--{(prefix + name).replace('_', '-')}" in flag.opts
        assert field.description
        assert flag.help.replace("\\[", "[") == field.description


def test_all_that_is_missing_is_named_at_once_with_arguments_choices_and_what_a_flag_needs(wrong_use, scan):
    assert (
        "Missing option '--data' <counts|line-integrals> (Kind of the numbers; never guessed), "
        "option '--source-to-cor-mm' <float range> (r_S, source to centre of rotation, mm) and "
        "option '--phantom' NAME|FILE (l-shape, rectangle-with-hole, a drawing FILE.json"
    ) in wrong_use("calibrate", scan)
    missing = wrong_use("reconstruct")
    for each in ("argument 'SCAN'", "option '--data'", "option '--output' / '-o' OUT", "'--theta' or '--calibration'"):
        assert each in missing
    needed = wrong_use("reconstruct", scan, "--theta", "1,700,3,4,0")
    assert "option '--data'" in needed
    assert "option '--source-to-cor-mm'" in needed
    assert "--calibration'" not in needed


@pytest.mark.parametrize(
    ("line", "suggestion"),
    [
        (("calibrat",), "Did you mean 'calibrate', 'calibrate-pairs'?"),
        (("phantom", "darw"), "Did you mean 'draw'?"),
        (("calibrate", "scan.h5", "--dta", "counts"), "--data"),
        (("serve", "--prot", "80"), "--port"),
        (("calibrate", "scan.h5", "--data", "line-integral"), "Did you mean 'line-integrals'?"),
        (("calibrate", "scan.h5", "--without", "blur", "--without", "outlier"), "Did you mean 'outliers'?"),
        (("calibrate", "scan.h5", "--phantom", "l-shap"), "Did you mean 'l-shape'?"),
        (("simulate", "log-with-fantom"), "Did you mean 'log-with-phantom'?"),
        (("export", "--to", "astro"), "Did you mean 'astra'?"),
    ],
)
def test_a_misspelt_name_gets_the_nearest_one(wrong_use, scan, monkeypatch, line, suggestion):
    monkeypatch.chdir(scan.parent)
    complaint = wrong_use(*line)
    assert suggestion in complaint
    assert "Value error" not in complaint


def test_what_is_wrong_is_named_before_what_is_missing_and_nothing_is_suggested_that_is_not_near(wrong_use, scan):
    complaint = wrong_use("calibrate", scan, "--data", "x")
    assert "'x' is not one of" in complaint
    assert "Did you mean" not in complaint


def question(shell: str, line: str) -> dict[str, str]:
    """The variables in which a shell asks for the last word of a line."""
    bash = {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    return {"bash": bash, "zsh": {"_TYPER_COMPLETE_ARGS": line}}[shell] | {"_SAWMILL_COMPLETE": f"complete_{shell}"}


def answer(shell: str, line: str) -> str:
    done = CliRunner().invoke(main, prog_name="sawmill", env=question(shell, line))
    assert done.exit_code == 0
    return done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh"])
@pytest.mark.parametrize(
    ("line", "choices"),
    [
        ("sawmill re", {"reconstruct", "repeatability", "report", "restore"}),
        ("sawmill phantom ", {"plan", "draw"}),
        ("sawmill calibrate scan.h5 --paper-o", {"--paper-objective"}),
        ("sawmill reconstruct --filter ha", {"hamming", "hann"}),
        ("sawmill calibrate --phantom ", {"l-shape", "rectangle-with-hole"}),
        ("sawmill phantom draw rect", {"rectangle-with-hole"}),
        ("sawmill simulate lo", {"log", "log-with-phantom"}),
    ],
)
def test_a_shell_completes_commands_flags_values_and_phantoms(shell, line, choices):
    answered = answer(shell, line)
    of_zsh = {each.split('"')[1] for each in answered.splitlines() if '"' in each}
    assert (set(answered.split()) if shell == "bash" else of_zsh) == choices


def test_zsh_offers_files_where_nothing_else_fits():
    assert answer("zsh", "sawmill calibrate sc").strip() == "_files"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_the_script_for_bash_completes_in_bash():
    script = (
        f'PATH="{SAWMILL.parent}:$PATH"\n'
        'eval "$(_SAWMILL_COMPLETE=source_bash sawmill)"\n'
        "COMP_WORDS=(sawmill export --to a)\nCOMP_CWORD=3\n"
        '"$(complete -p sawmill | sed "s/.*-F \\([^ ]*\\) .*/\\1/")" sawmill\n'
        'echo "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(["bash", "--norc", "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.strip() == "astra", done.stderr


@pytest.mark.parametrize("shell", first_by_day(1, ["zsh", "bash"]))
def test_completion_is_installed_for_a_shell(shell, tmp_path):
    environment = os.environ | {"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    command = [SAWMILL, "--install-completion", shell]
    subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    scripts = [path.read_text() for path in tmp_path.rglob("*sawmill*") if path.is_file()]
    assert any("_SAWMILL_COMPLETE" in script for script in scripts)


@pytest.mark.parametrize(
    ("error", "kind", "code"),
    [(OSError("no space"), "passing", "file-system"), (MemoryError(), "input", "out-of-memory")],
)
def test_troubles_of_the_machine_are_reported(capsys, error, kind, code):
    with pytest.raises(typer.Exit) as ended, answering(as_json=True):
        raise error
    reported = capsys.readouterr()
    failure = json.loads(reported.out)["failure"]
    assert ended.value.exit_code == 1
    assert (failure["kind"], failure["code"]) == (kind, code)
    assert reported.err == f"{code}: {failure['detail']}\n"


def test_a_defect_is_reported_and_keeps_its_traceback(capsys):
    defect = ZeroDivisionError("oops")
    with pytest.raises(ZeroDivisionError) as raised, answering(as_json=True):
        raise defect
    assert raised.value is defect
    assert json.loads(capsys.readouterr().out)["failure"]["kind"] == "internal"


def test_sigterm_ends_a_command_as_an_exit_does_and_is_nobody_s_afterwards(capsys):
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended, answering(as_json=True):
        os.kill(os.getpid(), signal.SIGTERM)
    assert ended.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before
    assert capsys.readouterr().out == ""


class _Callback:
    """What it raises on its way out nobody catches, as of a callback of the interpreter's."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_sigterm_that_gets_lost_ends_the_command_at_its_next_report():
    reached = []

    def command():
        with answering(), showing_progress("counting") as report:
            _Callback()
            reached.append("the next report")
            report(Progress(fraction=0.5, stage="half"))
            reached.append("more")

    with pytest.raises(SystemExit) as ended:
        command()
    assert (ended.value.code, reached) == (143, ["the next report"])
    with answering(), showing_progress("counting") as report:
        report(Progress(fraction=0.5, stage="half"))


def test_a_long_sentence_stays_one_line_and_brackets_stay_brackets(capsys):
    sentence = "[bold]" + "a path of some length/" * 20
    say(sentence)
    assert capsys.readouterr().err == sentence + "\n"


def test_a_command_whose_standard_error_is_closed_shows_no_progress():
    with redirect_stderr(None), showing_progress("counting") as report:
        report(Progress(fraction=0.5, stage="half"))
