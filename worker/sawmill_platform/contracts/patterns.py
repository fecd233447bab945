"""What texts look like, as regular expressions in the contract: ECMA 262's, as JSON Schema has them, and Python's.

They are for clients, and for what is generated from the contract. What is accepted is decided where a text is read.
"""

# `sawmill_platform.contracts.base.parse_span` reads them; no expression states that A is less than B.
ROWS = r"^[0-9]{1,9}:[1-9][0-9]{0,8}$"
STEPPED_ROWS = r"^[0-9]{1,9}:[1-9][0-9]{0,8}(:[1-9][0-9]{0,8})?$"

# Control characters, line separators, and Unicode's format characters (category Cf), which are not seen or change the
# direction of what follows them, so two names would look the same. Of the planes beyond the first they stand in
# `sawmill_platform.contracts.given` alone.
NOT_SHOWN = (
    r"\x00-\x1f\x7f-\x9f\u00ad\u0600-\u0605\u061c\u06dd\u070f\u0890\u0891\u08e2\u180e\u200b-\u200f\u2028-\u202e"
    r"\u2060-\u206f\ufeff\ufff9-\ufffb"
)
# What `sawmill_platform.contracts.given` lets pass: characters that can be shown, in one line. A name is not blank.
LINE = rf"^[^{NOT_SHOWN}]*$"
NAME = rf"^[^{NOT_SHOWN}]*[^\s{NOT_SHOWN}][^{NOT_SHOWN}]*$"

# What `sawmill_contracts.reconstructions` takes for a coupling: a word, or a number from 0 to below 100.
COUPLING = r"^(auto|none|[0-9]{1,2}(\.[0-9]{1,6})?)$"

# The `next` of a list by time, of one by number, and of one by time and number.
CURSOR = r"^[0-9]{1,17}\.[a-z0-9][a-z0-9-]{0,63}$"
_NUMBER = r"(?:[0-9]{1,9}|1[0-9]{9}|20[0-9]{8}|21[0-3][0-9]{7})"
NUMBERED_CURSOR = rf"^{_NUMBER}$"
HISTORY_CURSOR = rf"^[0-9]{{1,17}}\.{_NUMBER}$"


def _field(value: str, more: str = "") -> str:
    """Of a cron expression: `*`, values and ranges, each with a step, with commas between them."""
    term = rf"(?:(?:\*|(?:{value})(?:-(?:{value}))?)(?:/[1-9][0-9]?)?{more})"
    return f"{term}(?:,{term})*"


# Of cronsim: that a range ascends, and that the day exists in the month, no expression states.
CRON = " ".join(
    (
        "^" + _field("[1-5]?[0-9]"),
        _field("1?[0-9]|2[0-3]"),
        _field("[1-9]|[12][0-9]|3[01]", "|LW?"),
        _field("[1-9]|1[0-2]|JAN|FEB|MAR|APR|MAY|JUN|JUL|AUG|SEP|OCT|NOV|DEC"),
        _field("[0-7]|SUN|MON|TUE|WED|THU|FRI|SAT", "|[0-7](?:L|#[1-5])") + "$",
    )
)

# A name in the tz database: whether there is one of it, no expression states.
TIME_ZONE = "^[A-Za-z0-9_+/-]*$"

# A webhook's URL: nothing in it that two programs could read in two ways. JSON Schema has no named groups.
_HOST, _PORT, _TARGET = r"[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]", "[0-9]{1,5}", r"[/?][A-Za-z0-9._~!$&'()*+,;=:@%/?-]*"
WEBHOOK_URL = rf"(?P<scheme>https?)://(?P<host>{_HOST})(?::(?P<port>{_PORT}))?(?P<target>{_TARGET})?"
WEBHOOK_URL_SCHEMA = rf"^https?://({_HOST})(:{_PORT})?({_TARGET})?$"
# The `what` of an event, or its beginning with a star.
EVENT_NAME = r"^([a-z-]+\*?|\*)$"
