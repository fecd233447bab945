"""Parts that a machine may lack, whose tests are skipped with a sentence and fail where CI=true, and free ports."""

import os
import secrets
import socket
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

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
