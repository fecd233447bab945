"""A kind of job that adds numbers, on the platform alone: `dummy_kind.py FOLDER`; as an attempt it has no argument."""

# ruff: noqa: ARG001, T201 - a program, whose functions have all arguments that the job store gives
import json
import sys
import threading
from pathlib import Path

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from sawmill_platform.attempts.attempt import main as attempt_main
from sawmill_platform.attempts.protocol import Attempt, Needs
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.backups.restoring import restore
from sawmill_platform.backups.taking import take_backup
from sawmill_platform.contracts.attempts import AttemptInput, JobFailure
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import FailureKind, JobKind
from sawmill_platform.contracts.kind_declarations import KindDeclaration, declare
from sawmill_platform.database.tables import Base, Json, Resource
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.jobs.queue_limits import queue_job
from sawmill_platform.jobs.tallies import Recorded, Subjects
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.program import attempt_starter
from sawmill_platform.workers.settings import ExecutionSettings

MIGRATION = """
from alembic import op
from sawmill_platform.database.tables import Base
revision = "0001"
down_revision = None
def upgrade():
    Base.metadata.create_all(op.get_bind())
"""
ENVIRONMENT = """
from alembic import context
context.configure(connection=context.config.attributes["connection"])
context.run_migrations()
"""


class Sum(Contract):
    """The answer."""

    total: int


class Numbers(AttemptInput):
    numbers: list[int]


ADD = JobKind.register("add", "sums")
DECLARATION = KindDeclaration(
    kind=ADD, noun="sum", label="Add", result=Sum, processor_s=60, time_limit_s=60, stall_s=60, lighter="give less"
)


class SumRow(Resource):
    __tablename__ = "sums"

    numbers: Mapped[Json]
    answer: Mapped[Json | None]
    reason: Mapped[str | None] = mapped_column(String(200))


def handed_over(session, files, job):
    return Numbers(kept=files.kept_with(job.id), numbers=session.get(SumRow, job.subject_id).numbers["of"])


def record_success(session, kind, subject_id, result, now):
    session.get(SumRow, subject_id).answer = result.model_dump(mode="json")
    return Recorded()


def record_end_without_result(session, kind, subject_id, reason, now):
    session.get(SumRow, subject_id).reason = reason


def output_file(kind, folder):
    assert not list(folder.iterdir())


def read_apart(path):
    raise AssertionError("no job leaves a file")


SUMS = Subjects((), handed_over, record_success, record_end_without_result, output_file, read_apart)


def warm_up():
    """Nothing is slow."""


def attempt(job, given_json, output, report, announce):
    return Attempt(job, Numbers.model_validate_json(given_json), output, report, announce)


def needs_of(_):
    return Needs(0, 0)


def make_ready(_):
    """Nothing is compiled."""


def check(attempt, answer):
    raise AssertionError("no job leaves a file")


def run(attempt):
    if not attempt.given.numbers:
        raise JobFailure(FailureKind.INPUT, "no-numbers", "there is nothing to add")
    return {"total": sum(attempt.given.numbers)}


def supervise(folder: Path) -> None:
    """Queue and run two jobs, restore a backup of them elsewhere, and print what became of them."""
    migrations = folder / "migrations"
    (migrations / "versions").mkdir(parents=True)
    (migrations / "versions" / "0001_first.py").write_text(MIGRATION)
    (migrations / "env.py").write_text(ENVIRONMENT)
    Base.metadata.info["migrations"] = migrations
    files = FileStore(folder / "data")
    settings, copy = (StorageSettings(data_folder=folder / name, database_url=None) for name in ("data", "copy"))
    store = JobServiceStore(settings, files, SUMS)
    store.prepare()
    for name, numbers in (("good", [1, 2, 3]), ("empty", [])):
        with store.database.write() as session:
            session.add(SumRow(id=name, created_at=store.now(), numbers={"of": numbers}))
            queue_job(session, ADD, name, store.now(), short=True, group_id=None)
    execution = ExecutionSettings(broker_url=None)
    attempts = attempt_starter([sys.executable, __file__], store, execution)
    runner = Runner(store, execution, threading.Event(), attempts=attempts)
    states = [runner.run_next(), runner.run_next()]
    runner.close()
    events = [event.type for event in store.events.following(0)]
    store.close()
    (folder / "backups").mkdir()
    taken = take_backup(settings, folder / "backups", lambda _: None, named=SUMS.named_folders)
    restore(taken.path, copy, lambda _: None)
    store = JobServiceStore(copy, FileStore(copy.data_folder), SUMS)
    store.prepare(may_begin=False)
    with store.database.read() as session:
        answers = {row.id: [row.answer, row.reason] for row in session.query(SumRow)}
    assert [event.type for event in store.events.following(0)] == [*events, "restored"]
    assert store.leftovers(grace_s=1.0).remove_some() == store.lost_files() == []
    ours = sorted({name.split(".")[0] for name in sys.modules if name.startswith("sawmill_")})
    print(json.dumps({"states": states, "answers": answers, "events": events, "packages": ours}))
    store.close()


if __name__ == "__main__":
    declare((DECLARATION,))
    if len(sys.argv) > 1:
        supervise(Path(sys.argv[1]))
    else:
        attempt_main(sys.modules["__main__"])
