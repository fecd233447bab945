"""A line's day: what its logs mean for disk, network and processors.

The tables are made from the values that `benchmarks/load.py` measures.
"""

import sys
from collections.abc import Iterable, Sequence
from math import ceil, log2
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[1] / "docs/tools"))
from figures import rounded

LOGS, VIEWS, ROWS, CELLS, SAMPLE_BYTES = 2000, 20, 2500, 768, 2
SHIFT_H = 16.0  # two shifts
DISK_TB = 8.0
DAYS_KEPT = (1, 7, 14, 30)
MBIT, GB, TB = 1e6 / 8, 1e9, 1e12

# The machines of docs/do/sizing.md: lines, and logs a day of all of them.
MILLS = ((1, 500), (1, LOGS), (2, 2 * LOGS), (4, 4 * LOGS))
# Logs arrive unevenly, and calibrations come in between: more than the mean.
HEADROOM = 1.5
LEAST_CORES, CORES_A_WORKER, DISK_DAYS = 2, 4, 14
# A worker may give one job that much (`attempts/limits.py`); the system has its part as well.
JOB_GB, SYSTEM_GB = 2.2, 1.0

Figures = dict[str, Any]


def log_bytes() -> int:
    """Compute the size of the samples of one log, bytes."""
    return VIEWS * ROWS * CELLS * SAMPLE_BYTES


def day_bytes() -> int:
    """Compute the size of the samples of a day's logs, bytes."""
    return LOGS * log_bytes()


def hours_of(log: Figures) -> tuple[float, float, float]:
    """Compute processor hours for a day's logs: to read them, by `fbp`, and by the method for few views."""
    few_s = log["few_processor_s_once"] + ROWS * log["few_processor_s_a_slice"]
    read_h, fbp_h, few_h = (
        LOGS * each_s / 3600.0 for each_s in (log["read_processor_s"], log["fbp_processor_s"], few_s)
    )
    return read_h, fbp_h, few_h


def day_table(log: Figures) -> list[list[str]]:
    """Tabulate a day: a row each of the quantity, its computation and its amount."""
    shift_s = 3600.0 * SHIFT_H
    stored = log["upload_bytes"] + log["scan_bytes"] + log["volume_bytes"]
    read_h, fbp_h, few_h = hours_of(log)
    return [
        ["samples of a log", f"{VIEWS} views x {ROWS} rows x {CELLS} cells x {SAMPLE_BYTES} B", _mb(log_bytes())],
        ["samples of a day", f"{LOGS} logs x {_mb(log_bytes())}", f"{day_bytes() / GB:.0f} GB"],
        [
            "network, mean",
            f"{day_bytes() / GB:.0f} GB in {SHIFT_H:.0f} h",
            f"{day_bytes() / shift_s / MBIT:.0f} Mbit/s",
        ],
        ["a log comes every", f"{SHIFT_H:.0f} h / {LOGS}", f"{shift_s / LOGS:.0f} s"],
        [
            "disk for a log",
            " + ".join(
                f"{name} {_mb(log[key])}"
                for name, key in (
                    ("file", "upload_bytes"),
                    ("`scan.h5`", "scan_bytes"),
                    ("`volume.h5`", "volume_bytes"),
                )
            ),
            _mb(stored),
        ],
        ["disk for a day", f"{LOGS} x {_mb(stored)}", f"{LOGS * stored / TB:.2f} TB"],
        [
            "days on a disk",
            f"{DISK_TB:.0f} TB / {LOGS * stored / TB:.2f} TB",
            f"{DISK_TB * TB / (LOGS * stored):.0f}",
        ],
        ["reading, processor", f"{LOGS} x {log['read_processor_s']:.1f} s", f"{read_h:.1f} h"],
        ["`fbp`, processor", f"{LOGS} x {log['fbp_processor_s']:.1f} s", f"{fbp_h:.1f} h"],
        [
            f"`{log['few_method']}`, processor",
            f"{LOGS} x ({log['few_processor_s_once']:.1f} s + {ROWS} slices x {log['few_processor_s_a_slice']:.3f} s)",
            f"{few_h:.0f} h",
        ],
        [
            "cores for reading and `fbp`",
            f"({read_h:.1f} h + {fbp_h:.1f} h) / {SHIFT_H:.0f} h",
            f"{(read_h + fbp_h) / SHIFT_H:.2f}",
        ],
        [
            f"cores for reading and `{log['few_method']}`",
            f"({read_h:.1f} h + {few_h:.0f} h) / {SHIFT_H:.0f} h",
            f"{(read_h + few_h) / SHIFT_H:.0f}",
        ],
        ["jobs a day", f"{LOGS} read + {LOGS} reconstructed", f"{2 * LOGS}"],
        ["jobs a second, mean", f"{2 * LOGS} / {SHIFT_H:.0f} h", f"{2 * LOGS / shift_s:.2f}"],
    ]


def stay_table(log: Figures) -> list[list[str]]:
    """Tabulate the terabytes of a line's logs and volumes that stay for some days."""
    scans = LOGS * (log["upload_bytes"] + log["scan_bytes"]) / TB
    volumes = LOGS * log["volume_bytes"] / TB
    return [[str(days), *(f"{days * each:.1f} TB" for each in (scans, volumes, scans + volumes))] for days in DAYS_KEPT]


def sizing_table(log: Figures, rest_mib: float) -> list[list[str]]:
    """Tabulate the machine for some mills and two methods; `rest_mib` is what API and one worker hold at rest."""
    read_h, fbp_h, few_h = hours_of(log)
    scan_bytes = log["upload_bytes"] + log["scan_bytes"]
    rows = []
    for lines, logs in MILLS:
        for method, method_h in (("fbp", fbp_h), (log["few_method"], few_h)):
            busy_cores = (read_h + method_h) * logs / LOGS / SHIFT_H
            cores = max(LEAST_CORES, ceil(HEADROOM * busy_cores))
            memory_gb = SYSTEM_GB + rest_mib * 2**20 / GB + ceil(cores / CORES_A_WORKER) * JOB_GB
            scans, volumes = (DISK_DAYS * logs * each / TB for each in (scan_bytes, log["volume_bytes"]))
            memory = f"{2 ** ceil(log2(memory_gb))} GB"
            rows.append(
                [str(lines), str(logs), f"`{method}`", str(cores), memory, f"{scans:.1f} TB", f"{volumes:.1f} TB"]
            )
    return rows


def ends_table(log: Figures, cells: Sequence[Figures], cores: int) -> list[list[str]]:
    """Tabulate a day's needs of one machine, what the measured one has, and the number of lines that it serves."""
    read_h, fbp_h, few_h = hours_of(log)
    per_s = 2 * LOGS / (3600.0 * SHIFT_H)
    network = day_bytes() / (3600.0 * SHIFT_H) / MBIT
    working = [cell for cell in cells if cell["finished_per_s"] is not None]
    needs = [
        ("a network of 1 Gbit/s", network, 1000.0, "Mbit/s"),
        ("accepting, the slowest measured", per_s, min(cell["accepted_per_s"] for cell in cells), "jobs/s"),
        (
            "the life of a job, the slowest measured",
            per_s,
            min(cell["finished_per_s"] for cell in working),
            "jobs/s",
        ),
        ("processors, reading and `fbp`", (read_h + fbp_h) / SHIFT_H, cores, "cores"),
        (
            f"processors, reading and `{log['few_method']}`",
            (read_h + few_h) / SHIFT_H,
            cores,
            "cores",
        ),
    ]
    return [
        [what, f"{need:.2f} {unit}", f"{has:.1f} {unit}", rounded(has / need, "2")] for what, need, has, unit in needs
    ]


def load_table(cells: Sequence[Figures], database: str) -> list[list[str]]:
    """Tabulate the measurements on one database, a row for each number of workers and each length of the queue."""
    return [
        [
            str(cell["workers"]),
            _thousands(cell["queued"]),
            f"{cell['accepted_per_s']:.0f}",
            "" if cell["finished_per_s"] is None else f"{cell['finished_per_s']:.1f}",
            *(f"{cell[name]:.0f}" for name in ("claim_ms", "first_page_ms", "deep_page_ms")),
            *(f"{cell[name]:.0f}" for name in ("api_mib", "worker_mib")),
        ]
        for cell in cells
        if cell["database"] == database
    ]


def log_tables(log: Figures, cells: Sequence[Figures], cores: int) -> Figures:
    """Derive what a day of such logs needs, by the names that the pages' marks have.

    `cells` are what the load of a line was measured to be, for the memory at rest and the jobs a second.
    """
    rest_mib = max(cell["api_mib"] + cell["worker_mib"] for cell in cells if cell["workers"] == 1)
    sizing = ["lines", "logs a day", "method", "cores", "memory", "disk: 14 days of scans", "and of all volumes"]
    return {
        "day": _markdown(["what", "computed", "amount"], day_table(log)),
        "sizing": _markdown(sizing, sizing_table(log, rest_mib)),
        "stay": _markdown(["days", "scans", "volumes of all of them", "both"], stay_table(log)),
        "ends": _markdown(["what", "a line needs", "this machine has", "lines"], ends_table(log, cells, cores)),
    }


def load_tables(cells: Sequence[Figures]) -> Figures:
    """Derive the tables of both databases and the ratios, by the names that the pages' marks have."""
    heads = ["workers", "queued", "accepted/s", "finished/s", "claim, ms", "first page, ms", "deep page, ms"]
    heads += ["API, MiB", "workers, MiB"]
    made: Figures = {f"{name}_growth": _growth(cells, f"{name}_ms") for name in ("claim", "first_page")}
    for database in dict.fromkeys(cell["database"] for cell in cells):
        made[database] = _markdown(heads, load_table(cells, database), numbers=True)
    return made


def _markdown(heads: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: bool = False) -> str:
    line = "|".join("--:" if numbers else "---" for _ in heads)
    return "\n".join([f"| {' | '.join(heads)} |", f"|{line}|", *(f"| {' | '.join(row)} |" for row in rows)])


def _growth(cells: Sequence[Figures], name: str) -> float:
    """Compute by what factor a time grows from the shortest queue to the longest, at most."""
    services = {(cell["database"], cell["workers"]) for cell in cells}
    lengths = [
        sorted((cell["queued"], cell[name]) for cell in cells if (cell["database"], cell["workers"]) == service)
        for service in services
    ]
    return max((times[-1][1] / times[0][1] for times in lengths), default=1.0)


def _mb(size_bytes: float) -> str:
    return f"{size_bytes / 1e6:.1f} MB"


def _thousands(number: int) -> str:
    return f"{number:,}".replace(",", " ")
