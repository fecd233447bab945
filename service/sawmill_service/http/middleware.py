"""Base of all middleware: requests are handled, and the start and the end of the service pass by."""

from starlette.types import ASGIApp, Receive, Scope, Send


class Middleware:
    """Middleware that handles the requests of HTTP in `_answer`."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        await (self._answer if scope["type"] == "http" else self.app)(scope, receive, send)

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        raise NotImplementedError
