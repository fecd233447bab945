"""What of the service can be set, by environment variable or by the command that starts it."""

from typing import Annotated

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

GIB = 2**30
MIB = 2**20


class ServiceSettings(BaseSettings):
    """Where the service listens and what it accepts; `SAWMILL_PORT=8080` sets `port`."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", frozen=True)

    host: str = Field(
        "127.0.0.1", description="Address to listen on. The service has no accounts, so it stays on this machine."
    )
    port: Annotated[int, Field(ge=0, le=65535)] = Field(8000, description="TCP port; 0 takes a free one.")
    allowed_hosts: list[str] = Field(
        [],
        description="Host names (JSON list) by which clients may call it, beside loopback and `host`: "
        "a page elsewhere must not reach it through a name of its own (DNS rebinding).",
    )
    max_upload_bytes: Annotated[int, Field(gt=0)] = Field(
        8 * GIB, description="Bytes of one scan: 360 views x 1000 rows x 2000 cells in float32 are 2.9 GB."
    )
    max_picture_bytes: Annotated[int, Field(gt=0)] = Field(
        32 * MIB, description="Bytes of one phantom picture: a photograph-sized PNG has less."
    )
    max_json_bytes: Annotated[int, Field(gt=0)] = Field(
        MIB, description="Bytes of any other body: a phantom with 20 000 corners has less."
    )
    event_poll_s: Annotated[float, Field(gt=0)] = Field(
        0.25,
        description="Longest time between two looks at a job whose events are streamed; "
        "the first looks come after a tenth of the time waited.",
    )
    retry_after_s: Annotated[int, Field(ge=1)] = Field(
        1, description="Seconds that a client is asked to wait before it polls: most jobs take a few."
    )
