"""What is no HTTP that this service speaks: h11's complaint as a problem."""

import logging

from sawmill_service.problems import Refused

_LINE = Refused(400, "bad-request-line", "the first line must be METHOD TARGET HTTP/1.1, the target percent-encoded")
_HEADER = Refused(400, "bad-header", "each line of the head must be Name: value, without control characters")
_HOST = Refused(400, "bad-host", "a request must have one Host header")
_LENGTH = Refused(400, "bad-length", "Content-Length must be one count of bytes, of at most 20 digits")
_CODING = Refused(501, "transfer-encoding-unsupported", "Transfer-Encoding may be chunked alone, and stand there once")
_CHUNK = Refused(400, "bad-chunk", "a chunk must be its length in hexadecimal digits, then as many bytes")
_LARGE = Refused(431, "head-too-large", "the first line and the headers may have 20 KiB together")
_OTHER = Refused(400, "bad-request", "this is no request of HTTP/1.1")
# By how h11's complaint begins: it has no codes.
_BY_COMPLAINT = {
    "illegal request line": _LINE,
    "no request line": _LINE,
    "Illegal method": _LINE,
    "Illegal target": _LINE,
    "illegal header line": _HEADER,
    "continuation line": _HEADER,
    "Illegal header": _HEADER,
    "Missing mandatory Host": _HOST,
    "Found multiple Host": _HOST,
    "bad Content-Length": _LENGTH,
    "conflicting Content-Length": _LENGTH,
    "multiple Transfer-Encoding": _CODING,
    "Only Transfer-Encoding": _CODING,
    "illegal chunk": _CHUNK,
    "malformed chunk": _CHUNK,
    "Receive buffer too long": _LARGE,
}
# Uvicorn's remark says neither which request nor why; the connection logs both.
_REMARK = "Invalid HTTP request received."


def refusal_of(error: BaseException | None) -> Refused:
    """The problem that h11's complaint stands for."""
    complaint = str(error)
    found = (refused for begins, refused in _BY_COMPLAINT.items() if complaint.startswith(begins))
    return next(found, _OTHER)


def log_each_once() -> None:
    """Leave out uvicorn's own remark on what cannot be read."""
    logging.getLogger("uvicorn.error").addFilter(lambda record: record.msg != _REMARK)
