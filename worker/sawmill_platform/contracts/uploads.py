"""Uploads that can be resumed: a file that arrives in parts before a job reads it."""

from datetime import timedelta
from enum import StrEnum
from typing import Annotated

from pydantic import Field, StringConstraints

from sawmill_platform.contracts.base import LARGEST_NUMBER, Name, Stamped, Time
from sawmill_platform.contracts.given import Given

# Counted from the last byte; after a day the client sends the file again.
UPLOAD_KEPT = timedelta(days=1)

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
_EXAMPLE_SHA256 = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


class UploadState(StrEnum):
    """State of an upload."""

    RECEIVING = "receiving"  # bytes are missing
    COMPLETE = "complete"  # the upload can be used
    USED = "used"  # something was made from the upload


class UploadRequest(Given):
    """A file to be sent in parts."""

    size_bytes: int = Field(gt=0, le=LARGEST_NUMBER, description="Length of the whole file, bytes.", examples=[1048576])
    name: Name | None = Field(None, description="Name of the file. Null: not given.", examples=["measured.h5"])
    sha256: Sha256 | None = Field(
        None,
        description="SHA-256 of the whole file, in hexadecimal digits; a file with another checksum is refused. "
        "Null: not given.",
        examples=[_EXAMPLE_SHA256],
    )


class Upload(Stamped):
    """An upload that can be resumed."""

    name: Name | None = Field(description="Name of the file; null: not given.", examples=["measured.h5"])
    size_bytes: int = Field(description="Length of the whole file, bytes.", examples=[1048576])
    offset_bytes: int = Field(
        description="Number of bytes that are on the disk: the next part begins there.", examples=[524288]
    )
    sha256: Sha256 | None = Field(
        description="SHA-256 of the whole file: as given, or computed once the file is complete; null before.",
        examples=[_EXAMPLE_SHA256],
    )
    state: UploadState = Field(description="State of the upload.", examples=["receiving"])
    used_by: str | None = Field(
        description="Path of what was made from the upload; null: nothing yet.", examples=["/v1/results/example"]
    )
    expires_at: Time = Field(
        description="Time of its removal, RFC 3339, UTC; each part that arrives puts it off.",
        examples=["2026-03-03T05:00:00Z"],
    )
