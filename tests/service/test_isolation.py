"""The service reaches no network; that it imports no science, test_architecture.py sees."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

OFFLINE = """
import asyncio, socket, sys
from pathlib import Path

def refuse(*arguments, **_):
    raise AssertionError(f"the network was asked for: {arguments}")

socket.getaddrinfo = socket.create_connection = refuse
connect = socket.socket.connect
def connect_locally(self, address):
    if self.family != socket.AF_UNIX and address[0] not in ("127.0.0.1", "::1"):
        refuse(address)
    return connect(self, address)
socket.socket.connect = socket.socket.connect_ex = connect_locally

import httpx
from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store

async def main():
    store = Store.open(StorageSettings(data_folder=Path(sys.argv[1]), database_url=None))
    app = create_app(ServiceSettings(), store, lambda _: None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1") as client:
        for path in ("/", "/docs", "/openapi.json", "/v1/phantoms", "/v1/jobs", "/health/ready", "/metrics"):
            assert (await client.get(path)).status_code == 200, path
    store.close()

asyncio.run(main())
try:
    socket.socket().connect(("192.0.2.1", 80))
except AssertionError:
    print("offline")
"""


def test_the_service_works_without_a_network(tmp_path):
    done = subprocess.run([sys.executable, "-c", OFFLINE, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "offline"
