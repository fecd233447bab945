"""The real Celery application over tasks without science, for `celery -A fake_celery worker`."""

import sys
from dataclasses import replace
from pathlib import Path

from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.celery_app import make_celery, serve
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_worker.program import MILL

settings = ExecutionSettings()
command = [sys.executable, str(Path(__file__).with_name("fake_science.py"))]
app = serve(make_celery(settings), settings, StorageSettings(), replace(MILL, attempt_command=command))
