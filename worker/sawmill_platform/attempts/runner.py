"""Claims of jobs, and one supervised attempt for each claim."""

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

import structlog
from pydantic import ValidationError

from sawmill_platform.attempts.failures import LIMITS_MET, died, duration, failure_of
from sawmill_platform.attempts.limits import overuse
from sawmill_platform.attempts.patience import Patience
from sawmill_platform.attempts.process import (
    AttemptNotStarted,
    AttemptProcess,
    AttemptStarter,
    AttemptTalksNonsense,
    processor_s_of,
)
from sawmill_platform.attempts.protocol import AnyMessage, Assignment, Begun, Failed, Kept, ProgressMade, Succeeded
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.contracts.kind_declarations import declaration_of, reading_limit_s
from sawmill_platform.errors import (
    DamagedResult,
    InvalidOutput,
    LeaseLost,
    NotFound,
    StorageFull,
    StorageUnavailable,
    disk_outage_reported,
)
from sawmill_platform.files.verified_results import compute_digest
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.jobs.job_store import Claim
from sawmill_platform.jobs.wait_estimate import ANY, Selection
from sawmill_platform.workers.logs import about_attempt
from sawmill_platform.workers.settings import ExecutionSettings, process_name
from sawmill_vocabulary import Progress

# Most that a library may have failed to write at once, and so most that a full disk may have free.
BUFFER_BYTES = 16 * 2**20

Read = TypeVar("Read")


class Runner:
    """Runner of claimed jobs, each in a process that is kept ready; threads may share a runner."""

    def __init__(
        self,
        store: JobServiceStore,
        settings: ExecutionSettings,
        stop: threading.Event,
        *,
        attempts: AttemptStarter,
        on_ended: Callable[[str], None] | None = None,
        on_able: Callable[[], None] = lambda: None,
    ) -> None:
        self._store = store
        self._on_ended = on_ended
        self._on_able = on_able
        self._settings = settings
        self._stop = stop
        self._attempts = attempts
        self._spares: list[AttemptProcess] = []
        self._lock = threading.Lock()
        self.name = process_name()
        self.able = False
        self._put_off_for = ""

    def run_next(self, selection: Selection = ANY) -> JobState | None:
        """Claim the next job in turn and run it to the end of the attempt."""
        if self._stop.is_set():
            return None
        process = self._take_ready()
        try:
            claim = self._store.jobs.claim(self.name, selection)
        except BaseException:
            self._keep(process)
            raise
        self._put_off_for = ""
        if not self.able:
            self.able = True
            self._on_able()
        if claim is None:
            self._keep(process)
            return None
        if not self._spares:
            self.warm_up()
        log = structlog.get_logger()
        with about_attempt(claim.job):
            log.info("attempt-started")
            state: JobState | None = None
            try:
                try:
                    with disk_outage_reported("an attempt"):  # at any place; otherwise the job would wait for its lease
                        state = self._attempt(claim, process)
                except (StorageFull, StorageUnavailable) as error:
                    state = self._put_off(claim, failure_of(error, claim.job.kind))
            except LeaseLost:
                log.warning("lease-lost")
            log.info("attempt-ended", state=state)
        if self._on_ended is not None and state is not None and state.ended:
            self._on_ended(claim.job_id)
        return state

    def log_put_off(self, error: Exception) -> None:
        """Log why no job was claimed: once, until a job is claimed or the reason changes."""
        if str(error) != self._put_off_for:
            self._put_off_for = str(error)
            structlog.get_logger().warning("claim-put-off", reason=str(error))

    def warm_up(self) -> None:
        """Start the spare processes that are missing, so that no job has to wait for one.

        The method is for times without a job: a process that starts keeps a core busy for about a second. A process
        that the system does not start now is started when a job needs it.
        """
        try:
            with self._lock:
                while len(self._spares) < self._settings.spare_processes and not self._stop.is_set():
                    self._spares.append(self._attempts.start())
        except OSError as error:
            structlog.get_logger().warning("spare-not-started", reason=str(error))

    def close(self) -> None:
        """End the spare processes and their template; a later job starts new ones."""
        with self._lock:
            spares, self._spares = self._spares, []
        self._attempts.close()
        for process in spares:
            process.end(self._settings.kill_grace_s)

    def _take_ready(self) -> AttemptProcess:
        with self._lock:
            process = self._spares.pop(0) if self._spares else None
        if process is not None:
            if process.alive:
                try:
                    return self._ready(process)
                except AttemptNotStarted as error:
                    structlog.get_logger().warning("spare-not-ready", reason=str(error))
            else:
                process.end(self._settings.kill_grace_s)
        return self._ready(self._attempts.start())

    def _take_for_check(self) -> AttemptProcess:
        """Take a process for the check of a result, and start another one for the next job."""
        process = self._take_ready()
        self.warm_up()
        return process

    def _ready(self, process: AttemptProcess) -> AttemptProcess:
        try:
            process.wait_until_ready(self._attempts.patience_s(self._settings.start_timeout_s))
        except BaseException:
            self._attempts.close()  # a template that hangs is replaced at the next start
            process.end(self._settings.kill_grace_s)
            raise
        return process

    def _keep(self, process: AttemptProcess) -> None:
        with self._lock:
            self._spares.insert(0, process)  # this process is ready, the other ones may not be yet

    def _attempt(self, claim: Claim, process: AttemptProcess) -> JobState:
        output: Path | None = None
        try:
            output = self._store.files.make_attempt_folder(claim.job_id, claim.attempt)
            return _Supervision(
                self._store, self._settings, self._stop, claim, process, self._take_for_check, output
            ).run()
        finally:
            process.end(self._settings.kill_grace_s)
            if output is not None:
                self._store.files.remove(output)

    def _put_off(self, claim: Claim, outage: Failure) -> JobState | None:
        """Return a job to the queue because of an outage, as soon as its row can be written."""
        said = ""
        while True:
            try:
                return self._store.jobs.fail(claim, outage, retries=self._settings.retries)
            except (StorageFull, StorageUnavailable) as error:
                said = _say_once("end-put-off", error, said)
                if self._stop.wait(self._settings.housekeeping_s):
                    return None


@dataclass
class _Supervision:
    """Supervision of one attempt: relays its progress, keeps its lease, and ends it."""

    _store: JobServiceStore
    _settings: ExecutionSettings
    _stop: threading.Event
    _claim: Claim
    _process: AttemptProcess
    _take_ready: Callable[[], AttemptProcess]
    _output: Path
    _progress: Progress | None = None
    _last_beat: float = field(default_factory=time.monotonic)
    _last_look: float = field(default_factory=time.monotonic)
    _missed: str = ""
    _give_back_at: float | None = None
    _limits: Begun | None = None
    _input: Path | None = None

    def run(self) -> JobState:
        answer: Succeeded | Failed | JobState | None = self._begin()
        try:
            if answer is None:
                answer = self._watch()
            if isinstance(answer, Succeeded):
                # With all processes that it has started: nobody writes to files that are checked and published.
                self._process.end(self._settings.kill_grace_s)
                result, sha256 = self._while_leased("checking a result", partial(self._check, answer))
                self._publish(result, sha256, answer.peak_memory_bytes)
                return JobState.SUCCEEDED
        except InvalidOutput as error:
            structlog.get_logger().exception("attempt-left-nonsense")
            # The files may be missing because the data folder has gone.
            answer = Failed(failure=self._outage() or _invalid_result(str(error)))
        except (AttemptTalksNonsense, ValidationError):
            structlog.get_logger().exception("attempt-answered-nonsense")
            answer = Failed(failure=_invalid_result("the job's answer is not what jobs of its kind answer with"))
        if isinstance(answer, Failed):
            return self._store.jobs.fail(
                self._claim, answer.failure, retries=self._settings.retries, peak_memory_bytes=answer.peak_memory_bytes
            )
        return answer

    def _begin(self) -> Failed | None:
        """Hand the job over to the process, or return why it cannot be handed over."""
        try:
            self._given = self._store.jobs.handed_over(self._claim.job_id)
        except NotFound as error:
            code = f"{error.kind}-deleted"
            return Failed(failure=Failure(kind=FailureKind.INPUT, code=code, detail=str(error)))
        except ValidationError as error:
            structlog.get_logger().exception("row-not-read")
            return Failed(failure=failure_of(error, self._claim.job.kind))
        self._input = self._given.file
        reads_upload = declaration_of(self._claim.job.kind).upload is not None
        for path in self._given.readable:
            self._store.files.check_file(path)
        if self._input is not None and not reads_upload:
            try:
                self._while_leased("verifying a file", partial(self._store.files.verified.digest, self._input))
            except DamagedResult as error:
                return Failed(failure=Failure(kind=FailureKind.INPUT, code=error.code, detail=str(error)))
        upload_bytes = self._input.stat().st_size if reads_upload and self._input is not None else None
        self._patience = Patience(self._claim.job.kind, self._settings, upload_bytes=upload_bytes)
        self._process.assign(
            Assignment(job=self._claim.job, given_json=self._given.model_dump_json(), output=self._output)
        )
        return None

    def _while_leased(self, doing: str, read: Callable[[], Read]) -> Read:
        """Read files in a thread, and keep the lease in the meantime; raise `LeaseLost` if it is lost."""
        with ThreadPoolExecutor(1) as pool:
            reading = pool.submit(disk_outage_reported(doing)(read))
            while not wait([reading], self._settings.progress_s).done:
                self._cancellation_came_in()
            return reading.result()

    def _check(self, answer: Succeeded) -> tuple[Contract, bytes | None]:
        """Return an attempt's result, and the digest of the file that it left, if it left one."""
        result, file = self._store.jobs.check_output(self._claim.job.kind, answer.result, self._output)
        if file is None:
            return result, None
        self._check_apart(file, answer)
        # With this process gone as well, nobody writes to the file any more.
        return result, compute_digest(file)

    def _check_apart(self, file: Path, answer: Succeeded) -> None:
        """Have another confined process read the file: on some damaged files the readers in C crash or loop."""
        limit_s = min(reading_limit_s(file.stat().st_size), self._settings.stall_s or math.inf)
        folder = self._store.files.make_attempt_folder(self._claim.job_id, self._claim.attempt)
        process = self._process_for_check()
        try:
            given_json = self._given.model_copy(update={"file": file}).model_dump_json()
            process.assign(Assignment(job=self._claim.job, given_json=given_json, output=folder, answer=answer.result))
            deadline = time.monotonic() + limit_s
            while (left_s := deadline - time.monotonic()) > 0 and not process.hung_up:
                for message in process.receive(left_s):
                    if isinstance(message, Failed) and message.failure.kind is FailureKind.PASSING:
                        raise StorageUnavailable(message.failure.detail)
                    if isinstance(message, Failed):
                        raise InvalidOutput(message.failure.detail)
                    if isinstance(message, Succeeded):
                        return
            how = "crashes its reader" if process.hung_up else f"keeps its reader busy for {duration(limit_s)}"
            raise InvalidOutput(f"the job left a {file.name} that {how}")
        finally:
            process.end(self._settings.kill_grace_s)
            self._store.files.remove(folder)

    def _process_for_check(self) -> AttemptProcess:
        """Return a process as soon as the system starts one: a result must not be computed again for want of it."""
        said = ""
        while True:
            try:
                return self._take_ready()
            except (AttemptNotStarted, OSError) as error:
                said = _say_once("check-put-off", error, said)
                if self._stop.wait(self._settings.housekeeping_s):
                    raise StorageUnavailable("the worker stopped before a result was checked") from error

    def _publish(self, result: Contract, sha256: bytes | None, peak_memory_bytes: int | None) -> None:
        """Publish as soon as the database answers: an outage must not make a job compute its result again."""
        said = ""
        while True:
            try:
                self._store.jobs.succeed(
                    self._claim, result, self._output, sha256=sha256, peak_memory_bytes=peak_memory_bytes
                )
            except StorageUnavailable as error:
                # Without its folder the result was published, and the row's commit failed: the job is run again.
                if not self._output.exists() or self._stop.is_set():
                    raise
                said = _say_once("end-put-off", error, said)
                self._stop.wait(self._settings.housekeeping_s)
                if self._cancellation_came_in():
                    raise
            else:
                return

    def _watch(self) -> Succeeded | Failed | JobState:
        """Wait for the answer, or for the state in which the job was ended without one."""
        while True:
            for message in self._process.receive(self._settings.progress_s):
                if isinstance(message, Succeeded | Failed):
                    if isinstance(message, Failed):
                        return message.model_copy(update={"failure": self._outage_behind(message.failure)})
                    if self._limits is None:
                        raise AttemptTalksNonsense("an answer from a process that has not begun")
                    too_much = self._overuse()  # since the last look
                    return message if too_much is None else Failed(failure=too_much)
                self._note(message)
            if self._process.hung_up:
                failure = died(self._process.end(self._settings.kill_grace_s), self._claim.job.kind)
                return Failed(failure=failure if failure.code in LIMITS_MET else self._outage() or failure)
            looking = time.monotonic() - self._last_look >= self._settings.progress_s
            if looking:
                self._last_look = time.monotonic()
            beyond = (self._overuse() if looking else None) or self._patience.end(
                processor_s_of(self._process.process_id)
            )
            if beyond is not None:
                structlog.get_logger().warning("attempt-ended-by-limit", reason=beyond.detail)
                self._process.end(self._settings.kill_grace_s)
                return Failed(failure=beyond if beyond.code in LIMITS_MET else self._outage() or beyond)
            if self._cancellation_came_in():
                self._process.end(self._settings.kill_grace_s)
                self._store.jobs.cancelled(self._claim)
                return JobState.CANCELLED
            if self._time_to_give_back() or (
                looking
                and self._claim.job.background
                and self._is_so(partial(self._store.jobs.is_in_the_way, self._claim))
            ):
                self._process.end(self._settings.kill_grace_s)
                return self._store.jobs.release(self._claim)

    def _note(self, message: AnyMessage) -> None:
        if isinstance(message, Begun) and self._limits is None:
            self._limits = message
            self._patience.moved()
        if isinstance(message, ProgressMade):
            self._progress = message.progress
            self._patience.heard(message.progress)
        if isinstance(message, Kept):
            self._patience.moved()
            self._keep(message)

    def _overuse(self) -> Failure | None:
        """Return the failure of an attempt that exceeds limits which the system does not enforce."""
        if self._limits is None:
            return None
        reserve_bytes = self._store.settings.disk_reserve_bytes
        with disk_outage_reported("an attempt"):
            return overuse(
                self._process.process_id, self._output, self._claim.job.kind, self._limits, reserve_bytes=reserve_bytes
            )

    def _keep(self, message: Kept) -> None:
        try:
            self._store.jobs.keep(self._claim, self._output, message.names)
        except (NotFound, PermissionError) as error:  # a folder of checkpoints that is closed to its owner
            raise AttemptTalksNonsense(str(error)) from error
        except (StorageFull, StorageUnavailable) as error:
            # The attempt continues; its next checkpoint is due soon.
            structlog.get_logger().warning("progress-not-kept", reason=str(error))

    def _outage_behind(self, failure: Failure) -> Failure:
        """Return the outage that caused an attempt's failure, or the failure itself.

        A refusal of the input counts as an outage only if the input file has gone.
        """
        gone = self._input is not None and not self._input.is_file()
        if failure.kind is FailureKind.INTERNAL or (failure.kind is FailureKind.INPUT and gone):
            return self._outage() or failure
        return failure

    def _outage(self) -> Failure | None:
        """Return the outage that may have caused a crash or a defect: HDF5, for example, crashes on a full disk."""
        try:
            self._store.check(reserve_bytes=min(BUFFER_BYTES, self._store.settings.disk_reserve_bytes))
            if self._input is not None:
                self._store.files.check_file(self._input)
        except (StorageFull, StorageUnavailable) as error:
            return failure_of(error, self._claim.job.kind)
        return None

    def _cancellation_came_in(self) -> bool:
        silent_s = time.monotonic() - self._last_beat
        if silent_s < (self._settings.heartbeat_s if self._progress is None else self._settings.progress_s):
            return False
        self._last_beat = time.monotonic()
        progress, self._progress = self._progress, None
        try:
            cancelled = self._store.jobs.heartbeat(self._claim, progress)
        except (StorageFull, StorageUnavailable) as error:
            # The lease outlives several heartbeats; the next one is due soon.
            self._missed = _say_once("heartbeat-missed", error, self._missed)
            # A disk without room for a heartbeat can still be read.
            return isinstance(error, StorageFull) and self._is_so(
                lambda: self._store.jobs.get(self._claim.job_id).cancel_requested
            )
        self._missed = ""
        return cancelled

    def _is_so(self, look: Callable[[], bool]) -> bool:
        """Return what a look at the rows finds; false if the database does not answer."""
        try:
            return look()
        except StorageUnavailable as error:
            structlog.get_logger().warning("look-put-off", reason=str(error))
            return False

    def _time_to_give_back(self) -> bool:
        if not self._stop.is_set():
            return False
        if self._give_back_at is None:
            self._give_back_at = time.monotonic() + self._settings.stop_grace_s
        return time.monotonic() >= self._give_back_at


def _say_once(event: str, error: Exception, said: str) -> str:
    """Log the reason for a delay, unless it is the last one logged; return the last reason logged."""
    if str(error) != said:
        structlog.get_logger().warning(event, reason=str(error))
    return str(error)


def _invalid_result(what: str) -> Failure:
    detail = f"{what}, which is a defect; see the worker's log"
    return Failure(kind=FailureKind.INTERNAL, code="invalid-result", detail=detail)
