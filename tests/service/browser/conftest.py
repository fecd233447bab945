"""Debian's Chromium before the service: its loop runs in the tests' thread, which so can use no `asyncio.run`."""

import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from urllib.parse import urlsplit

import live_service
import pytest
import uvicorn
from missing_parts import skip_without
from playwright.sync_api import Browser, Page, expect, sync_playwright

from sawmill_service.app import create_app
from sawmill_service.event_feed import StreamTimes
from sawmill_service.http.listening import listen
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store

MISSING = "the browser tests need Debian's Chromium: apt-get install chromium-headless-shell"
# Without the frame of a window the same browser takes a third of the processor.
PROGRAMS = ("chromium-headless-shell", "chromium")
START_S, PATIENCE_MS = 120.0, 120_000  # only a hang reaches them
# No sandbox, for that needs a user of its own; and nothing that Chromium does on its own account.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)


class OpenBrowser:
    """The browser that successive tests share, whatever their modules."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self._browser: Browser | None = None

    def get(self) -> Browser:
        if self._browser is None:
            program = next(filter(None, map(shutil.which, PROGRAMS)), None)
            if program is None:
                skip_without(MISSING)
            expect.set_options(timeout=PATIENCE_MS)
            launched = self._open.enter_context(sync_playwright()).chromium.launch(executable_path=program, args=FLAGS)
            self._browser = self._open.enter_context(closing(launched))
        return self._browser

    def close(self) -> None:
        self._open.close()
        self._browser = None


OPEN_BROWSER = OpenBrowser()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> Iterator[None]:
    try:
        yield
    finally:
        if "browser" not in getattr(nextitem, "fixturenames", ()):
            OPEN_BROWSER.close()


@pytest.fixture
def browser() -> Browser:
    return OPEN_BROWSER.get()


@dataclass
class Site:
    """The service as a browser reaches it, and every request that the browser's pages made."""

    address: str
    browser: Browser
    requested: list[str] = field(default_factory=list)

    def open(self, path: str = "/", **options: object) -> Page:
        """A page in a profile of its own; `options` are those of Playwright's contexts."""
        context = self.browser.new_context(base_url=self.address, **options)
        context.on("request", lambda request: self.requested.append(request.url))
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(path)
        return page

    def hosts_asked(self) -> set[str]:
        """Hosts with their ports; an address within the page, as data: has it, has none."""
        return {urlsplit(url).netloc for url in self.requested} - {""}


@pytest.fixture
def site(browser: Browser, store: Store, settings: ServiceSettings) -> Iterator[Site]:
    """A running service on the test's store, in front of a browser."""
    with serving(store, settings, 0, StreamTimes()) as port:
        site = Site(f"http://127.0.0.1:{port}", browser)
        yield site
        for context in browser.contexts:
            context.close()
    assert site.hosts_asked() <= {f"127.0.0.1:{port}"}


@pytest.fixture
def stream_times() -> StreamTimes:
    return StreamTimes()


@pytest.fixture
def serve(
    store: Store, settings: ServiceSettings, stream_times: StreamTimes
) -> Callable[[int], AbstractContextManager[int]]:
    """Runs the service on a port, or on a free one where that is 0, for as long as a test wants."""
    return partial(serving, store, settings, times=stream_times)


@pytest.fixture
def service(tmp_path):
    """`sawmill serve` on an empty data folder."""
    variables = live_service.Offline(tmp_path).variables | {"SAWMILL_STOP_GRACE_S": "1"}
    with live_service.serving(tmp_path, variables, "--no-examples") as started:
        yield started


@pytest.fixture
def page(browser, service):
    """A tablet, which asks no other host for anything."""
    context = browser.new_context(base_url=str(service.client.base_url), viewport={"width": 800, "height": 1100})
    hosts = set()
    context.on("request", lambda request: hosts.add(re.sub(r"^\w+://([^/]*).*", r"\1", request.url)))
    yield context.new_page()
    context.close()
    assert hosts <= {service.client.base_url.netloc.decode()}


@contextmanager
def serving(store: Store, settings: ServiceSettings, port: int, times: StreamTimes) -> Iterator[int]:
    """The application on a loopback port, a free one where it is 0, in a thread."""
    app = create_app(settings, store, lambda _: None)
    app.state.stream_times = times
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, lifespan="off"))
    with closing(listen("127.0.0.1", port, guarded=True)) as listening:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            wait_until(lambda: server.started)
            yield listening.getsockname()[1]
        finally:
            app.state.stopping.begin()  # streams of events end
            server.should_exit = True
            thread.join()


def wait_until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + START_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)
