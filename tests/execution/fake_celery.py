"""The real Celery application over tasks without science, for `celery -A fake_celery worker`."""

import sys
from pathlib import Path

from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.celery_app import make_celery
from sawmill_platform.workers.settings import ExecutionSettings

app = make_celery(
    ExecutionSettings(),
    StorageSettings(),
    command=[sys.executable, str(Path(__file__).with_name("fake_science.py"))],
)
