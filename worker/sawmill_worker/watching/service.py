"""Client of the service for a watcher, over HTTP with a key of scope `submit`."""

import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Self
from urllib.parse import urlsplit

import httpx

from sawmill_vocabulary import Progress, ProgressCallback
from sawmill_worker.watching.durable import FileChanged
from sawmill_worker.watching.settings import Watching
from sawmill_worker.watching.stopping import Stop

CHUNK_BYTES = 2**20
CONNECT_S, ANSWER_S = 10.0, 60.0
# Longest wait, s, even if the service requests more: a watcher that sleeps for a day seems dead.
LONGEST_RETRY_S = 3600.0

Json = dict[str, Any]


class ServiceWaits(Exception):  # noqa: N818 - a temporary state
    """The service cannot be used now, by any client or with this key: nothing changes, and the request is retried."""

    def __init__(self, sentence: str, *, code: str, retry_after_s: float | None = None) -> None:
        super().__init__(sentence)
        self.code = code
        self.retry_after_s = retry_after_s


class Refusal(Exception):  # noqa: N818 - the service's answer
    """The service refuses a request."""

    def __init__(self, status: int, code: str, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code

    @property
    def is_of_file(self) -> bool:
        """True if the file is the reason: too large, or by its first bytes no file of measurements."""
        return self.status in {413, 415}


class RequestFails(Exception):  # noqa: N818 - a state that lasts until a person acts
    """The service or its proxy fails at this request, and may succeed with other requests."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


class Service:
    """A client that sends one request at a time.

    Parameters
    ----------
    watching
        Address of the service, and the files of the key and of certificates.
    stop
        Ends an upload.

    Raises
    ------
    OSError
        The certificates cannot be read.
    """

    def __init__(self, watching: Watching, stop: Stop) -> None:
        self._key_file = None if watching.key_file is None else Path(watching.key_file)
        self._stop = stop
        self._client = httpx.Client(
            base_url=watching.service,
            timeout=httpx.Timeout(ANSWER_S, connect=CONNECT_S),
            # A scheme is case-insensitive: `HTTPS:` is https.
            verify=urlsplit(watching.service).scheme == "https" and _trusted(watching.ca_file),
            # No proxy and no netrc of the environment: only the settings of the file apply.
            trust_env=False,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def get(self, path: str, **query: str) -> Json:
        """Return the JSON at a path.

        Raises
        ------
        ServiceWaits, Refusal, RequestFails
            Errors that any request can raise.
        """
        return self._ask("GET", path, params=query)

    def found(self, path: str, code: str) -> Json | None:
        """Return the JSON at a path; None if the service answers with the error `code`."""
        try:
            return self.get(path)
        except Refusal as refusal:
            if refusal.code == code:
                return None
            raise

    def begin_upload(self, file: Json, *, once: str) -> Json:
        """Declare an upload; a repeated request with the same key `once` declares no second upload."""
        return self._ask("POST", "/v1/uploads", json=file, headers={"Idempotency-Key": f'"{once}"'})

    def send_rest(self, upload: Json, file: BinaryIO, on_progress: ProgressCallback) -> Json:
        """Send the missing part of an upload.

        Raises
        ------
        Stopped, FileChanged
            The watcher was asked to end, or the file changed; the service keeps the received part.
        """
        offset = upload["offset_bytes"]
        file.seek(offset)
        headers = {
            "Upload-Offset": str(offset),
            "Content-Length": str(upload["size_bytes"] - offset),
            "Content-Type": "application/octet-stream",
        }
        body = self._chunks(file, offset, upload["size_bytes"], on_progress)
        return self._ask("PATCH", f"/v1/uploads/{upload['id']}", content=body, headers=headers)

    def _chunks(self, file: BinaryIO, sent: int, size: int, on_progress: ProgressCallback) -> Iterator[bytes]:
        while sent < size:
            self._stop.check()
            chunk = file.read(min(CHUNK_BYTES, size - sent))
            if not chunk:
                raise FileChanged("it became shorter while it was sent")
            sent += len(chunk)
            yield chunk
            on_progress(Progress(sent / size, f"{sent / 2**20:.0f} of {size / 2**20:.0f} MiB"))

    def delete_upload(self, upload_id: str) -> None:
        """Delete an upload, which frees its disk space."""
        try:
            self._ask("DELETE", f"/v1/uploads/{upload_id}")
        except Refusal as refusal:
            if refusal.code != "upload-not-found":
                raise

    def make_scan(self, upload_id: str, query: dict[str, str]) -> Json:
        """Make a scan of an upload, which can be used only once."""
        return self._ask("POST", "/v1/scans", params={**query, "upload_id": upload_id})

    def find_scan(self, *, scanner_id: str, name: str, sha256: str, since: str) -> Json | None:
        """Return the newest scan of a scanner with this name and checksum, made since a time of the service's clock."""
        query = {"scanner_id": scanner_id, "created_from": since}
        while True:
            page = self.get("/v1/scans", **query)
            for scan in page["items"]:
                if (scan["sha256"], scan["name"]) == (sha256, name):
                    newest: Json = scan
                    return newest
            if page["next"] is None:
                return None
            query["after"] = page["next"]

    def _ask(self, method: str, path: str, **options: Any) -> Json:  # noqa: ANN401 - httpx's own
        headers = {**self._authorization(), **options.pop("headers", {})}
        try:
            answer = self._client.request(method, path, headers=headers, **options)
        except httpx.TransportError as error:
            sentence = f"no answer from {self._client.base_url}: {str(error) or type(error).__name__}"
            raise ServiceWaits(sentence, code="no-answer") from error
        return self._read(answer)

    def _authorization(self) -> dict[str, str]:
        """Read the key from its file for each request, because the file may be replaced."""
        if self._key_file is None:
            return {}
        try:
            key = self._key_file.read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ServiceWaits(f"the key in {self._key_file} cannot be read: {error}", code="key-file") from error
        if not key or not key.isprintable() or " " in key:
            sentence = f"{self._key_file} must hold a key and nothing else, as sawmill key create prints it"
            raise ServiceWaits(sentence, code="key-file")
        return {"Authorization": f"Bearer {key}"}

    def _read(self, answer: httpx.Response) -> Json:
        if answer.status_code == httpx.codes.NO_CONTENT:
            return {}
        try:
            document = answer.json()
        except ValueError:  # from JSON or its encoding
            document = None
        if answer.is_success and isinstance(document, dict):
            return document
        if not isinstance(document, dict) or "code" not in document:
            sentence = f"{answer.request.url} is answered with {answer.status_code}, and not by the service"
            if answer.status_code == httpx.codes.REQUEST_ENTITY_TOO_LARGE:  # a proxy takes no file of this size
                raise RequestFails("no-service", sentence)
            raise ServiceWaits(sentence, code="no-service", retry_after_s=_retry_after_s(answer))
        code, detail = str(document["code"]), str(document.get("detail", ""))
        if answer.status_code == httpx.codes.INTERNAL_SERVER_ERROR:
            raise RequestFails(code, detail)
        if answer.status_code in _WAITING or answer.status_code >= httpx.codes.INTERNAL_SERVER_ERROR or code in _PASSES:
            raise ServiceWaits(detail, code=code, retry_after_s=_retry_after_s(answer))
        raise Refusal(answer.status_code, code, detail)


# Answers after which the service waits: no key, too small a scope, another host name, too slow, too many requests.
_WAITING = frozenset({401, 403, 408, 421, 429})
# Other codes of answers that may differ later.
_PASSES = frozenset({"upload-busy", "upload-quota", "wrong-offset"})


def _trusted(ca_file: str | None) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca_file)
    except OSError as error:  # the error does not name the file
        raise OSError(error.errno, f"no certificates (PEM) can be read: {error.strerror or error}", ca_file) from error


def _retry_after_s(answer: httpx.Response) -> float | None:
    text = answer.headers.get("Retry-After", "")
    return min(float(text), LONGEST_RETRY_S) if text.isascii() and text.isdigit() else None


def speaks_openly(url: str) -> bool:
    """Return whether a key would be sent unencrypted over a network."""
    parts = urlsplit(url)
    return parts.scheme == "http" and parts.hostname not in {"localhost", "127.0.0.1", "::1"}
