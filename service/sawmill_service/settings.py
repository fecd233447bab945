"""Settings of the service, given by environment variable or by the command that starts the service."""

import re
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Any, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, SecretStr, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from sawmill_platform.settings import LargestUpload
from sawmill_service.http.limits.rates import check_rate
from sawmill_service.http.listening import is_loopback
from sawmill_service.webhooks.destinations import check_entry

GIB = 2**30
MIB = 2**20
MOST_CONNECTIONS = 10_000
SHORTEST_TOKEN = 32  # characters: 128 bits even in hexadecimal digits


def _check_token(token: SecretStr) -> SecretStr:
    text = token.get_secret_value()
    if len(text) < SHORTEST_TOKEN:
        raise ValueError(f"must have at least {SHORTEST_TOKEN} characters, not {len(text)}")
    if not re.fullmatch(r"[!-~]+", text):
        raise ValueError("must consist of ASCII letters, digits and punctuation, without spaces")
    return token


def _check_url(text: str) -> str:
    url = urlsplit(text)
    if url.scheme not in {"http", "https"} or not url.hostname or url.path.strip("/") or url.query or url.fragment:
        raise ValueError(f"must be as in https://calibration.mill.example, without a path, not {text!r}")
    return text.rstrip("/")


def _check_network(text: str) -> str:
    try:
        ip_network(text)
    except ValueError as error:
        raise ValueError(f"must be IP addresses or networks, as in 127.0.0.1 or 10.0.0.0/8, not {text!r}") from error
    return text


class NetworkSettings(BaseSettings):
    """Network and access."""

    host: str = Field(
        "127.0.0.1", description="Address to listen on. Beyond loopback the service starts only with a key or a token."
    )
    port: Annotated[int, Field(ge=0, le=65535)] = Field(8000, description="TCP port; 0 takes a free one.")
    allowed_hosts: list[str] = Field(
        [],
        description="Host names (JSON list) by which clients may call the service, in addition to `host` and, from "
        "this machine, loopback: a page elsewhere must not reach it through a name of its own (DNS rebinding).",
    )
    public_url: Annotated[str, AfterValidator(_check_url)] | None = Field(
        None,
        description="Address by which browsers reach the service through a reverse proxy, as "
        "`https://calibration.mill.example`; its host is allowed, and every request must bring a key. Null: there is "
        "no proxy.",
    )
    trusted_proxies: list[Annotated[str, AfterValidator(_check_network)]] = Field(
        [],
        description="Addresses or networks of reverse proxies (JSON list), whose `X-Forwarded-For` and "
        "`X-Forwarded-Proto` are believed; every request must bring a key.",
    )
    token: Annotated[SecretStr, AfterValidator(_check_token)] | None = Field(
        None,
        description="The first administrator's key, which requests bring as a bearer token or as the password of HTTP "
        "Basic: at least 32 characters. Null: keys alone (`sawmill key`), and on loopback none is needed.",
    )
    token_file: Path | None = Field(None, description="File that holds the token, instead of `SAWMILL_TOKEN`.")
    failed_login_rate_limit: Annotated[str, AfterValidator(check_rate)] = Field(
        "20/minute", description="Different wrong keys of one address; further ones get 429."
    )
    webhook_destinations: list[Annotated[str, AfterValidator(check_entry)]] = Field(
        [],
        description="Destinations of webhooks (JSON list): names, with a port unless it is 443 or 80, and networks, "
        "for addresses that are not public and for http. Empty: nothing is sent anywhere.",
    )


class UploadSettings(LargestUpload):
    """Uploads."""

    max_picture_bytes: Annotated[int, Field(gt=0)] = Field(
        32 * MIB, description="Bytes of one phantom picture: a photograph-sized PNG has less."
    )
    max_json_bytes: Annotated[int, Field(gt=0)] = Field(
        MIB, description="Bytes of any other body: a phantom with 20 000 corners has less."
    )
    max_waiting_uploads: Annotated[int, Field(gt=0)] = Field(
        100,
        description="Number of one key's uploads in parts that are not used yet; "
        "an upload is deleted a day after its last part.",
    )
    max_waiting_upload_bytes: Annotated[int, Field(gt=0)] = Field(
        16 * GIB, description="Declared bytes of one key's uploads in parts that are not used yet."
    )
    max_all_waiting_upload_bytes: Annotated[int, Field(gt=0)] = Field(
        64 * GIB, description="Declared bytes of all keys' uploads in parts that are not used yet."
    )
    client_silence_s: Annotated[float, Field(gt=0)] = Field(
        60.0, description="Longest pause within a body, and of a client that takes nothing of a picture or an array."
    )
    min_client_bytes_per_s: Annotated[float, Field(ge=0)] = Field(
        1000.0, description="Smallest mean rate of a body after `body_grace_s`."
    )
    body_grace_s: Annotated[float, Field(ge=0)] = Field(
        30.0, description="Time from the start of a body until its rate counts."
    )


class ClientSettings(BaseSettings):
    """Limits of clients."""

    rate_limit: Annotated[str, AfterValidator(check_rate)] = Field(
        "6000/minute",
        description="Requests of one key, or of one address without a key, as in `1200/minute; 100/second`.",
    )
    change_rate_limit: Annotated[str, AfterValidator(check_rate)] = Field(
        "600/minute", description="Those requests of `rate_limit` that make, change or delete something."
    )
    max_requests_at_once: Annotated[int, Field(ge=1)] = Field(
        32, description="Requests of one key or address at once, until their answers begin: the API has 40 threads."
    )
    max_bodies_at_once: Annotated[int, Field(ge=1)] = Field(
        200,
        description="Requests with a body of one key or address at once; each holds no thread until its body has come.",
    )
    max_waits_at_once: Annotated[int, Field(ge=1)] = Field(
        256,
        description="Requests of one key or address at once that wait for a job (`wait`), or for memory "
        "(`drawing_memory_bytes`); each holds no thread while it waits.",
    )
    drawing_memory_bytes: Annotated[int, Field(ge=64 * MIB)] = Field(
        512 * MIB,
        description="Memory of all pictures and arrays that are being made or sent, all copies included; half of it "
        "for one key or address. Others wait. A slice of 4096 x 4096 takes up to 240 MiB, the rest of the service "
        "200 MB: together they fit into 1 GB.",
    )
    max_streams: Annotated[int, Field(ge=1)] = Field(
        64, description="Streams of events in all; a stream of a job reads the job several times a second."
    )
    max_connections: Annotated[int, Field(ge=1, le=MOST_CONNECTIONS)] = Field(
        1024,
        description="From this number of open connections on, idle ones and streams included, requests get a plain "
        "503. One caller at its bounds has 488 (`max_requests_at_once`, `max_bodies_at_once`, `max_waits_at_once`): "
        "two such callers have room.",
    )
    retry_after_s: Annotated[int, Field(ge=1)] = Field(
        1, description="Seconds that a client is asked to wait before it polls: most jobs take a few."
    )
    event_poll_s: Annotated[float, Field(gt=0)] = Field(
        0.25,
        description="Longest time between two reads of a job whose events are streamed; "
        "the first reads come after a tenth of the time waited.",
    )


class ServiceSettings(NetworkSettings, UploadSettings, ClientSettings):
    """Addresses on which the service listens, and limits of what it accepts; `SAWMILL_PORT=8080` sets `port`."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", frozen=True, hide_input_in_errors=True)

    @model_validator(mode="before")
    @classmethod
    def _read_token(cls, values: dict[str, Any]) -> dict[str, Any]:
        if values.get("token_file") is None:
            return values
        if values.get("token") is not None:
            raise ValueError("give SAWMILL_TOKEN or SAWMILL_TOKEN_FILE, not both")
        try:
            return {**values, "token": Path(values["token_file"]).read_text().strip()}
        except (OSError, UnicodeDecodeError) as error:
            raise ValueError(f"SAWMILL_TOKEN_FILE cannot be read: {error}") from error

    @model_validator(mode="after")
    def _check_streams_leave_connections(self) -> Self:
        if self.max_connections <= self.max_streams:
            raise ValueError(
                f"max_connections must be above max_streams ({self.max_streams}): each stream is a connection"
            )
        return self

    @property
    def names(self) -> list[str]:
        """Names by which clients may call from anywhere: `host`, unless it means every address, and allowed names."""
        host = urlsplit(self.public_url or "").hostname
        public = [f"[{host}]" if ":" in host else host] if host else []
        return [*self._own_name(), *public, *self.allowed_hosts]

    @property
    def behind_proxy(self) -> bool:
        """True if requests come through a proxy, so that all of them come from the proxy's address."""
        return self.public_url is not None or bool(self.trusted_proxies)

    @property
    def may_be_reached(self) -> bool:
        """True if other machines can send requests, as far as the settings show."""
        try:
            return self.behind_proxy or not is_loopback(self.host)
        except ValueError:  # a name
            return self.host != "localhost"

    def _own_name(self) -> list[str]:
        try:
            address = ip_address(self.host)
        except ValueError:  # a name
            return [self.host]
        return [] if address.is_unspecified else [self.host if address.version == 4 else f"[{self.host}]"]
