"""Celery workers of a mill: `celery -A sawmill_worker.celery_app worker`."""

import sys

from celery import Celery

from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.celery_app import make_celery, serve
from sawmill_platform.workers.settings import ExecutionSettings, WrongVariableError, variables_checked
from sawmill_worker.program import MILL


def __getattr__(name: str) -> Celery:
    """Make `app` when Celery's command line looks for it, from the environment; importing makes nothing."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        with variables_checked():
            settings = ExecutionSettings()
            app = serve(make_celery(settings), settings, StorageSettings(), MILL)
    except (WrongVariableError, ValueError) as error:
        sys.stderr.write(f"{error}\n")
        raise SystemExit(2) from error
    globals()["app"] = app
    return app
