"""Checks of the database, the workers, the clocks, webhooks and Redis."""

from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sawmill_command.doctor.machine import DoctorFinding, State, bad, good, watch
from sawmill_platform.backups.taking import newest_backup
from sawmill_platform.contracts.webhooks import Webhook, WebhookState
from sawmill_platform.errors import FolderUnavailable, StorageError, StorageFull, StorageMisconfigured
from sawmill_platform.files.folder_identity import refuse_used
from sawmill_platform.job_service_store import DatabaseReport
from sawmill_platform.settings import StorageSettings
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_platform.workers.housekeeping import TOLERABLE_S
from sawmill_service.pages.system.system_parts import SEEN
from sawmill_service.routes.health import Readiness, health_of
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.destinations import SETTING
from sawmill_store.store import Store

_SLOW_S = 0.5
_NAMED = 3  # number of lost files that a finding names
_RESTORE = "stop the service, move the data folder away, and restore the last backup: sawmill restore BACKUP"
# One day more than a week, for weekly backups.
_OLD = timedelta(days=8)
_TAKE = "take one to another disk, each night: sawmill backup FOLDER"
_MOUNT = "mount the folder that the service used before, for writing, or give it with --data or SAWMILL_DATA_FOLDER"
_NO_KEY = "the service can be reached from other machines by its settings, and there is no key: it would not start"
_MAKE_A_KEY = "make one with sawmill key create --name NAME --scope admin, or set SAWMILL_TOKEN"


def database(storage: StorageSettings, settings: ServiceSettings) -> Iterator[DoctorFinding]:
    """Check the database, and all that depends on it if the database answers and is up to date."""
    try:
        with closing(Store(storage)) as store:
            report = store.database_report()
            if report.migration is None:
                refuse_used(store.files.folder)
            yield _migration(report)
            if report.migration == report.newest_migration:
                damaged = store.damage()
                whole = good("tables", "whole, and of this version")
                damage = bad("tables", f"the database's file is damaged: {damaged[0]}", _RESTORE) if damaged else whole
                yield damage
                folder = _folder(store)
                yield folder
                if State.BAD in {damage.state, folder.state}:
                    return
                if settings.may_be_reached and settings.token is None and not store.keys.any_good():
                    yield bad("keys", _NO_KEY, _MAKE_A_KEY)
                yield _files(store)
                yield _workers(store)
                yield _clock(store)
                yield from webhooks(store.webhooks, settings.webhook_destinations)
                since = store.retention.get().days_wait_since
                if since is not None:
                    sentence = (
                        f"days were counted last at {since.isoformat(timespec='seconds')}: nothing goes by its age"
                    )
                    yield watch("retention", sentence, "check the clock, then confirm the rules on the page /retention")
    except StorageMisconfigured as error:
        yield bad("database", str(error), _RESTORE if storage.is_one_file else "mend SAWMILL_DATABASE_URL")
    except StorageError as error:
        yield bad("database", str(error), "start its server, or end the process that holds it")


def files_without_database(folder: Path) -> Iterator[DoctorFinding]:
    """Report a data folder that is in use although its SQLite file would be new."""
    try:
        refuse_used(folder)
    except StorageMisconfigured as error:
        yield bad("database", str(error), _RESTORE)


def backup(folder: Path) -> DoctorFinding:
    """Report the age of the newest backup; its files are not checked, because the backup's disk may be away."""
    newest = newest_backup(folder)
    if newest is None:
        return watch("backup", "none was taken of this data folder", _TAKE)
    age = datetime.now(UTC) - newest.taken_at
    sentence = f"the newest is {age / timedelta(days=1):.1f} days old: {newest.path}"
    if newest.lacking:
        sentence += f", and lacks {newest.lacking} files that rows name"
        return bad("backup", sentence, "take one by hand, which names them: sawmill backup FOLDER")
    return watch("backup", sentence, _TAKE) if age > _OLD else good("backup", sentence)


def broker(url: str | None) -> DoctorFinding:
    """Check Redis, if it is used."""
    if url is None:
        return good("Redis", "not used: workers look into the database")
    from sawmill_platform.workers.broker_report import report_of  # noqa: PLC0415 - of the extra `celery`

    report = report_of(url)
    if report.refused:
        sentence = f"{report.host} refuses the user or the password: jobs of Celery workers do not begin"
        cure = (
            "write Redis's password into SAWMILL_BROKER_URL of the service and of each worker: redis://:PASSWORD@HOST"
        )
        return bad("Redis", sentence, cure)
    if report.answered_s is None:
        sentence = f"{report.host} does not answer: jobs of Celery workers begin only when it does"
        return bad("Redis", sentence, "start it, or mend SAWMILL_BROKER_URL")
    return good("Redis", f"{report.host} answers in {1000 * report.answered_s:.1f} ms")


def _migration(report: DatabaseReport) -> DoctorFinding:
    has, needs = report.migration, report.newest_migration
    if report.unreadable is not None:
        cure = "start the version that wrote them, or restore a backup of a release: sawmill restore BACKUP"
        return bad("database", report.unreadable, cure)
    if has != needs:
        sentence = f"{report.system} has tables of version {has or 'none'}, and this version needs {needs}"
        cure = "take a backup (sawmill backup FOLDER): the next start of sawmill serve brings them up to date"
        return watch("database", sentence, cure)
    sentence = f"{report.system} answers in {1000 * report.answered_s:.1f} ms, {report.size_bytes / 1e6:.1f} MB"
    if report.answered_s > _SLOW_S:
        return watch("database", sentence, "look at the load of its machine and its disk")
    return good("database", sentence)


def _files(store: Store) -> DoctorFinding:
    try:
        lost = store.lost_files()
    except OSError as error:
        sentence = f"the data folder cannot be read: {error}"
        return bad("files", sentence, "look for errors of its disk in the system's log (dmesg)")
    if not lost:
        return good("files", "every file that rows name is there")
    named = ", ".join(lost[:_NAMED]) + (", ..." if len(lost) > _NAMED else "")
    sentence = f"{len(lost)} files that rows name are missing in the data folder: {named}"
    return bad("files", sentence, f"{_RESTORE}; or delete the scans and results whose files are missing")


def _folder(store: Store) -> DoctorFinding:
    """Check that the data folder is the folder in the database, and that files can be written."""
    try:
        store.check(reserve_bytes=0)
    except FolderUnavailable as error:
        return bad("data folder", str(error), _MOUNT)
    except StorageFull:
        pass  # the finding on the disk reports it
    return good("data folder", "the one that the database knows")


def _workers(store: Store) -> DoctorFinding:
    health = health_of(store)
    if health.state is Readiness.WITHOUT_WORKER:
        return bad("workers", health.detail.rpartition(": ")[0], "run sawmill serve or sawmill worker")
    lately = store.events.workers_since(datetime.now(UTC) - SEEN)
    return good("workers", f"{len(lately)} took a job within {SEEN.seconds // 60} minutes; none is awaited")


def _clock(store: Store) -> DoctorFinding:
    off_s = store.clock_off_s()
    sentence = f"this machine's clock is {off_s:+.1f} s from the service's time"
    if abs(off_s) > TOLERABLE_S:
        return watch("clock", sentence, "set the clock by NTP (timedatectl set-ntp true)")
    return good("clock", sentence)


def webhooks(store: WebhookStore, allowed: list[str]) -> Iterator[DoctorFinding]:
    """Yield a finding for each webhook that does not send, or one finding if all webhooks work."""
    every = store.all()
    enabled = [webhook for webhook in every if webhook.enabled]
    if enabled and not allowed:
        sentence = f"{len(enabled)} are enabled, and {SETTING} is empty: nothing is sent anywhere"
        yield bad("webhooks", sentence, f"set {SETTING}, or disable them (/system/webhooks)")
        return
    failing = [webhook for webhook in every if webhook.state in {WebhookState.RETRYING, WebhookState.PAUSED}]
    yield from map(_failing, failing)
    if not failing:
        yield good("webhooks", f"{len(enabled)} of {len(every)} are enabled, and none fails")


def _failing(webhook: Webhook) -> DoctorFinding:
    sentence = f"{(webhook.description or webhook.url)!r} fails: {webhook.last_failure}; {webhook.waiting} events wait"
    if webhook.state is WebhookState.PAUSED:
        cure = "mend the receiver, send a test, and enable the webhook again (/system/webhooks)"
        return bad("webhooks", f"{sentence}, and the service has given up", cure)
    return watch("webhooks", sentence, "mend the receiver: it is tried again by itself")
