"""What a template's children share with it and with one another, and what becomes of them when it is gone."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from live_service import descendants, running, wait_until
from missing_parts import skip_without

from sawmill_command import examples
from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_formats.output import calibration_file
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.attempts.template import NOT_FORKED, ForkedProcess, Template, template_library
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.workers.poller import run_worker
from sawmill_platform.workers.program import attempt_environment
from sawmill_vocabulary import DataKind
from sawmill_worker.program import ATTEMPT_COMMAND

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("forking", "own_templates")]


@pytest.fixture(scope="module")
def forking():
    if template_library() is None:
        skip_without("attempts are fresh processes on this machine")


@pytest.fixture
def impatient(store, start, command, settings):
    """A runner that soon gives up its template, and the template."""
    environment, library = attempt_environment(store, settings), template_library()
    template = Template(command, environment, library, fork_timeout_s=0.2, book_timeout_s=0.1)
    return start(starter=template), template


@pytest.fixture
def template(starter):
    return starter.starter


def test_the_limits_of_a_child_are_not_its_templates_and_a_running_child_outlives_its_template_which_is_replaced(
    runner, template, queue, in_background, store
):
    queue("tell-limits")
    assert runner.run_next() is JobState.SUCCEEDED
    assert Path(f"/proc/{template.process_id}/limits").read_text() == Path("/proc/self/limits").read_text()
    job = queue("pause")
    queue("succeed")
    outcome = in_background(runner.run_next)
    wait_until(lambda: store.jobs.get(job.id).state is JobState.RUNNING)
    first = template.process_id
    os.kill(first, signal.SIGKILL)
    assert outcome.result(timeout=60) is JobState.SUCCEEDED
    assert runner.run_next() is JobState.SUCCEEDED
    runner.warm_up()
    assert template.process_id != first


def test_a_child_leads_a_session_of_its_own_and_one_killed_after_its_template_is_a_lost_attempt(
    template, runner, talk, store
):
    job, outcome, child = talk(runner)
    assert os.getsid(child) == os.getpgid(child) == child
    assert os.getsid(template.process_id) == template.process_id
    os.kill(template.process_id, signal.SIGKILL)
    os.killpg(child, signal.SIGKILL)
    assert outcome.result(timeout=60) is JobState.QUEUED
    assert store.jobs.get(job.id).losses == 1
    wait_until(lambda: not running(child))


def test_a_stopped_template_keeps_no_job_from_its_end(impatient, store, talk):
    runner, template = impatient
    job, outcome, child = talk(runner)
    os.kill(template.process_id, signal.SIGSTOP)
    os.kill(child, signal.SIGSEGV)
    assert outcome.result(timeout=60) is JobState.QUEUED, "nobody knows how it ended"
    assert store.jobs.get(job.id).losses == 1


def test_a_stopped_template_is_replaced(impatient, queue):
    runner, template = impatient
    for _ in range(3):
        queue("succeed")
    assert runner.run_next() is JobState.SUCCEEDED
    stopped = template.process_id
    os.kill(stopped, signal.SIGSTOP)
    assert runner.run_next() is JobState.SUCCEEDED, "in the spare that was there"
    assert runner.run_next() is JobState.SUCCEEDED, "in a child of a new template"
    assert template.process_id != stopped


def said(child):
    while not (messages := child.receive(60)):
        assert not child.hung_up
    return messages[0].progress


SAYING = """
import os, socket, time
import numpy as np
from sawmill_platform.attempts.forking import REQUESTS, serve
from sawmill_platform.attempts.protocol import ProgressMade, to_line
from sawmill_vocabulary import Progress

def say(channel, **progress):
    channel.write(to_line(ProgressMade(progress=Progress(stage="search", **progress))))

"""
DRAWING = f"""{SAYING}
def draw(channel):
    say(channel, fraction=float(np.random.random()))

serve(socket.socket(fileno=int(os.environ[REQUESTS])), draw)
"""


def test_children_draw_different_numbers():
    drawing = Template([sys.executable, "-c", DRAWING], os.environ, template_library())
    drawn = set()
    for _ in range(4):
        child = drawing.start()
        drawn.add(said(child).fraction)
        child.end(5)
    drawing.close()
    assert len(drawn) == 4


LEAVING = f"""{SAYING}
def leave(channel):
    if os.fork() == 0:
        os.setsid()
        left = os.fork()
        if left == 0:
            time.sleep(600)
        say(channel, fraction=0.5, generation=left)
        os._exit(0)
    os.wait()

serve(socket.socket(fileno=int(os.environ[REQUESTS])), leave)
"""


def test_what_a_child_leaves_ends_before_its_own_end_is_reported():
    leaving = Template([sys.executable, "-c", LEAVING], os.environ, template_library())
    child = leaving.start()
    left = said(child).generation
    wait_until(lambda: not child.alive)
    assert not running(left)
    assert child.end(5) == 0
    leaving.close()


def test_a_fork_that_the_system_refuses_is_a_process_that_never_was():
    assignment, book = os.pipe()[1], os.pipe()
    os.close(book[1])
    refused = ForkedProcess(assignment, book[0])
    assert refused.wait(60) == NOT_FORKED
    refused.stdin.close()


def small_calibration(store, folder):
    scanner = store.scanners.create(ScannerSpec(name="line", constants=ScannerConstants(**vars(examples.SCANNER))))
    examples.write_mill_stack(folder / "stack.h5", 20, examples.mill_slices(log_rows=1))
    spec = ScanSpec(
        scanner_id=scanner.id, data=DataKind.COUNTS, phantom_id="l-shape", phantom_rows=f"0:{examples.PHANTOM_ROWS}"
    )
    scan = store.scans.accept(spec, store.files.receive([(folder / "stack.h5").read_bytes()], max_bytes=2**30))
    return scan, store.calibrations.accept(CalibrationRequest(scan_id=scan.id))


@pytest.mark.nightly
def test_the_science_answers_alike_to_the_bit_in_a_child_and_in_a_fresh_process(
    store, settings, stop, attempts, tmp_path
):
    unhurried = settings.model_copy(update={"memory_limit_bytes": None, "start_timeout_s": 250})
    forking = attempts(unhurried, ATTEMPT_COMMAND)
    each_anew = attempts(unhurried.model_copy(update={"fork_attempts": False}), ATTEMPT_COMMAND)
    scan, first = small_calibration(store, tmp_path)
    second = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    forked = Runner(store, unhurried, stop, attempts=forking)
    assert [forked.run_next(), forked.run_next()] == [JobState.SUCCEEDED] * 2
    made = forking.starter.process_id
    assert len(list(Path(f"/proc/{made}/task").iterdir())) == 1, "a thread that a child would not have"
    opened = [str(file.readlink()) for file in Path(f"/proc/{made}/fd").iterdir()]
    assert not any("sawmill.db" in name for name in opened)
    forked.close()
    fresh = Runner(store, unhurried, stop, attempts=each_anew)
    assert fresh.run_next() is JobState.SUCCEEDED
    fresh.close()
    files = (store.files.result(kinds.CALIBRATE, each.id, "result.h5") for each in (first, second))
    one, other = map(calibration_file.read_calibration, files)
    of_times = {"timing_s": None}
    assert json.dumps(one.answer | of_times, sort_keys=True) == json.dumps(other.answer | of_times, sort_keys=True)
    assert all(np.array_equal(one.arrays[name], other.arrays[name]) for name in one.arrays)


def test_a_worker_without_a_job_for_long_ends_its_template_and_starts_one_for_the_next_job(
    store, settings, command, program, queue, in_background, stop
):
    def templates():
        return [child for child in descendants(os.getpid()) - others if starts_attempts(child)]

    def starts_attempts(child):
        with suppress(FileNotFoundError, ProcessLookupError):  # a process that has just ended
            return command[-1].encode() in Path(f"/proc/{child}/cmdline").read_bytes()
        return False

    others = descendants(os.getpid())  # processes that earlier tests have left behind
    first = queue("succeed")
    outcome = in_background(run_worker, program, store, settings.model_copy(update={"spare_idle_s": 0.3}), stop)
    try:
        wait_until(lambda: store.jobs.get(first.id).state is JobState.SUCCEEDED)
        wait_until(lambda: not templates())
        second = queue("succeed")
        wait_until(lambda: store.jobs.get(second.id).state is JobState.SUCCEEDED)
        wait_until(lambda: not templates())
    finally:
        stop.set()
    outcome.result(timeout=60)


def test_a_template_gives_back_the_pages_of_its_libraries_and_can_use_them_still():
    script = """
import re
from pathlib import Path
import numpy as np
from sawmill_platform.attempts.forking import give_back_memory

def resident():
    of_code = r"r-xp .*openblas.*\\n(?:[A-Z].*\\n)*?Rss: +(\\d+) kB"
    return [int(size) for size in re.findall(of_code, Path("/proc/self/smaps").read_text())]

matrix = np.eye(300) + 1.0
inverse = np.linalg.inv(matrix)
assert sum(resident()) > 0
give_back_memory()
assert resident() and sum(resident()) == 0
assert np.array_equal(np.linalg.inv(matrix), inverse)
"""
    subprocess.run([sys.executable, "-c", script], check=True)
