"""The real embedded worker over tasks without science."""

import signal
import sys
import threading
from pathlib import Path

from worker.execution.poller import run_worker
from worker.execution.settings import ExecutionSettings
from worker.storage.settings import StorageSettings
from worker.storage.store import Store

stop = threading.Event()
signal.signal(signal.SIGTERM, lambda *_: stop.set())
threading.Thread(target=lambda: (sys.stdin.buffer.raw.read(), stop.set()), daemon=True).start()
command = [sys.executable, str(Path(__file__).with_name("fake_science.py"))]
run_worker(Store(StorageSettings()), ExecutionSettings(), stop, command=command)
