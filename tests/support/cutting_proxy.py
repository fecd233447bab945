"""A proxy on loopback that cuts uploads in the middle of their parts, as a poor line does."""

import re
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_PART = b"PATCH /v1/uploads/"
_OFFSET = re.compile(rb"(upload-offset: )\d+", re.IGNORECASE)
_PIECE_BYTES = 2**14


class CuttingProxy:
    """Passes bytes on; cuts the first parts `after_bytes`, every other one silently; makes the next offsets wrong."""

    def __init__(self, service: tuple[str, int], *, cuts: int, after_bytes: int, wrong_offsets: int = 0) -> None:
        self._service, self._after_bytes = service, after_bytes
        self.cuts_left, self.wrong_offsets_left = cuts, wrong_offsets
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._open = [self._listener]
        host, port = self._listener.getsockname()
        self.address = f"http://{host}:{port}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        for each in self._open:
            _end(each)

    def _accept(self) -> None:
        with suppress(OSError):  # the listener was closed
            while True:
                client, _ = self._listener.accept()
                service = socket.create_connection(self._service)
                self._open += [client, service]
                for pass_on in (self._requests, self._answers):
                    threading.Thread(target=pass_on, args=(client, service), daemon=True).start()

    def _requests(self, client: socket.socket, service: socket.socket) -> None:
        left: int | None = None
        with suppress(OSError):
            while piece := client.recv(_PIECE_BYTES):
                if left is None and _PART in piece:
                    if self.cuts_left:
                        left = self._after_bytes
                    elif self.wrong_offsets_left:
                        self.wrong_offsets_left -= 1
                        piece = _OFFSET.sub(rb"\g<1>1", piece)
                service.sendall(piece[:left])
                if left is not None and (left := left - len(piece)) <= 0:
                    self.cuts_left -= 1
                    _end(client)
                    if self.cuts_left % 2:
                        return
        _end(service)

    def _answers(self, client: socket.socket, service: socket.socket) -> None:
        with suppress(OSError):
            while piece := service.recv(_PIECE_BYTES):
                client.sendall(piece)
        _end(client)


@contextmanager
def cutting(service: tuple[str, int], *, cuts: int, after_bytes: int, wrong_offsets: int = 0) -> Iterator[CuttingProxy]:
    proxy = CuttingProxy(service, cuts=cuts, after_bytes=after_bytes, wrong_offsets=wrong_offsets)
    try:
        yield proxy
    finally:
        proxy.close()


def _end(line: socket.socket) -> None:
    with suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)
    line.close()
