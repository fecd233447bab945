"""The committed example requests, as a client sends them."""

from typing import Any


def with_file(example: dict[str, Any], content: bytes) -> dict[str, Any]:
    """What httpx is given for an example whose file has this content: the body, or a part of a form."""
    if example["media_type"] == "multipart/form-data":
        return {"data": example["body"], "files": {"file": content}}
    return {"content": content, "headers": example["headers"] | {"Content-Type": example["media_type"]}}
