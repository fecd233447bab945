"""Debian's Firefox, driven by WebDriver BiDi over its own WebSocket: no geckodriver."""

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import count
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

PROGRAM = shutil.which("firefox-esr")
MISSING = "the tour in Firefox needs Debian's firefox-esr: .ci/run installs it"
PATIENCE_S = 120.0  # only a hang reaches it
# Firefox writes into this file of its profile where it listens.
SERVER = "WebDriverBiDiServer.json"
# Nothing that Firefox does on its own account.
PREFERENCES = {
    "app.normandy.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "services.settings.server": "http://127.0.0.1:9/",
}


class Firefox:
    """One tab of Firefox, with the errors of its pages' scripts so far."""

    def __init__(self, socket: WebSocketClientConnection) -> None:
        self._socket, self._numbers = socket, count(1)
        self.errors: list[str] = []
        self._tab = ""

    async def begin(self) -> None:
        """Begin a session in the tab that is open."""
        await self._command("session.new", capabilities={})
        await self._command("session.subscribe", events=["log.entryAdded"])
        self._tab = (await self._command("browsingContext.getTree"))["contexts"][0]["context"]

    async def go(self, address: str) -> None:
        """Load a page with all that belongs to it."""
        await self._command("browsingContext.navigate", context=self._tab, url=address, wait="complete")

    async def resize(self, width: int, height: int) -> None:
        """Give the page this size, px."""
        await self._command(
            "browsingContext.setViewport", context=self._tab, viewport={"width": width, "height": height}
        )

    async def evaluate(self, expression: str) -> Any:
        """Return the value of an expression of the page."""
        target = {"context": self._tab}
        answer = await self._command(
            "script.evaluate", expression=f"JSON.stringify({expression})", target=target, awaitPromise=True
        )
        assert answer["type"] == "success", answer
        return json.loads(answer["result"]["value"])

    async def _command(self, method: str, **parameters: Any) -> Any:
        number = next(self._numbers)
        await self._socket.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = await asyncio.wait_for(self._socket.read_message(), PATIENCE_S)
            assert message is not None, "Firefox has closed its WebSocket"
            answer = json.loads(message)
            if answer.get("method") == "log.entryAdded" and answer["params"]["level"] == "error":
                self.errors.append(answer["params"]["text"])
            if answer.get("id") == number:
                assert answer["type"] == "success", answer
                return answer["result"]


@asynccontextmanager
async def firefox(profile: Path) -> AsyncIterator[Firefox]:
    """Run Firefox without a window, with a profile of its own."""
    lines = (f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items())
    (profile / "user.js").write_text("".join(lines))
    command = [str(PROGRAM), "--headless", "--no-remote", "--remote-debugging-port=0", "--profile", str(profile)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:  # noqa: ASYNC220
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not (profile / SERVER).exists() or not (profile / SERVER).read_text():  # noqa: ASYNC110 - a file
                    await asyncio.sleep(0.1)
            server = json.loads((profile / SERVER).read_text())
            tab = Firefox(await websocket_connect(f"ws://{server['ws_host']}:{server['ws_port']}/session"))
            await tab.begin()
            yield tab
        finally:
            process.terminate()
