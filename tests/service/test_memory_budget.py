"""The memory of pictures and arrays: counted with all copies, shared by callers in turn, given back."""

import asyncio
import ctypes
import gc
from collections.abc import Coroutine, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from asgi import scope_of
from live_service import Offline, serving
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_service.app import create_app
from sawmill_service.http.responses.drawn import Drawn, MemoryBudget, Reservation, return_freed_memory
from sawmill_vocabulary import DataKind, ReconstructionMethod

MIB = 2**20


async def forever() -> None:
    await asyncio.Event().wait()


class Noted(MemoryBudget):
    """A budget that notes what was reserved, and the most that one caller and all callers held."""

    def __init__(self, most_bytes: int) -> None:
        super().__init__(most_bytes)
        self.reserved_bytes = list[int]()
        self.granted, self.largest_share, self.largest_sum = list[str](), 0, 0

    def reserved(self, caller, size_bytes, until_gone):
        self.reserved_bytes.append(size_bytes)
        return super().reserved(caller, size_bytes, until_gone)

    def _remove(self, reservation: Reservation) -> None:
        super()._remove(reservation)
        self.granted.append(reservation.caller)

    def shrink(self, reservation: Reservation, size_bytes: int) -> None:
        self.largest_share = max([self.largest_share, *self._held.values()])
        self.largest_sum = max(self.largest_sum, self._held.total())
        super().shrink(reservation, size_bytes)

    @property
    def is_idle(self) -> bool:
        return not self._held and not self._waiting


def test_callers_take_turns_and_nobody_has_more_than_half():
    async def all_answered(asked: list[tuple[str, int]]) -> Noted:
        budget = Noted(80)

        async def answer(caller: str, size_bytes: int) -> None:
            async with budget.reserved(caller, size_bytes, forever):
                await asyncio.sleep(0)

        await asyncio.gather(*(answer(*each) for each in asked))
        return budget

    for asked, order in (
        # The first four fill half of the budget; the caller who comes last has the other half at once.
        ([("a", 10)] * 8 + [("b", 10)], "aaaabaaaa"),
        ([("a", 20)] * 3 + [("b", 20)] * 3 + [("c", 20)] * 2, "aabbacbc"),
        # More than half: alone of its caller; more than all counts as all.
        ([("a", 60), ("a", 10), ("b", 10)], "aba"),
        ([("a", 200), ("b", 10)], "ab"),
        # A small answer does not overtake a large one of another caller.
        ([("a", 40), ("b", 20), ("c", 30), ("d", 10)], "abcd"),
    ):
        budget = asyncio.run(all_answered(asked))
        assert "".join(budget.granted) == order
        assert budget.is_idle
        assert budget.largest_sum <= 80
        assert budget.largest_share <= 40 or max(size for _, size in asked) > 40


def test_a_client_that_goes_leaves_the_queue_and_what_is_sent_is_given_back():
    async def waited() -> None:
        budget, gone = Noted(80), asyncio.Event()
        async with AsyncExitStack() as held:
            first = await held.enter_async_context(budget.reserved("a", 40, forever))
            leaver = asyncio.create_task(held.enter_async_context(budget.reserved("a", 40, gone.wait)))
            last = asyncio.create_task(held.enter_async_context(budget.reserved("a", 10, forever)))
            await asyncio.sleep(0)
            assert not leaver.done()
            gone.set()
            with pytest.raises(ClientDisconnect):
                await leaver
            assert not last.done()
            budget.shrink(first, 30)  # drawn, and smaller than while it was drawn
            assert (await last).size_bytes == 10
        assert budget.is_idle

    asyncio.run(waited())


def answering(app, key: str, make) -> tuple[Drawn, dict]:
    """An answer of a caller who comes from an address of the same name, and the scope of its request."""
    scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "app": app, "client": (key, 1)}
    return Drawn(Request(scope), 20 * MIB, make), scope


async def _receive() -> dict:
    return await asyncio.Future()


def test_an_answer_that_nobody_reads_gives_its_memory_back(store, settings):
    app = create_app(settings.model_copy(update={"client_silence_s": 0.01}), store, print)
    app.state.memory_budget = Noted(64 * MIB)

    async def send(message: dict) -> None:
        if message["type"] == "http.response.body":
            await forever()

    answer, scope = answering(app, "192.0.2.1", lambda: Response(b"x"))
    with pytest.raises(ClientDisconnect):
        asyncio.run(answer(scope, _receive, send))
    assert app.state.memory_budget.is_idle


COLORED, SMALL = "?color_map=viridis", "max_size=512"
SLICES = (
    *("png", f"png{COLORED}", "png?bits=16", "png?show=deviation", "jpg", f"jpg{COLORED}", f"jpg{COLORED}&{SMALL}"),
    *("npy", f"npy?{SMALL}"),
)
PATHS = [
    *(f"v1/reconstructions/{{0}}/slices/0.{each}" for each in SLICES),
    *(f"v1/reconstructions/{{0}}/{each}" for each in ("mosaic.png?color_map=magma", "thumbnail.png", "volume.nrrd")),
    *(f"v1/reconstructions/{{1}}/side.{each}" for each in ("png?color_map=magma", "npy")),
    *(f"v1/scans/{{2}}/{each}" for each in ("preview", "thumbnail.png")),
]
# By matplotlib, which takes seconds.
FIGURES = [
    "v1/reconstructions/{0}/alpha-curve.png",
    "v1/calibrations/example/report.png?language={3}",
    "calibrations/example/report?language={3}",
]


@pytest.mark.usefixtures("_as_served")
@pytest.mark.parametrize(
    ("side", "paths"),
    [(1024, PATHS), pytest.param(4096, PATHS + FIGURES, marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])],
)
def test_no_answer_takes_more_memory_than_it_reserves(seeded, store, settings, worker, side, paths):
    """The peak of this process's resident memory, over what it has before each answer; noise packs badly."""
    noise = np.random.default_rng(3).normal(1.5, 0.3, (2, side, side)).astype(np.float32)
    scan = ScanSpec(scanner_id="example", data=DataKind.LINE_INTEGRALS)
    store.scans.accept(scan, store.files.receive([b"original"], max_bytes=100), scan_id="large")
    worker.finish_scan(noise[0][:, np.newaxis])
    asked = ReconstructionRequest(scan_id="example", method=ReconstructionMethod.TIKHONOV)
    store.reconstructions.accept(asked, identifier="large")
    worker.finish_sparse_reconstruction(noise)
    store.reconstructions.accept(asked, identifier="high")
    worker.finish_reconstruction(np.stack([noise[0], noise[1]], axis=1))
    for path in paths:  # imports and loads what drawing needs
        asyncio.run(status_of(seeded.app, path.format("example-sparse", "example", "example", "en")))
    app = create_app(settings, store, print)
    app.state.memory_budget = budget = Noted(256 * MIB)
    peaks = [peak_of(status_of(app, path.format("large", "high", "large", "fi"))) for path in paths]
    found = dict(zip(paths, zip(peaks, budget.reserved_bytes, strict=True), strict=True))
    assert {path: both for path, both in found.items() if both[0] > both[1]} == {}
    # Memory that the process had before may serve an answer, but not all of them: else no peak was measured.
    assert max(peak for path, (peak, _) in found.items() if "slices" in path) >= 4 * side**2


@pytest.fixture
def _as_served() -> Iterator[None]:
    """This process's memory is managed as that of `sawmill serve`, and afterwards as usual."""
    return_freed_memory()
    yield
    ctypes.CDLL(None).mallopt(-3, 2**25)


def peak_of(asked: Coroutine[Any, Any, int]) -> int:
    """Bytes of resident memory that a request takes for a while."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # the peak is what there is
    before = most_resident_bytes()
    assert asyncio.run(asked) == 200
    return most_resident_bytes() - before


def most_resident_bytes(process: str | int = "self") -> int:
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))


async def status_of(app, path: str) -> int:
    """Send a request, and forget the answer's bytes as they come."""
    statuses = list[int]()

    async def send(message: dict) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    await app(scope_of(f"/{path}"), _receive, send)
    return statuses[0]


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_forty_large_slices_fit_into_1_gb_and_keep_nobody_waiting(seeded, store, worker, tmp_path):  # noqa: ARG001
    """Forty of 4096 x 4096 pixels at once for one key, and meanwhile one for another; `seeded` makes the scan."""
    noise = np.random.default_rng(3).normal(1.5, 0.3, (1, 4096, 4096)).astype(np.float32)
    asked = ReconstructionRequest(scan_id="example", method=ReconstructionMethod.FBP)
    store.reconstructions.accept(asked, identifier="large")
    worker.finish_reconstruction(noise)
    many, other = (store.keys.create(KeyRequest(name=name, scope=Scope.READ)).secret for name in ("many", "other"))
    store.close()
    statuses, answered = list[int](), list[str]()

    async def ask(client: httpx.AsyncClient, key: str, window_low: float) -> None:
        path = f"/v1/reconstructions/large/slices/0.png?window_low={window_low}"  # so that none is kept
        statuses.append((await client.get(path, headers={"Authorization": f"Bearer {key}"})).status_code)
        answered.append(key)

    async def all_answered(address: str) -> None:
        limits, timeout = httpx.Limits(max_connections=None), httpx.Timeout(1800.0)
        async with httpx.AsyncClient(base_url=address, timeout=timeout, trust_env=False, limits=limits) as client:
            forty = [asyncio.create_task(ask(client, many, -number)) for number in range(40)]
            await asyncio.sleep(1.0)  # so that they are there before the other
            await asyncio.gather(*forty, ask(client, other, -0.5))

    with serving(tmp_path, Offline(tmp_path).variables, "--workers", "0") as service:
        asyncio.run(all_answered(str(service.client.base_url)))
        assert most_resident_bytes(service.process_id) < 10**9
    assert statuses == [200] * 41
    assert answered.index(other) < 10
