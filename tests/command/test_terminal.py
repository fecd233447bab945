"""How a command reports that it has no answer."""

import json
import os
import signal
from contextlib import redirect_stderr

import pytest
import typer

from sawmill_vocabulary import Progress
from sawmill_worker.commands.terminal import answering, say, showing_progress


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


def test_people_get_no_json(capsys):
    with pytest.raises(typer.Exit), answering():
        raise OSError("no space")
    assert capsys.readouterr().out == ""


def test_a_long_sentence_stays_one_line_and_brackets_stay_brackets(capsys):
    sentence = "[bold]" + "a path of some length/" * 20
    say(sentence)
    assert capsys.readouterr().err == sentence + "\n"


def test_a_command_whose_standard_error_is_closed_shows_no_progress():
    with redirect_stderr(None), showing_progress("counting") as report:
        report(Progress(fraction=0.5, stage="half"))
