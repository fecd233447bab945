"""A tour of every page and state in Firefox: scripts run, nothing scrolls sideways, Today follows the service."""

import asyncio

import mill_states
import pytest
from firefox import MISSING, PROGRAM, Firefox, firefox
from missing_parts import skip_without

from sawmill_contracts.drifts import DriftRequest

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("seeded")]
SIDEWAYS = "document.documentElement.scrollWidth > document.documentElement.clientWidth + 1"
HEADLINE = "document.querySelector('h1').textContent"


async def tour(tab: Firefox, address: str, paths: dict[str, str], language: str) -> list[str]:
    """What is wrong with any page in a language."""
    found: list[str] = []
    await tab.go(f"{address}/look?language={language}&next=/login")
    for name, path in paths.items():
        await tab.go(address + path)
        for width in (390, 800, 1280):
            await tab.resize(width, 844)
            if await tab.evaluate(SIDEWAYS):
                found.append(f"{name} scrolls sideways at {width} px in {language}")
    return found


def test_every_state_works_in_firefox(serve, store, worker, tmp_path):
    if PROGRAM is None:
        skip_without(MISSING)

    async def walk(address: str) -> None:
        async with firefox(tmp_path) as tab:
            await tab.go(address)
            before = await tab.evaluate(HEADLINE)
            store.drifts.accept(DriftRequest(scan_id="example"))
            worker.finish_drift(within_tolerance=False, ray_change_mm=0.8, reason="the COR moved")
            async with asyncio.timeout(120):
                while (after := await tab.evaluate(HEADLINE)) == before:  # noqa: ASYNC110 - the page is asked
                    await asyncio.sleep(0.1)
            assert (before, after) == ("1 fine, 1 needs you", "0 fine, 2 need you, 1 of them red")
            paths = mill_states.fill(store, worker)
            assert [each for language in ("en", "fi") for each in await tour(tab, address, paths, language)] == []
            assert tab.errors == []

    with serve(0) as port:
        asyncio.run(walk(f"http://127.0.0.1:{port}"))
