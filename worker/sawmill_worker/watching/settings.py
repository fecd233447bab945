"""Settings of `sawmill watch` in a TOML file: address of the service, folders, and the files in the folders."""

import json
import re
import tomllib
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    StringConstraints,
    ValidationError,
    field_validator,
    model_validator,
)

from sawmill_contracts.row_ranges import Rows
from sawmill_contracts.scans import ScanFileOptions
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given, shown
from sawmill_platform.contracts.jobs import Priority

TAKEN = "taken"
# Prefix of pydantic's sentences.
_ORDINARY = re.compile(r"value error, |input (?=should )", re.IGNORECASE)


class WrongFileError(Exception):
    """A file that describes no watched folders; the sentence names the key, or the line that is not TOML."""


def _absolute(text: str) -> str:
    if not text.startswith("/"):
        msg = f"must be an absolute path, as in /srv/scanner-2, not {text!r}"
        raise ValueError(msg)
    return text


def _url(text: str) -> str:
    parts = urlsplit(text)
    _ = parts.port  # raises ValueError for an invalid port
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment or parts.username:
        msg = f"must be the service's address, as in https://sawmill.example or http://127.0.0.1:8000, not {text!r}"
        raise ValueError(msg)
    return text.rstrip("/")


Text = Annotated[str, StringConstraints(min_length=1, max_length=4096)]
AbsolutePath = Annotated[Text, AfterValidator(_absolute)]
# TOML has no null.
FalseIsNone = BeforeValidator(lambda value: None if value is False else value)
Seconds = Annotated[float, Field(gt=0, le=86_400)]


class Files(ScanFileOptions, Given):
    """Files of one kind, and the parameters of `POST /v1/scans` for each file."""

    match: Annotated[str, StringConstraints(min_length=1, max_length=200)] = Field(
        description="Names, with * for any letters, ? for one and [...] for one of several.", examples=["phantom-*.h5"]
    )
    phantom_id: Identifier | None = Field(None, description="The phantom in each; left out for logs.")
    phantom_rows: Rows | None = Field(None, description="The rows that show the phantom; left out: they are found.")
    priority: Priority = Field(Priority.WAITED_FOR, description="How urgent their reading is.")

    @field_validator("match")
    @classmethod
    def _is_of_names(cls, pattern: str) -> str:
        if "/" in pattern:
            msg = f"must match names in the folder itself, so without /, not {pattern!r}"
            raise ValueError(msg)
        return pattern

    def query(self, scanner_id: str, name: str) -> dict[str, str]:
        """Return the query of `POST /v1/scans` for a file of this name."""
        options = self.model_dump(mode="json", exclude={"match"}, exclude_none=True, exclude_unset=True)
        return {**options, "scanner_id": scanner_id, "name": scan_name(name)}


class WatchedFolder(Given):
    """A folder into which one scanner writes."""

    folder: AbsolutePath = Field(description="Absolute path.", examples=["/srv/scanner-2"])
    scanner_id: Identifier = Field(description="Whose scans they are.", examples=["line-2"])
    files: list[Files] = Field(min_length=1, description="The first that matches a name counts.")
    done_suffix: Annotated[
        Annotated[str, StringConstraints(pattern=r"^[.\w-]{1,40}$")] | None,
        FalseIsNone,
        Field(description="A file NAME.done beside NAME marks it as whole; false: there are none."),
    ] = ".done"
    still_for_s: Annotated[
        Seconds | None,
        FalseIsNone,
        Field(
            description="A file is whole when its size and time stand still for so long; false: with NAME.done only."
        ),
    ] = 10.0
    done: Text = Field("done", description="Where files go that the service has read; absolute, or in the folder.")
    refused: Text = Field("refused", description="Where the others go, with the reason.")

    @model_validator(mode="after")
    def _can_be_whole(self) -> Self:
        if self.done_suffix is None and self.still_for_s is None:
            msg = "give done_suffix or still_for_s: without either no file is ever known to be whole"
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _has_places(self) -> Self:
        places = [self.done_folder, self.refused_folder, self.taken_folder]
        if len({str(place.resolve()) for place in (*places, self.path)}) <= len(places):
            msg = f"done, refused and {TAKEN}/ must be three folders, and none the watched one: not {places}"
            raise ValueError(msg)
        return self

    @property
    def path(self) -> Path:
        """Path of the folder."""
        return Path(self.folder)

    @property
    def taken_folder(self) -> Path:
        """Folder of a file from the moment of the taking until its destination is known."""
        return self.path / TAKEN

    @property
    def done_folder(self) -> Path:
        """Folder of files that the service has read."""
        return self.path / self.done

    @property
    def refused_folder(self) -> Path:
        """Folder of files that were refused."""
        return self.path / self.refused

    def files_named(self, name: str) -> Files | None:
        """Return the first rule that matches a name; None if no rule does."""
        return next((rule for rule in self.files if fnmatchcase(name, rule.match)), None)


class Watching(Given):
    """Settings of all watched folders: the whole file."""

    service: Annotated[Text, AfterValidator(_url)] = Field(
        description="Where the service answers.", examples=["https://sawmill.example"]
    )
    key_file: AbsolutePath | None = Field(
        None, description="A file with a key of scope submit; left out: the service asks for none on this machine."
    )
    ca_file: AbsolutePath | None = Field(
        None, description="Certificates (PEM) that vouch for the service; left out: those that this machine trusts."
    )
    poll_s: Seconds = Field(5.0, description="How often folders are looked at.")
    folders: list[WatchedFolder] = Field(min_length=1, description="One each scanner, or more.")

    @model_validator(mode="after")
    def _watches_each_once(self) -> Self:
        seen: set[Path] = set()
        for each in self.folders:
            path = each.path.resolve()
            if path in seen:
                msg = f"{each.folder!r} stands here twice: give one folder all its files"
                raise ValueError(msg)
            seen.add(path)
        return self


def scan_name(name: str) -> str:
    """Return the name of a scan from its file's name: one line of at most 200 characters."""
    return shown(name)[:200].strip() or "scan"


def read_settings(path: Path) -> Watching:
    """Read the settings in a file.

    Raises
    ------
    WrongFileError
        A sentence per line: the key, its value and what would be right; or the line that is not TOML.
    """
    if path.suffix.lower() in {".yaml", ".yml"}:
        toml = path.with_suffix(".toml")
        raise WrongFileError(f"{path}: write {toml} instead, in TOML as docs/do/watched-folder.md shows")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        # JSON has no dates and times, and a text must be in quotes.
        sent = json.dumps(document, default=lambda moment: {"date or time": str(moment)})
    except OSError as error:
        raise WrongFileError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise WrongFileError(f"{path} is no text in UTF-8: byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise WrongFileError(f"{path} is no TOML: {error}") from error
    except RecursionError as error:
        raise WrongFileError(f"{path} has too many levels: write it as docs/do/watched-folder.md shows") from error
    try:
        return Watching.model_validate_json(sent, strict=True)
    except ValidationError as error:
        raise WrongFileError("\n".join(f"{path}: {_sentence(fault)}" for fault in error.errors())) from error


def _sentence(fault: Any) -> str:  # noqa: ANN401 - pydantic's own type of a fault
    place: tuple[str | int, ...] = fault["loc"]
    name = ".".join(str(part) for part in place)
    if fault["type"] == "extra_forbidden":
        fields = _KNOWN.get(len(place), ())
        near = get_close_matches(str(place[-1]), fields, n=1)
        return f"{name} is not a known field" + (f": {near[0]!r} is" if near else f"; known are {', '.join(fields)}")
    if fault["type"] == "missing":
        return f"{name} is missing"
    sentence = _ORDINARY.sub("", fault["msg"])
    if "not " in sentence:
        return f"{name}: {sentence}" if name else sentence
    return f"{name}: {sentence[:1].lower()}{sentence[1:]}, not {fault['input']!r:.100}"


# Known fields, by their depth in the file.
_KNOWN = {
    1: tuple(Watching.model_fields),
    3: tuple(WatchedFolder.model_fields),
    5: tuple(Files.model_fields),
}
