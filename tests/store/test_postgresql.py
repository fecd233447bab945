"""A PostgreSQL server that is paused, restarted, or refuses its user."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from urllib.parse import urlsplit

import psycopg
import pytest
from emptied_databases import EmptiedDatabases, own_server
from live_service import wait_until
from sqlalchemy import text
from structlog.testing import capture_logs

from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.errors import StorageMisconfigured, StorageUnavailable
from sawmill_platform.workers.program import open_store
from sawmill_store.store import Store

pytestmark = [pytest.mark.slow, pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)]


@pytest.fixture(scope="module")
def postgres():
    """A server that is stopped, which others must not notice."""
    with own_server() as server:
        yield server


@pytest.fixture(scope="module")
def databases(postgres, tmp_path_factory):
    return EmptiedDatabases(postgres, tmp_path_factory.mktemp("template"))


def assert_refused(store: Store) -> None:
    with pytest.raises(StorageUnavailable, match="does not answer"):
        store.check()


def check_until_it_answers(store: Store) -> None:
    def answers() -> bool:
        with suppress(StorageUnavailable):
            store.check()
            return True
        return False

    wait_until(answers)


def test_a_paused_server_is_given_up_and_waited_for_by_one_thread_alone(store, postgres):
    def refused_after_s(_):
        begun_s = time.monotonic()
        assert_refused(store)
        return time.monotonic() - begun_s

    store.check()
    with postgres.paused(), ThreadPoolExecutor(8) as threads:
        assert_refused(store)
        time.sleep(1.5)  # until one may ask again
        *at_once, asked = sorted(threads.map(refused_after_s, range(8)))
    assert max(at_once) < 2.0 < asked
    check_until_it_answers(store)


def test_a_statement_in_progress_is_given_up_when_the_server_is_paused(store, postgres):
    given_up = pytest.raises(StorageUnavailable, match="has not answered for 4 s")
    with given_up, store.database.read() as session, postgres.paused():
        session.connection().exec_driver_sql("SELECT 1")
    check_until_it_answers(store)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["restarted", "killed"])
def test_a_server_that_comes_back_is_used_again(store, postgres, how):
    store.check()
    postgres.stop(how)
    assert_refused(store)
    postgres.start()
    check_until_it_answers(store)


def test_a_row_that_somebody_has_locked_is_given_up_while_it_is_locked(store, scanner, database_url):
    with psycopg.connect(database_url) as other:
        other.execute("SELECT 1 FROM scanners FOR UPDATE")
        with pytest.raises(StorageUnavailable, match="lock timeout"):
            store.scanners.update(scanner.id, ScannerSpec(name="Line 3", constants=scanner.constants))
    with store.database.read() as session:
        limits = [session.scalar(text(f"SHOW {name}")) for name in ("lock_timeout", "statement_timeout")]
    assert limits == ["3s", "3500ms"]


def test_each_of_the_api_s_threads_has_a_connection(store):
    threads = threading.Barrier(40, timeout=60)

    def use(_):
        with store.database.read():
            threads.wait()

    with ThreadPoolExecutor(40) as pool:
        list(pool.map(use, range(40)))


def test_what_waiting_does_not_help_is_said_at_once(settings, postgres):
    address = f"127.0.0.1:{postgres.port}"
    for url, sentence in (
        (f"postgresql://postgres@{address}/nowhere", 'database "nowhere" does not exist'),
        (f"postgres://mill:secret@{address}/postgres", 'password authentication failed for user "mill"'),
        (f"postgresql://mill@{address}/postgres", "no password supplied"),
        (f"mysql://mill:secret@{address}/sawmill", "must begin with sqlite: or postgresql:, not 'mysql'"),
        ("secret", "is no URL of a database"),
    ):
        with pytest.raises(StorageMisconfigured, match=sentence) as refused:
            open_store(partial(Store.open, settings.model_copy(update={"database_url": url})), threading.Event())
        assert "secret" not in str(refused.value)


def test_a_password_is_read_from_a_file(settings, postgres, tmp_path):
    postgres.run("CREATE USER saw PASSWORD 'p@ss/w:rd' IN ROLE pg_read_all_data")
    file = tmp_path / "password"
    file.write_text("p@ss/w:rd\n")
    address = f"127.0.0.1:{postgres.port}/postgres"
    with closing(Store(with_password(settings, f"postgresql://saw@{address}", file))) as store:
        assert store.database_report().migration is None
    for url, content, sentence in (
        (f"postgresql://saw@{address}", "secret", 'password authentication failed for user "saw"'),
        (f"postgresql://saw@{address}", "\n", "holds no password"),
        (f"postgresql://saw:secret@{address}", "secret", "goes with a SAWMILL_DATABASE_URL without a password"),
        (None, "secret", "goes with a SAWMILL_DATABASE_URL without a password"),
        (f"postgresql://saw@{address}", None, "cannot be read"),
    ):
        file.unlink(missing_ok=True)
        if content is not None:
            file.write_text(content)
        with pytest.raises(StorageMisconfigured, match=sentence) as refused:
            open_store(partial(Store.open, with_password(settings, url, file)), threading.Event())
        assert "secret" not in str(refused.value)
    postgres.run("DROP USER saw")


def with_password(settings, url, file):
    return settings.model_copy(update={"database_url": url, "database_password_file": file})


def test_an_absent_server_is_awaited_until_it_is_there_or_this_process_ends(filled, database_url, postgres):
    assert urlsplit(database_url).port == postgres.port
    stop = threading.Event()
    postgres.stop()
    with ThreadPoolExecutor(2) as pool, capture_logs() as log:
        opening = partial(Store.open, filled)
        in_vain, patient = pool.submit(open_store, opening, stop), pool.submit(open_store, opening, threading.Event())
        wait_until(lambda: len(log) >= 2)
        assert {entry["event"] for entry in log} == {"database-awaited"}
        stop.set()
        assert in_vain.result(timeout=60) is None
        assert not patient.done()
        postgres.start()
        opened = patient.result(timeout=60)
    assert len(opened.phantoms.page().items) == 2
    opened.close()
