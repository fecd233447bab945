"""Receivers of webhooks on loopback: they note what comes, check its signature, and answer as a test tells them."""

import ssl
import threading
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest, new
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass
class Message:
    path: str
    headers: dict[str, str]
    body: bytes

    @property
    def id(self) -> str:
        return self.headers["webhook-id"]

    def is_signed_with(self, secret: str) -> bool:
        """As the specification verifies it, by code of its own."""
        content = b".".join([self.id.encode(), self.headers["webhook-timestamp"].encode(), self.body])
        right = b64encode(new(b64decode(secret.partition("_")[2]), content, sha256).digest()).decode()
        given = [each.partition(",") for each in self.headers["webhook-signature"].split(" ")]
        return any(version == "v1" and compare_digest(signature, right) for version, _, signature in given)


Answer = Callable[[Any], None]
"""Writes an answer with the handler of a request."""


def status(code: int, **headers: str) -> Answer:
    def write(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(code)
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    return write


def endless(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(200)
    handler.end_headers()
    try:
        while True:
            handler.wfile.write(bytes(65536))
    except OSError:
        handler.server.ended.set()


def early_close(handler: BaseHTTPRequestHandler) -> None:
    handler.wfile.write(b"HTTP/1.1 2")


def garbage(handler: BaseHTTPRequestHandler) -> None:
    handler.wfile.write(b"SSH-2.0-OpenSSH_9.2\r\n\r\n")


def dripping(handler: BaseHTTPRequestHandler) -> None:
    """A head that comes byte by byte, for longer than anybody waits."""
    try:
        while not handler.server.let_go.wait(0.02):
            handler.wfile.write(b"H")
    except OSError:
        handler.server.ended.set()


def hanging(handler: BaseHTTPRequestHandler) -> None:
    handler.server.let_go.wait(600)


@dataclass
class Receiver:
    """What came, in order, and how it is answered: by `answers` in turn, then by `usual`."""

    port: int
    messages: list[Message] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    usual: Answer = field(default_factory=lambda: status(204))
    ended: threading.Event = field(default_factory=threading.Event)
    let_go: threading.Event = field(default_factory=threading.Event)
    came: threading.Condition = field(default_factory=threading.Condition)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook?line=2"

    def has(self, number: int, within_s: float = 60.0) -> bool:
        """Whether this number of messages comes, within a time that is long for any machine."""
        with self.came:
            return self.came.wait_for(lambda: len(self.messages) >= number, within_s)


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        receiver = self.server.receiver
        body = self.rfile.read(int(self.headers["Content-Length"]))
        headers = {name.lower(): value for name, value in self.headers.items()}
        with receiver.came:
            receiver.messages.append(Message(self.path, headers, body))
            receiver.came.notify_all()
        (receiver.answers.pop(0) if receiver.answers else receiver.usual)(self)

    def log_message(self, *_: object) -> None:
        """Not to the log of tests."""


@contextmanager
def receiving(certificates: ssl.SSLContext | None = None) -> Iterator[Receiver]:
    """A receiver on a free port of loopback; with certificates it speaks TLS."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _Handler) as server:
        if certificates is not None:
            server.socket = certificates.wrap_socket(server.socket, server_side=True)
        receiver = Receiver(server.server_address[1])
        server.receiver, server.ended, server.let_go = receiver, receiver.ended, receiver.let_go
        server.daemon_threads = True
        server.handle_error = lambda *_: None  # of a client that went away
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        try:
            yield receiver
        finally:
            receiver.let_go.set()
            server.shutdown()
            thread.join()
