"""Send the files of a folder of this machine, each once: `python watch_folder.py ADDRESS FOLDER scanner_id=line-2 ...`.

docs/do/watched-folder.md explains it. Further words are fields of `POST /v1/scans`; `SAWMILL_KEY` is the key.
"""

import hashlib
import os
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

ADDRESS, FOLDER, FIELDS = sys.argv[1], Path(sys.argv[2]), dict(word.split("=", 1) for word in sys.argv[3:])
STILL_FOR_S = float(os.environ.get("STILL_FOR_S", "10"))


def send(file):
    """Make one scan of a file, however often it is sent: its name, size and time are the key of the request."""
    status = file.stat()
    once = hashlib.sha256(f"{file.name} {status.st_size} {status.st_mtime_ns}".encode()).hexdigest()
    headers = {"Content-Type": "application/octet-stream", "Content-Length": str(status.st_size)}
    headers |= {"Idempotency-Key": once, "Authorization": f"Bearer {os.environ.get('SAWMILL_KEY', '')}"}
    query = urllib.parse.urlencode({"name": file.name, **FIELDS})
    with file.open("rb") as body:
        request = urllib.request.Request(f"{ADDRESS}/v1/scans?{query}", body, headers, method="POST")  # noqa: S310
        urllib.request.urlopen(request, timeout=600).close()  # noqa: S310 - the address is this program's own argument


def move(file, folder):
    """Move a file away, under a name that is free."""
    (FOLDER / folder).mkdir(exist_ok=True)
    file.rename(FOLDER / folder / f"{time.time_ns()}-{file.name}")


seen = {}
while True:
    for file in sorted(path for path in FOLDER.iterdir() if path.is_file() and path.suffix not in {".tmp", ".part"}):
        now = file.stat().st_size, file.stat().st_mtime_ns
        before, since_s = seen.setdefault(file, (now, time.monotonic()))
        if now != before:
            seen[file] = now, time.monotonic()
        elif now[0] and time.monotonic() - since_s >= STILL_FOR_S:
            try:
                send(file)
                move(file, "done")
            except urllib.error.HTTPError as error:
                print(f"{file.name}: {error.code} {error.read().decode()}", flush=True)
                if error.code in {413, 415, 422}:  # the file or the fields are wrong: a person must look at it
                    move(file, "refused")
            except OSError as error:
                print(f"{file.name}: {error}", flush=True)
    time.sleep(min(2.0, STILL_FOR_S))
