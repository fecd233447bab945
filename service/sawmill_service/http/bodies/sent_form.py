"""A form (multipart/form-data, RFC 7578) of fields and one file, read as it arrives: memory never holds it whole."""

import hashlib
import json
from collections.abc import Callable, Iterator
from typing import Any

from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from python_multipart import MultipartParser
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartState, parse_options_header
from starlette.datastructures import Headers

from sawmill_platform.contracts.given import Given, shown
from sawmill_service.http.bodies.sent_content import FirstBytes, SentContent, check_media_type
from sawmill_service.http.problems import ProblemPlace, Refused

MEDIA_TYPE, FILE = "multipart/form-data", "file"
_MOST_PARTS, _LONGEST_NAME = 100, 200
_AS_IT_IS = {b"identity", b"binary", b"8bit", b"7bit"}


class SentForm(SentContent):
    """Reader of a form whose content is the file; once `end` has returned, `form` is the model of the fields.

    `check` is called when the file begins, if the fields before the file suffice. Its error is the answer.
    """

    def __init__(self, headers: Headers, model: type[Given], *, max_field_bytes: int) -> None:
        super().__init__(headers, packed=False, of_form=True)
        kind, options = parse_options_header(headers.get("content-type"))
        if kind != MEDIA_TYPE.encode():
            detail = f"the body must be a form ({MEDIA_TYPE}) with the file as {FILE!r}"
            raise Refused(415, "unsupported-media-type", detail, {"Accept": MEDIA_TYPE})
        self.form: Any = None
        self.check: Callable[[Any], None] = lambda _: None
        self._model, self._left_bytes, self._field = model, max_field_bytes, ""
        self._given, self._file = dict[str, bytearray](), list[bytes]()
        self._head = list[tuple[bytearray, bytearray]]()
        self._look, self._has_file = FirstBytes().look, False
        names = ("header_begin", "header_field", "header_value", "headers_finished", "part_data")
        callbacks: Any = {f"on_{name}": getattr(self, f"_{name}") for name in names}
        try:
            self._parser = MultipartParser(options[b"boundary"] or b"\n", callbacks)
        except (KeyError, FormParserError) as error:
            raise _bad(f"cannot be read: Content-Type must be as in {MEDIA_TYPE}; boundary=x") from error

    def take(self, part: bytes) -> Iterator[bytes]:
        """Yield the file's bytes that a part of the body holds."""
        for sent in super().take(part):
            try:
                self._parser.write(sent)
            except FormParserError as error:
                raise _bad(f"cannot be read: {error}") from error
            pieces, self._file = self._file, []
            yield from pieces

    def end(self) -> None:
        """Refuse a form that did not arrive whole, and one with missing fields."""
        super().end()
        if self._parser.state is not MultipartState.END:
            raise _bad("breaks off: the boundary that ends it is missing; send it again")
        self.form = self._read_fields()
        if not self._has_file:
            raise Refused(422, "empty-body", f"the form's {FILE!r} is empty: choose a file")

    def sha256_with(self, file_sha256: str) -> str:
        """Return a checksum of the fields and the file, independent of their order and of the boundary."""
        fields = sorted((name, value.decode()) for name, value in self._given.items())
        return hashlib.sha256(json.dumps([fields, file_sha256]).encode()).hexdigest()

    def _header_begin(self) -> None:
        self._head.append((bytearray(), bytearray()))

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        self._head[-1][0].extend(data[start:end].lower())

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._head[-1][1].extend(data[start:end])

    def _headers_finished(self) -> None:
        head = {bytes(name): bytes(value) for name, value in self._head}
        if len(head) < len(self._head):
            raise _bad("has a part with a header twice")
        self._head.clear()
        kind, options = parse_options_header(head.get(b"content-disposition"))
        if kind != b"form-data" or b"name" not in options or len(self._given) == _MOST_PARTS:
            raise _bad(f'has more than {_MOST_PARTS} parts, or one without Content-Disposition: form-data; name="…"')
        self._field = name = options[b"name"].decode(errors="replace")
        if name in self._given:
            raise Refused(422, "two-files" if name == FILE else "invalid-request", f"the form has {name!r} twice")
        encodings = (head.get(b"content-" + kind, b"binary") for kind in (b"encoding", b"transfer-encoding"))
        if not _AS_IT_IS.issuperset(each.strip().lower() for each in encodings):
            raise Refused(415, "unsupported-encoding", f"the form's {name!r} must be sent as it is")
        self._given[name] = bytearray()
        if name == FILE:
            check_media_type(head.get(b"content-type", b"").decode("latin-1"))
            file_name = options.get(b"filename", b"").decode(errors="replace").replace("\\", "/").rpartition("/")[2]
            self._given[FILE] += shown(file_name)[:_LONGEST_NAME].strip().encode()
            if form := self._read_fields(more_follow=True):
                self.check(form)

    def _part_data(self, data: bytes, start: int, end: int) -> None:
        piece = data[start:end]
        if self._field == FILE:
            self._look(piece)
            self._file.append(piece)
            self._has_file = True
            return
        self._given[self._field] += piece
        self._left_bytes -= len(piece)
        if self._left_bytes < 0:
            raise Refused(413, "body-too-large", "the fields of the form are too large: only its file may be large")

    def _read_fields(self, *, more_follow: bool = False) -> Given | None:
        """Read the fields so far; return None if fields that may follow are missing or may complete them."""
        try:
            return self._model.model_validate({name: value.decode() for name, value in self._given.items()})
        except UnicodeDecodeError as error:
            raise _bad("cannot be read: a field is not UTF-8") from error
        except ValidationError as error:
            faults = error.errors()
            if more_follow:
                faults = [each for each in faults if each["loc"] and each["type"] != "missing"]
            if not faults:
                return None
            placed = [{**each, "loc": (ProblemPlace.BODY, *each["loc"])} for each in faults]
            raise RequestValidationError(placed, body=self._given) from error


def _bad(what: str) -> Refused:
    return Refused(400, "bad-form", f"the form {what}")
