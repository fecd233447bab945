"""The load of a line: what a service does while many jobs wait, by the length of the queue, workers and database.

    python benchmarks/load.py [--quick] [--parts log load] [--databases sqlite postgresql] [--workers 0 1 2 3 4]
        [--queued 10 100 1000 10000] [--results FOLDER]

`sawmill serve` runs as users start it, with an empty data folder, for each database and number of workers. The queue is
filled to a length with plans of a calibration, which are short jobs. Measured are finished jobs a second, by the
events; then, while the workers go on, asks a second by four clients over HTTP, the first and a deep page of
`GET /v1/jobs` (50 jobs), a claim in addition to the workers', and the proportional set size of the API and of all
other processes: `load.json` in `benchmarks/results`, from which the pages have their tables. `log` is the price of one
log of a line, which is sent, read and reconstructed: `log-price.json`, in two minutes. A run with `--quick`, or on one
database, only prints, unless `--results` names a folder.
"""

import argparse
import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

import httpx
from filled_line import Line
from job_price import name_of, processes, pss_mib
from line_day import ROWS, load_tables, log_tables
from log_price import FEW, FEW_ROWS, price_of_a_log
from measurement import RESULTS, Measurement, reference_s

from sawmill_command import demo_client
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import ReconstructionMethod

sys.path.append(str(Path(__file__).parents[1]))
from tests.faults.servers import Postgres

# Beyond what this program asks for.
NO_LIMITS = {
    "SAWMILL_MAX_QUEUED_JOBS": "1000000",
    "SAWMILL_RATE_LIMIT": "1000000/minute",
    "SAWMILL_CHANGE_RATE_LIMIT": "1000000/minute",
}

Figures = dict[str, Any]


@contextmanager
def serving(url: str | None, workers: int) -> Iterator[tuple[httpx.Client, Path]]:
    """Start a service on an empty data folder; yield a client and that folder."""
    with tempfile.TemporaryDirectory(prefix="sawmill-load-") as name:
        where = {} if url is None else {"SAWMILL_DATABASE_URL": url}
        with demo_client.running_service(Path(name), NO_LIMITS | where, workers=workers) as client:
            yield client, Path(name) / "data"


def measured_cells(
    url: str | None, database: str, workers: int, lengths: Sequence[int], jobs: int, asks: int
) -> Iterator[Figures]:
    """Measure one service with a growing queue."""
    with serving(url, workers) as (client, data):
        settings = StorageSettings(data_folder=data, database_url=url)
        with closing(Store(settings)) as store:
            line = Line(client, store)
            line.ask()
            for length in sorted(lengths):
                finished = line.finished_per_s(jobs, length) if workers else None
                line.fill(length)
                api_mib, worker_mib = memory_mib()
                yield {
                    "database": database,
                    "workers": workers,
                    "queued": length,
                    "finished_per_s": finished,
                    "accepted_per_s": line.accepted_per_s(asks),
                    "claim_ms": line.claim_ms(asks),
                    "first_page_ms": line.page_ms(asks, length, 0.0),
                    "deep_page_ms": line.page_ms(asks, length, 0.9),
                    "api_mib": api_mib,
                    "worker_mib": worker_mib,
                }


def memory_mib() -> tuple[float, float]:
    """Return the memory of the API, and of all other processes of the service together, MiB."""
    by_name: defaultdict[str, float] = defaultdict(float)
    for process_id in processes():
        with suppress(FileNotFoundError, ProcessLookupError):  # an attempt that has ended
            by_name[name_of(process_id)] += pss_mib(process_id)
    api_mib = by_name.pop("API", 0.0)
    return api_mib, sum(mib for name, mib in by_name.items() if "postgres" not in name)


def urls(stack: ExitStack, folder: Path) -> Callable[[], str]:
    """Start a PostgreSQL server with default settings; return a function that makes a new database on each call."""
    server = Postgres(folder / "postgresql")
    server.start()
    stack.callback(server.end, crash=False)
    numbers = count()
    return lambda: server.new_database(f"load-{next(numbers)}")


def print_cell(cell: Figures) -> None:
    """Print a line of the table."""
    finished = "" if cell["finished_per_s"] is None else f"{cell['finished_per_s']:.1f}"
    print(
        f"{cell['database']:10} {cell['workers']:7} {cell['queued']:7} {cell['accepted_per_s']:9.0f} {finished:>9} "
        f"{cell['claim_ms']:9.1f} {cell['first_page_ms']:9.1f} {cell['deep_page_ms']:9.1f} "
        f"{cell['api_mib']:8.0f} {cell['worker_mib']:8.0f}",
        flush=True,
    )


def main(arguments: list[str] | None = None, reference: Callable[[], float] = reference_s) -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--quick", action="store_true", help="seconds: one service, a queue of ten, a log of eight rows"
    )
    parser.add_argument("--parts", nargs="+", choices=("log", "load"), default=("log", "load"))
    parser.add_argument("--databases", nargs="+", choices=("sqlite", "postgresql"), default=("sqlite", "postgresql"))
    parser.add_argument("--workers", nargs="+", type=int, default=(0, 1, 2, 3, 4))
    parser.add_argument("--queued", nargs="+", type=int, default=(10, 100, 1000, 10_000))
    parser.add_argument("--jobs", type=int, default=40, help="whose ends are waited for, for each figure")
    parser.add_argument("--asks", type=int, default=20, help="repeats of each question")
    parser.add_argument("--results", type=Path, help="where results are written, also those of a part")
    chosen = parser.parse_args(arguments)
    if chosen.quick:
        chosen.databases, chosen.workers, chosen.queued, chosen.jobs, chosen.asks = ("sqlite",), (1,), (10,), 3, 2
    log = (8, (2, 4), ReconstructionMethod.FBP) if chosen.quick else (ROWS, FEW_ROWS, FEW)
    complete = not chosen.quick and len({*chosen.databases}) == 2
    folder = chosen.results or (RESULTS if complete else None)
    measurement = Measurement.begin(
        "worker/sawmill_platform",
        "worker/sawmill_store",
        "worker/sawmill_tomography/reconstruction",
        reference=reference,
    )
    price = price_of_a_log(*log) if "log" in chosen.parts else None
    cells: list[Figures] = []
    print("database   workers  queued accepted/s finished/s claim, ms page, ms  deep, ms  API MiB workers MiB")
    with ExitStack() as stack:
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-load-")))
        temporary.chmod(0o755)  # as root, the server of PostgreSQL runs as another user
        for database in chosen.databases if "load" in chosen.parts else ():
            new_url = urls(stack, temporary) if database == "postgresql" else lambda: None
            for workers in chosen.workers:
                for cell in measured_cells(new_url(), database, workers, chosen.queued, chosen.jobs, chosen.asks):
                    print_cell(cell)
                    cells.append(cell)
    results = {"load": {"cells": cells} | load_tables(cells)} if cells else {}
    if price is not None:
        stored = json.loads((RESULTS / "load.json").read_text())["values"]["cells"]
        known = cells if cells and 1 in chosen.workers else stored
        results["log-price"] = {"log": price} | log_tables(price, known, measurement.conditions["cores"])
    if folder is not None:
        measurement.write(results, folder)


if __name__ == "__main__":
    main()
