"""Who may send requests: whoever brings the token."""

import hmac
from base64 import b64decode

from pydantic import SecretStr

from sawmill_service.problems import Refused

# One header each: browsers do not look for a second challenge within one.
CHALLENGES = ('Basic realm="sawmill-calibration", charset="UTF-8"', 'Bearer realm="sawmill-calibration"')
# Monitoring needs no token: these report the service's state alone.
OPEN_PATHS = frozenset({"/health/live", "/health/ready"})


def check_token(token: SecretStr, authorization: str) -> None:
    """Refuse a request whose `Authorization` does not bring the token; "" stands for none."""
    presented = _presented(authorization)
    if not hmac.compare_digest(presented, token.get_secret_value().encode()):
        problem = "is not that of this service" if presented else "is missing"
        raise Refused(
            401,
            "token-required",
            f"the token {problem}: send Authorization: Bearer TOKEN, or in a browser TOKEN as the password",
        )


def _presented(authorization: str) -> bytes:
    """What a header holds as a token: a bearer's, or the password of HTTP Basic, whoever the user is."""
    scheme, _, credentials = authorization.partition(" ")
    if scheme.lower() == "bearer":
        return credentials.strip().encode("latin-1")
    if scheme.lower() == "basic":
        try:
            return b64decode(credentials, validate=True).partition(b":")[2]
        except ValueError:  # no base64, or no ASCII at all
            return b""
    return b""
