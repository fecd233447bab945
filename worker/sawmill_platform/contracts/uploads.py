"""Uploads that can be resumed: a file that comes in parts before it becomes a scan, a picture or an inspection."""

from datetime import timedelta
from enum import StrEnum
from typing import Annotated

from pydantic import Field, StringConstraints

from sawmill_platform.contracts.base import LARGEST_NUMBER, Name, Stamped, Time
from sawmill_platform.contracts.given import Given

# After its last byte came: whoever comes back after a day sends the file again.
UPLOAD_KEPT = timedelta(days=1)

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
_EXAMPLE_SHA256 = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


class UploadState(StrEnum):
    """How far an upload is."""

    RECEIVING = "receiving"
    """Bytes are missing."""
    COMPLETE = "complete"
    """It can be used."""
    USED = "used"
    """Something was made of it."""


class UploadAsk(Given):
    """A file that is to be sent in parts."""

    size_bytes: int = Field(
        gt=0, le=LARGEST_NUMBER, description="The length of the whole file, in bytes.", examples=[1048576]
    )
    name: Name | None = Field(None, description="What the file is called.", examples=["mill.h5"])
    sha256: Sha256 | None = Field(
        None,
        description="Of the whole file, in hexadecimal digits: what comes out otherwise is refused.",
        examples=[_EXAMPLE_SHA256],
    )


class Upload(Stamped):
    """An upload that can be resumed."""

    name: Name | None = Field(description="What the file is called; null: not given.", examples=["mill.h5"])
    size_bytes: int = Field(description="The length of the whole file, in bytes.", examples=[1048576])
    offset_bytes: int = Field(
        description="The number of bytes that are on the disk: the next part begins there.", examples=[524288]
    )
    sha256: Sha256 | None = Field(
        description="Of the whole file: as given, or computed once it is complete; null before.",
        examples=[_EXAMPLE_SHA256],
    )
    state: UploadState = Field(description="How far it is.", examples=["receiving"])
    used_by: str | None = Field(
        description="The path of what was made of it; null: nothing yet.", examples=["/v1/scans/example"]
    )
    expires_at: Time = Field(
        description="When it is removed; each part that comes puts that off.", examples=["2026-03-03T05:00:00Z"]
    )
