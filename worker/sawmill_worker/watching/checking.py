"""`sawmill watch --check`: what a watcher would do; no file is taken or sent, and no folder is made."""

import os
from collections.abc import Iterator

from sawmill_platform.contracts.keys import Scope
from sawmill_platform.workers.kernel_lock import holder_of
from sawmill_worker.watching.folder import LOCK
from sawmill_worker.watching.looks import Looks
from sawmill_worker.watching.news import News
from sawmill_worker.watching.service import Json, Refusal, RequestFails, Service, ServiceWaits, speaks_openly
from sawmill_worker.watching.settings import WatchedFolder, Watching

CheckResult = tuple[bool, str]


def findings(watching: Watching, service: Service) -> Iterator[CheckResult]:
    """Yield sentences, each with whether all is well."""
    try:
        yield from _of_service(watching, service)
    except (ServiceWaits, Refusal, RequestFails) as trouble:
        yield False, f"{watching.service}: {trouble}"
    for folder in watching.folders:
        try:
            yield from _of_folder(folder)
        except OSError as error:
            yield False, f"{folder.folder}: {error}"


def _of_service(watching: Watching, service: Service) -> Iterator[CheckResult]:
    key = service.get("/v1/keys/own")
    enough = Scope(key["scope"]).covers(Scope.SUBMIT)
    needed = "" if enough else f", and {Scope.SUBMIT.value} is needed"
    yield enough, f"{watching.service} answers {key['name']!r}, whose scope is {key['scope']}{needed}"
    if watching.key_file is not None and speaks_openly(watching.service):
        yield False, f"{watching.service} takes the key over the network as everybody can read it: use https"
    for scanner_id in sorted({folder.scanner_id for folder in watching.folders}):
        yield _named(service, "scanner", scanner_id)
    phantom_ids = {rule.phantom_id for folder in watching.folders for rule in folder.files if rule.phantom_id}
    for phantom_id in sorted(phantom_ids):
        yield _named(service, "phantom", phantom_id)


def _named(service: Service, noun: str, identifier: str) -> CheckResult:
    row = service.found(f"/v1/{noun}s/{identifier}", f"{noun}-not-found")
    if row is not None:
        return True, f"{noun} {identifier} is {row['name']!r}"
    items: list[Json] = service.get(f"/v1/{noun}s")["items"]
    newest = ", ".join(f"{item['id']} ({item['name']})" for item in items)
    return False, f"there is no {noun} {identifier!r}; the newest are {newest or 'none'}"


def _of_folder(settings: WatchedFolder) -> Iterator[CheckResult]:
    name = settings.folder
    if not settings.path.is_dir():
        yield False, f"{name} is not there, or no folder"
        return
    writable = os.access(settings.path, os.R_OK | os.W_OK | os.X_OK)
    yield writable, f"{name} can {'' if writable else 'not '}be read and written by this user"
    if (process := holder_of(settings.taken_folder / LOCK)) is not None:
        yield True, f"{name} is watched by process {process} now"
    looks = Looks(settings, News())
    looks.look()
    for file in sorted({*looks.whole, *looks.growing}):
        rule = settings.files_named(file)
        assert rule is not None  # noqa: S101 - only matching files are listed
        parameters = " ".join(f"{field}={value}" for field, value in rule.query(settings.scanner_id, file).items())
        yield True, f"{name}/{file} would be sent with {parameters}"
    yield True, f"{name}: {len(looks.whole) + len(looks.growing)} file(s) would be taken once they are whole"
