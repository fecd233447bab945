"""The real embedded worker over tasks without science."""

import math
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path

from sawmill_platform.jobs.wait_estimate import ANY, Selection
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.poller import listen_to_parent, report_to_parent, run_worker
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.store import Store
from sawmill_worker.program import MILL

stop, wake = threading.Event(), threading.Event()
signal.signal(signal.SIGTERM, lambda *_: (stop.set(), wake.set()))
threading.Thread(target=listen_to_parent, args=(stop, wake), daemon=True).start()
command = [sys.executable, str(Path(__file__).with_name("fake_science.py"))]
store = Store(StorageSettings())
short_only = "--short" in sys.argv
options = {"selection": Selection(short=True), "idle_s": 1.0} if short_only else {"selection": ANY, "idle_s": math.inf}
program = replace(MILL, attempt_command=command)
run_worker(program, store, ExecutionSettings(), stop, wake=wake, on_able=report_to_parent, **options)
