"""Requests to an application without a network, in one event loop or message by message; what its pages say."""

import json
import re
from typing import Any

import httpx

ORIGIN = "http://127.0.0.1:8000"


def blocks(text: str) -> list[dict[str, Any]]:
    """Each event of a stream that came whole, with its data read; comments under an empty name."""
    found = []
    for block in filter(None, text.split("\n\n")[:-1]):
        fields = dict(line.split(": ", 1) for line in block.splitlines())
        found.append(fields | ({"data": json.loads(fields["data"])} if "data" in fields else {}))
    return found


def refusal(answer: httpx.Response) -> tuple[int, str]:
    """The status and the code of a problem."""
    return answer.status_code, answer.json()["code"]


def asynchronous(app: Any, **headers: str) -> httpx.AsyncClient:
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=ORIGIN, headers=headers, timeout=60)


def scope_of(path: str, method: str = "GET") -> dict[str, Any]:
    url = httpx.URL(ORIGIN + path)
    scope = {"type": "http", "http_version": "1.1", "asgi": {"spec_version": "2.3"}, "method": method, "root_path": ""}
    scope |= {"path": url.path, "raw_path": url.raw_path, "query_string": url.query, "scheme": url.scheme}
    return scope | {"headers": [(b"host", url.netloc)], "client": ("127.0.0.1", 9), "server": (url.host, url.port)}


def text_of(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")


def absent(text: object, *parts: str) -> list[str]:
    return [part for part in parts if part not in text]
