"""Effect of one large upload on other requests, and the memory that it takes.

    python benchmarks/big_upload.py [--gb 4] [--part-mb 64] [--only raw parts]

A service with a separate folder and two processes: one sends random bytes over loopback as fast as they are taken,
as one body or in parts (`/v1/uploads`); the other asks for the scanners, `PAUSE_S` after each answer. Prints, for each
way and for the same time without an upload, how long these other requests take, and the resident memory of the
service's own process (its workers read no other upload). The folder needs twice the size on its disk.
"""

import argparse
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx

from sawmill_command import demo_client, examples

PAUSE_S = 0.02
QUIET_S = 20.0
BLOCK_BYTES = 2**20
LONGEST_S = 600.0


def memory_mib(process_id: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def blocks(size: int) -> Iterator[bytes]:
    """Yield random bytes of this total size; each block is the same, which nothing checks."""
    block = os.urandom(BLOCK_BYTES)
    for begin in range(0, size, BLOCK_BYTES):
        yield block[: size - begin]


def send_raw(client: httpx.Client, scanner_id: str, size: int, _part: int) -> None:
    """Send the bytes as the body of a scan, which a worker then finds unreadable."""
    query = {"scanner_id": scanner_id, "data": "counts"}
    client.post("/v1/scans", params=query, content=blocks(size)).raise_for_status()


def send_parts(client: httpx.Client, _scanner_id: str, size: int, part: int) -> None:
    """Send the bytes as a resumable upload, up to its last byte and the digest of the whole."""
    path = f"/v1/uploads/{demo_client.post(client, '/v1/uploads', json={'size_bytes': size})['id']}"
    for begin in range(0, size, part):
        content = blocks(min(part, size - begin))
        client.patch(path, content=content, headers={"Upload-Offset": str(begin)}).raise_for_status()
    client.delete(path).raise_for_status()


WAYS = {"raw": send_raw, "parts": send_parts}


def send(way: str, address: str, scanner_id: str, size: int, part: int) -> None:
    """Send the bytes; runs in a separate process."""
    with httpx.Client(base_url=address, timeout=LONGEST_S, trust_env=False) as client:
        WAYS[way](client, scanner_id, size, part)


def measure(name: str, client: httpx.Client, process_id: int, goes_on: Callable[[], bool]) -> float:
    """Print one line of the table; gives the time that it took."""
    began, times, peak_mib = time.monotonic(), list[float](), memory_mib(process_id)
    while goes_on():
        asked = time.monotonic()
        client.get("/v1/scanners").raise_for_status()
        times.append(1e3 * (time.monotonic() - asked))
        peak_mib = max(peak_mib, memory_mib(process_id))
        time.sleep(PAUSE_S)
    took_s = time.monotonic() - began
    times.sort()
    p50, p99 = (times[int(share * len(times))] for share in (0.5, 0.99))
    print(
        f"{name:<9} {took_s:7.1f} s {len(times):6d} {p50:8.1f} ms {p99:8.1f} ms {times[-1]:8.1f} ms"
        f" {peak_mib:8.0f} MiB {os.getloadavg()[0]:6.1f}",
        flush=True,
    )
    return took_s


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gb", type=float, default=4.0, help="size of the upload, in 10^9 bytes")
    parser.add_argument("--part-mb", type=float, default=64.0, help="size of a part, in 10^6 bytes")
    parser.add_argument("--only", nargs="+", choices=list(WAYS), default=list(WAYS))
    chosen = parser.parse_args()
    size, part = int(chosen.gb * 1e9), int(chosen.part_mb * 1e6)
    with (
        tempfile.TemporaryDirectory(prefix="sawmill-big-upload-") as name,
        demo_client.running_service(Path(name)) as client,
    ):
        spec = {"name": "line", "constants": vars(examples.SCANNER)}
        scanner = demo_client.post(client, "/v1/scanners", json=spec)
        (process_id,) = map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())
        print("upload       takes  others     median       99th pc.      longest   peak memory   load")
        quiet_until = time.monotonic() + QUIET_S
        measure("none", client, process_id, lambda: time.monotonic() < quiet_until)
        for way in chosen.only:
            sender = multiprocessing.Process(target=send, args=(way, str(client.base_url), scanner["id"], size, part))
            sender.start()
            took_s = measure(way, client, process_id, sender.is_alive)
            sender.join()
            assert sender.exitcode == 0, f"{way}: the sender ended with {sender.exitcode}"
            print(f"          {size / took_s / 1e6:.0f} MB/s", flush=True)


if __name__ == "__main__":
    main()
