"""Regular expressions of texts in the contract, in the dialects of ECMA 262, as in JSON Schema, and Python.

The expressions are for clients and generated code. The function that reads a text decides whether it is accepted.
"""

# Control characters, line separators, and Unicode's format characters (category Cf), which are not seen or change the
# direction of the text after them, so two names would look the same. Format characters beyond the first plane are in
# `sawmill_platform.contracts.given` alone.
NOT_SHOWN = (
    r"\x00-\x1f\x7f-\x9f\u00ad\u0600-\u0605\u061c\u06dd\u070f\u0890\u0891\u08e2\u180e\u200b-\u200f\u2028-\u202e"
    r"\u2060-\u206f\ufeff\ufff9-\ufffb"
)
# Texts that `sawmill_platform.contracts.given` accepts: characters that can be shown, in one line. A name is not blank.
LINE = rf"^[^{NOT_SHOWN}]*$"
NAME = rf"^[^{NOT_SHOWN}]*[^\s{NOT_SHOWN}][^{NOT_SHOWN}]*$"

# The `next` of a list by time, of one by number, and of one by time and number.
CURSOR = r"^[0-9]{1,17}\.[a-z0-9][a-z0-9-]{0,63}$"
_NUMBER = r"(?:[0-9]{1,9}|1[0-9]{9}|20[0-9]{8}|21[0-3][0-9]{7})"
NUMBERED_CURSOR = rf"^{_NUMBER}$"
HISTORY_CURSOR = rf"^[0-9]{{1,17}}\.{_NUMBER}$"


def _field(value: str, more: str = "") -> str:
    """Build the expression of a cron field: `*`, values and ranges, each with a step, with commas between them."""
    term = rf"(?:(?:\*|(?:{value})(?:-(?:{value}))?)(?:/[1-9][0-9]?)?{more})"
    return f"{term}(?:,{term})*"


# A cron expression as cronsim reads it; no expression states that a range ascends, or that the day exists in the month.
CRON = " ".join(
    (
        "^" + _field("[1-5]?[0-9]"),
        _field("1?[0-9]|2[0-3]"),
        _field("[1-9]|[12][0-9]|3[01]", "|LW?"),
        _field("[1-9]|1[0-2]|JAN|FEB|MAR|APR|MAY|JUN|JUL|AUG|SEP|OCT|NOV|DEC"),
        _field("[0-7]|SUN|MON|TUE|WED|THU|FRI|SAT", "|[0-7](?:L|#[1-5])") + "$",
    )
)

# A name in the tz database; no expression states that the zone exists.
TIME_ZONE = "^[A-Za-z0-9_+/-]*$"

# A webhook's URL, without anything that two programs could read differently. JSON Schema has no named groups.
_HOST, _TARGET = r"[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]", r"[/?][A-Za-z0-9._~!$&'()*+,;=:@%/?-]*"
# A port, from 1 to 65535.
PORT = "[1-9][0-9]{0,3}|[1-5][0-9]{4}|6[0-4][0-9]{3}|65[0-4][0-9]{2}|655[0-2][0-9]|6553[0-5]"
WEBHOOK_URL = rf"(?P<scheme>https?)://(?P<host>{_HOST})(?::(?P<port>{PORT}))?(?P<target>{_TARGET})?"
WEBHOOK_URL_SCHEMA = rf"^https?://({_HOST})(:({PORT}))?({_TARGET})?$"
# The `what` of an event, or its beginning with a star.
EVENT_NAME = r"^([a-z-]+\*?|\*)$"
