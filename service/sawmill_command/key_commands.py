"""`sawmill key` and `sawmill audit`: permissions and past actions, on the machine that holds the data folder."""
# ruff: noqa: PLC0415, FBT002 - imports inside the commands: a command loads only its libraries; flags are booleans

import getpass
import re
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sawmill_command.data_option import Data, storage_settings
from sawmill_platform.contracts.keys import Key, KeyRequest, NewKey, Scope
from sawmill_worker.commands.terminal import Command, print_json, say

if TYPE_CHECKING:
    from sawmill_store.store import Store

app = typer.Typer()
key_app = typer.Typer(no_args_is_help=True)
app.add_typer(key_app, name="key")

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
KeyId = Annotated[str, typer.Argument(help="The key's id, as listed.", metavar="KEY_ID")]

_AHEAD = re.compile(r"([0-9]{1,6})([hdw])")
_UNITS = {"h": "hours", "d": "days", "w": "weeks"}


def _expiry(text: str) -> datetime:
    """Parse a period from now as in 90d, or a date or time of RFC 3339; a date begins at midnight UTC."""
    try:
        if ahead := _AHEAD.fullmatch(text):
            return datetime.now(UTC) + timedelta(**{_UNITS[ahead[2]]: int(ahead[1])})
        moment = datetime.fromisoformat(text)
    except (ValueError, OverflowError):
        moment = None
    if moment is None or (moment.tzinfo is None and len(text) > len("2030-01-01")):
        raise typer.BadParameter(f"must be as in 12h, 90d, 52w, 2030-01-01 or 2030-01-01T06:00:00Z, not {text!r}")
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


@key_app.callback()
def key() -> None:
    """Make, list, rotate and revoke keys, which decide who may do what."""


@key_app.command(cls=Command)
def create(
    name: Annotated[str, typer.Option(help="Whose it is: a person or a program.")],
    scope: Annotated[Scope, typer.Option(help="What it may do; each may do what those before it may.")],
    expires: Annotated[
        datetime | None,
        typer.Option(parser=_expiry, metavar="TIME", help="As in 12h, 90d, 52w or 2030-01-01 (UTC); never otherwise."),
    ] = None,
    display: Annotated[
        bool, typer.Option("--display", help="For a display on the wall: it stays logged in. Scope read alone.")
    ] = False,
    url: Annotated[
        str | None,
        typer.Option(
            help="Address of the service for a display, which it opens by a QR code.", envvar="SAWMILL_PUBLIC_URL"
        ),
    ] = None,
    data: Data = None,
    as_json: AsJson = False,
) -> None:
    """Make a key and print its secret, which is shown this once; for a display also a link, as a QR code."""
    from sawmill_worker.commands.from_contract import wrong_use

    with wrong_use():
        ask = KeyRequest(name=name, scope=scope, expires_at=expires, display=display)
    with opened(data) as store:
        made = store.keys.create(ask)
        _show(made, as_json=as_json)
        if display and url is not None:
            import segno

            link = f"{url.rstrip('/')}/login/{store.sessions.invite(made.id)}"
            say(f"The display opens this link within ten minutes, once: {link}")
            segno.make_qr(link).terminal(out=sys.stderr, compact=True)
        elif display:
            say("With --url ADDRESS or SAWMILL_PUBLIC_URL, a link for the display would be printed as a QR code.")


@key_app.command("list", cls=Command)
def list_keys(data: Data = None, as_json: AsJson = False) -> None:
    """List all keys, newest first, with their last use."""
    with opened(data) as store:
        keys = store.keys.all()
    if as_json:
        print_json({"items": [key.model_dump(mode="json") for key in keys], "next": None})
        return
    for key in keys:
        used = "never used" if key.last_used_at is None else f"used {key.last_used_at:%Y-%m-%d %H:%M} UTC"
        typer.echo(f"{key.id}  {key.scope:8}  {_standing(key):30}  {used:27}  {key.name}")
    if not keys:
        say("There is no key yet: sawmill key create --name NAME --scope SCOPE makes one.")


@key_app.command(cls=Command)
def rotate(
    key_id: KeyId,
    grace_s: Annotated[
        int, typer.Option(min=0, max=30 * 86400, help="Seconds for which the old secret still opens.")
    ] = 0,
    data: Data = None,
    as_json: AsJson = False,
) -> None:
    """Replace a key's secret and print the new one, which is shown this once."""
    with opened(data) as store:
        _show(store.keys.rotate(key_id, grace_s=grace_s), as_json=as_json)


@key_app.command(cls=Command)
def revoke(key_id: KeyId, data: Data = None) -> None:
    """End a key, and the sessions that it opened, at once."""
    with opened(data) as store:
        key = store.keys.revoke(key_id)
    say(f"The key of {key.name!r} opens nothing any more.")


@app.command(cls=Command)
def audit(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", dir_okay=False, help="File to write; standard output otherwise.")
    ] = None,
    data: Data = None,
) -> None:
    """Write who did what, the oldest first, one JSON object a line."""
    with opened(data) as store, nullcontext(sys.stdout) if output is None else output.open("w") as file:
        file.writelines(f"{entry.model_dump_json()}\n" for entry in store.audit.all())


@contextmanager
def opened(data: Path | None) -> Iterator["Store"]:
    """Open the store of a data folder, in which actions are recorded with the name of the calling user."""
    from sawmill_platform.errors import StorageError
    from sawmill_platform.ledger.events import Actor, acting_as
    from sawmill_store.store import Store

    settings = storage_settings(data)
    try:
        with closing(Store.open(settings)) as store, acting_as(Actor(f"{getpass.getuser()} on the command line")):
            yield store
    except (StorageError, OSError) as error:
        say(str(error), trouble="Nothing was changed")
        raise typer.Exit(1) from error


def _show(key: NewKey, *, as_json: bool) -> None:
    """Print only the secret on standard output, so that a program can read it."""
    if as_json:
        print_json(key.model_dump(mode="json"))
        return
    say(f"Key {key.id} of {key.name!r}, scope {key.scope}. Its secret is shown this once:")
    typer.echo(key.secret)


def _standing(key: Key) -> str:
    if key.revoked_at is not None:
        return f"revoked {key.revoked_at:%Y-%m-%d}"
    if key.expires_at is None:
        return "never expires"
    ended = key.expires_at <= datetime.now(UTC)
    return f"{'expired' if ended else 'expires'} {key.expires_at:%Y-%m-%d %H:%M} UTC"
