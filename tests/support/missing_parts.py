"""Parts a machine may lack (tests skip with a sentence, and fail where CI=true), free ports, tiers of the suite."""

import os
import secrets
import socket
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import pytest


def skip_without(sentence: str) -> NoReturn:
    """Skip a test that needs a part which is not here; fail it in CI, which installs every part."""
    if os.environ.get("CI") == "true":
        pytest.fail(sentence)
    pytest.skip(sentence)


def free_port() -> int:
    """Below those that the system gives to outgoing connections, one of which may take any other before its server."""
    lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    while True:
        port = 10_000 + secrets.randbelow(lowest - 10_000)
        with socket.socket() as free, suppress(OSError):
            free.bind(("127.0.0.1", port))
            return port


def first_by_day(number: int, values: Iterable[Any]) -> list[Any]:
    """Give parametrised values of which `make test` runs the first ones and `make nightly` the others."""
    return [
        value if index < number else pytest.param(value, marks=pytest.mark.nightly)
        for index, value in enumerate(values)
    ]


# The worker's attempts as children of a template, and as fresh processes.
both_ways = pytest.mark.parametrize("settings", [True, False], ids=["forked", "fresh"], indirect=True)
fresh_by_night = pytest.mark.parametrize(
    "settings",
    [pytest.param(True, id="forked"), pytest.param(False, id="fresh", marks=pytest.mark.nightly)],
    indirect=True,
)
