"""A form (multipart/form-data, RFC 7578) of fields and one file, read as it comes: the file is held nowhere whole."""

import hashlib
import json
import re
from collections.abc import Callable, Container, Iterator, Mapping
from typing import Any, Generic, TypeVar

from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from python_multipart import MultipartParser
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers

from sawmill_service.problems import STATED, Place, Refused
from sawmill_service.queries import near_name
from sawmill_service.sent_content import FirstBytes, SentContent, check_media_type
from sawmill_worker.contracts.given import Given, shown

MEDIA_TYPE, FILE = "multipart/form-data", "file"
_LONGEST_BOUNDARY = 70  # by RFC 2046, 5.1.1
# Of Content-Transfer-Encoding, which RFC 7578 has no use for: nothing is done to the bytes.
_AS_IT_IS = {b"binary", b"8bit", b"7bit"}
# Each delimiter, and each space behind one, costs the parser time of its own; forms have one a field.
_MOST_DELIMITERS, _MOST_PADDING_BYTES = 100, 64
_LONGEST_NAME = 200

Form = TypeVar("Form", bound=Given)


class SentForm(Generic[Form]):
    """Takes a form apart: the file's bytes are its content, and its fields become a model.

    What is wrong is refused as soon as it is known, before the file where the fields stand before it.

    Parameters
    ----------
    headers
        Of the request.
    model
        Of the fields; its `file` is the file's name.
    max_field_bytes
        Of all fields together.

    Attributes
    ----------
    check
        Called in a thread when the file begins, if the fields before it are enough; what it raises is the answer.
    form
        The fields, once `end` has returned.

    Raises
    ------
    Refused
        415 `unsupported-media-type`, `unsupported-encoding`; 400 `bad-form`, `bad-digest`.
    """

    form: Form

    def __init__(self, headers: Headers, model: type[Form], *, max_field_bytes: int) -> None:
        self._content = SentContent(headers, packed=False, of_form=True)
        self._model = model
        self.check: Callable[[Form], None] = lambda _: None
        self._max_field_bytes, self._field_bytes = max_field_bytes, 0
        self._given = dict[str, str]()
        self._first, self._file = FirstBytes(), list[bytes]()
        self._file_begun = self._ended = False
        self._begin_part()
        boundary = _boundary(headers.get("content-type", ""))
        self._delimiters = _Delimiters(boundary)
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin_part,
                "on_header_field": self._add_to_name,
                "on_header_value": self._add_to_value,
                "on_header_end": self._end_header,
                "on_headers_finished": self._end_head,
                "on_part_data": self._add_data,
                "on_part_end": self._end_part,
                "on_end": self._end_form,
            },
        )

    def take(self, part: bytes) -> Iterator[bytes]:
        """The file's bytes in a part of what was sent."""
        for sent in self._content.take(part):
            self._delimiters.count(sent)
            try:
                self._parser.write(sent)
            except FormParserError as error:
                raise _bad(f"cannot be read: {error}") from error
            pieces, self._file = self._file, []
            yield from pieces

    def end(self) -> None:
        """Refuse what did not come whole, and what is missing."""
        self._content.end()
        if not self._ended:
            raise _bad("breaks off: the boundary that ends it is missing; send it again")
        try:
            self.form = self._model.model_validate(self._given)
        except ValidationError as error:
            raise self._refused(*error.errors()) from error
        if not self._file_begun:
            raise Refused(422, "empty-body", f"the form's {FILE!r} is empty: choose a file")

    def sha256_with(self, file_sha256: str) -> str:
        """By which what was sent is known again: fields and file, whatever their order and the boundary between."""
        return hashlib.sha256(json.dumps([sorted(self._given.items()), file_sha256]).encode()).hexdigest()

    def _begin_part(self) -> None:
        self._name, self._value, self._head = b"", b"", dict[bytes, bytes]()
        self._field, self._text = "", bytearray()

    def _add_to_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _add_to_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _end_header(self) -> None:
        name = self._name.lower()
        if name in self._head:
            raise _bad(f"has a part with two lines {name[:100].decode('latin-1')!r}: send one")
        self._head[name] = self._value
        self._name = self._value = b""

    def _end_head(self) -> None:
        kind, options = parse_options_header(self._head.get(b"content-disposition"))
        if kind != b"form-data" or b"name" not in options:
            raise _bad('has a part without Content-Disposition: form-data; name="…"')
        self._field = _decoded(options[b"name"], "a field's name")
        self._check_field(is_file=b"filename" in options)
        self._check_encoding(b"content-transfer-encoding", _AS_IT_IS)
        self._check_encoding(b"content-encoding", {b"identity"})
        if self._field == FILE:
            self._begin_file(options.get(b"filename", b""))

    def _check_encoding(self, header: bytes, right: Container[bytes]) -> None:
        if header in self._head and (encoding := self._head[header].strip().lower()) not in right:
            detail = f"the form's {self._field!r} must be sent as it is, not by {encoding[:100].decode('latin-1')!r}"
            raise Refused(415, "unsupported-encoding", detail)

    def _check_field(self, *, is_file: bool) -> None:
        name = self._field
        if name not in self._model.model_fields:
            raise self._refused(_stated(name, f"is not a known field{near_name(name, self._model.model_fields)}"))
        if name in self._given:
            if name == FILE:
                raise Refused(422, "two-files", "the form has two files: send each as a scan of its own")
            raise self._refused(_stated(name, "is given twice: give it once"))
        if is_file and name != FILE:
            raise self._refused(_stated(name, f"must be a value, not a file: the file is the field {FILE!r}"))

    def _begin_file(self, name: bytes) -> None:
        """Note the file's name; refuse what can be already."""
        check_media_type(self._head.get(b"content-type", b"").decode("latin-1"))
        self._given[FILE] = _fitting(name)
        try:
            form = self._model.model_validate(self._given)
        except ValidationError as error:
            if any(each["type"] != "missing" for each in error.errors()):
                raise self._refused(*error.errors()) from error
        else:
            self.check(form)

    def _add_data(self, data: bytes, start: int, end: int) -> None:
        piece = data[start:end]
        if self._field == FILE:
            self._first.look(piece)
            self._file_begun = True
            self._file.append(piece)
            return
        self._field_bytes += len(piece)
        if self._field_bytes > self._max_field_bytes:
            detail = f"the fields of the form may have at most {self._max_field_bytes} bytes together"
            raise Refused(413, "body-too-large", detail)
        self._text += piece

    def _end_part(self) -> None:
        if self._field != FILE:
            self._given[self._field] = _decoded(bytes(self._text), f"the field {self._field!r}")

    def _end_form(self) -> None:
        self._ended = True

    def _refused(self, *errors: Mapping[str, Any]) -> RequestValidationError:
        """Of the body, in which the field that is being read stands too."""
        placed = [{**error, "loc": (Place.BODY, *error["loc"])} for error in errors]
        return RequestValidationError(placed, body={**self._given, self._field: ""})


class _Delimiters:
    """Bounds what a form's delimiters may cost, in whatever pieces they come."""

    def __init__(self, boundary: bytes) -> None:
        self._line = b"\r\n--" + boundary
        self._padded = re.compile(re.escape(self._line) + rb"[ \t]{%d}" % (_MOST_PADDING_BYTES + 1))
        self._before, self._found = b"\r\n", 0

    def count(self, piece: bytes) -> None:
        """Refuse more delimiters than any form has, and one with more padding than any has."""
        seen = self._before + piece
        self._found += seen.count(self._line) - self._before.count(self._line)
        if self._found > _MOST_DELIMITERS:
            raise _bad(f"has more than {_MOST_DELIMITERS} lines that begin with its boundary: take another boundary")
        if self._padded.search(seen):
            raise _bad(f"has more than {_MOST_PADDING_BYTES} spaces after a boundary")
        self._before = seen[-len(self._line) - _MOST_PADDING_BYTES :]


def _fitting(name: bytes) -> str:
    """What a file's name can give a scan: without folders, which some clients send, and all that no name may have."""
    return shown(re.split(r"[/\\]", name.decode(errors="replace"))[-1])[:_LONGEST_NAME].strip()


def _boundary(content_type: str) -> bytes:
    kind, options = parse_options_header(content_type)
    if kind != MEDIA_TYPE.encode():
        detail = f"the body must be a form ({MEDIA_TYPE}) with the file as {FILE!r}, not {content_type[:100]!r}"
        raise Refused(415, "unsupported-media-type", detail, {"Accept": MEDIA_TYPE})
    boundary = options.get(b"boundary", b"")
    if not 1 <= len(boundary) <= _LONGEST_BOUNDARY:
        right = f"Content-Type must be as in {MEDIA_TYPE}; boundary=x, with 1 to {_LONGEST_BOUNDARY} characters"
        raise _bad(f"cannot be read: {right}, not {content_type[:100]!r}")
    return boundary


def _decoded(text: bytes, what: str) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError as error:
        raise _bad(f"cannot be read: {what} is not UTF-8") from error


def _stated(name: str, sentence: str) -> dict[str, Any]:
    return {"type": STATED, "loc": (name,), "msg": sentence, "input": None}


def _bad(what: str) -> Refused:
    return Refused(400, "bad-form", f"the form {what}")
