"""Limits for each caller: requests in a span of time, requests at once, and streams."""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.http.bodies.sent_content import has_body
from sawmill_service.http.gate import SAFE_METHODS
from sawmill_service.http.limits.rates import Rates, too_many, who
from sawmill_service.http.middleware import Middleware
from sawmill_service.http.problems import Refused, refusal_response
from sawmill_service.http.route_rules import NoKey, no_key
from sawmill_service.settings import ServiceSettings

_MOST_HEADERS = 100
_MOST_HEAD_BYTES = 20 * 2**10
# One stream in this many is kept for displays on the wall, whose keys serve no other purpose.
_SHARE_OF_DISPLAYS = 4
# Places become free as answers begin, most of them within a second.
_RETRY_S = 2
# Ends of the paths of pictures and arrays, which wait for memory.
_DRAWN = (".png", ".jpg", ".svg", ".npy", ".tif", ".nrrd", "/preview")


class RequestPlaces:
    """Counter of requests that are being answered, bounded for each name."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()

    @contextmanager
    def one(self, name: str, most: int, detail: str) -> Iterator[None]:
        """Hold a place within the block, or refuse with a sentence."""
        if self._taken[name] >= most:
            raise too_many(detail, _RETRY_S)
        self._taken[name] += 1
        try:
            yield
        finally:
            self._taken[name] -= 1
            if not self._taken[name]:
                del self._taken[name]


class Admission(Middleware):
    """Middleware that refuses requests beyond a caller's rates, and beyond the number that it may have open at once.

    Without that, one caller could hold all threads. A request counts until its answer begins: from then on, only the
    client is waited for. A stream of events counts until its end. Requests with a body are counted apart, so that slow
    uploads do not keep short requests out. So are requests that wait for a job or for memory, and checks of health.
    """

    def __init__(self, app: ASGIApp, *, settings: ServiceSettings) -> None:
        super().__init__(app)
        self._all, self._changes = Rates(settings.rate_limit), Rates(settings.change_rate_limit)
        at_once = settings.max_requests_at_once
        self._at_once = {
            "requests": at_once,
            "streams": at_once,
            "uploads": settings.max_bodies_at_once,
            "waits": settings.max_waits_at_once,
        }
        self._streams = settings.max_streams
        self._places = RequestPlaces()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        with ExitStack() as place:
            headers = Headers(scope=scope)
            try:
                self._check_rates(scope)
                self._take_places(scope, headers, place)
            except Refused as refused:
                await refusal_response(scope["path"], refused)(scope, receive, send)
                return

            async def send_started(message: Message) -> None:
                if message["type"] == "http.response.start" and not _is_stream(scope):
                    place.close()
                await send(message)

            await self.app(scope, receive, send_started)

    def _check_rates(self, scope: Scope) -> None:
        if len(scope["headers"]) > _MOST_HEADERS:
            raise Refused(431, "too-many-headers", f"a request may have {_MOST_HEADERS} headers")
        lengths = (len(name) + len(value) for name, value in scope["headers"])
        if len(scope["path"]) + len(scope["query_string"]) + sum(lengths) > _MOST_HEAD_BYTES:
            raise Refused(
                431, "head-too-large", f"the path, the query and the headers may have {_MOST_HEAD_BYTES} bytes together"
            )
        caller = who(scope)
        self._all.take("looks at health" if no_key(scope) is NoKey.MONITORING else "requests", caller)
        if scope["method"] not in SAFE_METHODS:
            self._changes.take("changes", caller)

    def _take_places(self, scope: Scope, headers: Headers, place: ExitStack) -> None:
        caller = who(scope)
        kind = _kind(scope, headers)
        if kind == "streams":
            advice = "close one, or ask now and then instead"
            detail = f"{self._streams} streams of events are open: {advice}"
            place.enter_context(self._places.one("all streams", self._streams, detail))
            if not scope["state"]["caller"].display:
                most = self._streams - self._streams // _SHARE_OF_DISPLAYS
                detail = f"{most} streams of events are open, and the others are for displays: {advice}"
                place.enter_context(self._places.one("streams but those of displays", most, detail))
        detail = f"{self._at_once[kind]} {kind} of {caller} are being answered: wait for one of them"
        place.enter_context(self._places.one(f"{kind} {caller}", self._at_once[kind], detail))


def _kind(scope: Scope, headers: Headers) -> str:
    if has_body(headers):
        return "uploads"
    if _is_stream(scope):
        return "streams"
    return "waits" if _waits(scope) else "requests"


def _waits(scope: Scope) -> bool:
    """Return whether a request may wait for memory, or for a job; `wait=0` does not, nor does a refused value."""
    if str(scope["path"]).endswith(_DRAWN):
        return True
    values = parse_qs(scope["query_string"].decode("latin-1")).get("wait", [])
    with suppress(ValueError):
        return any(float(seconds) > 0.0 for seconds in values)
    return False


def _is_stream(scope: Scope) -> bool:
    return str(scope["path"]).endswith("/events")
