"""Receive the messages of a webhook on port 8080: docs/do/webhooks.md explains them. `WEBHOOK_SECRET` is the secret."""

import hashlib
import hmac
import json
import os
import time
from base64 import b64decode, b64encode
from http.server import BaseHTTPRequestHandler, HTTPServer

KEY = b64decode(os.environ["WEBHOOK_SECRET"].removeprefix("whsec_"))
LARGEST, TOLERANCE_S = 65536, 300
seen = set()  # a program that is started again keeps them in a file or a database


def is_genuine(headers, body):
    """Tell whether the message is signed with the secret, and its attempt is not old."""
    identifier, seconds = headers.get("webhook-id", ""), headers.get("webhook-timestamp", "")
    if not seconds.isdecimal() or abs(time.time() - int(seconds)) > TOLERANCE_S:
        return False
    right = b64encode(hmac.new(KEY, f"{identifier}.{seconds}.".encode() + body, hashlib.sha256).digest())
    given = [each.partition(",") for each in headers.get("webhook-signature", "").split()]
    return any(version == "v1" and hmac.compare_digest(right, one.encode()) for version, _, one in given)


class Receiver(BaseHTTPRequestHandler):
    """Prints each message once."""

    timeout = 10  # seconds that a silent sender holds up the others

    def do_POST(self):
        """Answer a message, then use it."""
        length = int(self.headers.get("Content-Length", 0))
        body = self.rfile.read(length) if 0 <= length <= LARGEST else b""
        genuine = is_genuine(self.headers, body)
        self.send_response(204 if genuine else 401)
        self.end_headers()
        if genuine and self.headers["webhook-id"] not in seen:
            seen.add(self.headers["webhook-id"])
            message = json.loads(body)
            print(message["timestamp"], message["type"], message["data"]["scanner_id"])


if __name__ == "__main__":
    HTTPServer(("127.0.0.1", 8080), Receiver).serve_forever()
