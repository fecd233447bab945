"""The log of tests: a traceback drawn in boxes with every variable, as structlog does by itself, takes ten seconds."""

import structlog


def log_plainly() -> None:
    """Lines for people, with tracebacks as Python writes them."""
    rendered = structlog.dev.ConsoleRenderer(colors=False, exception_formatter=structlog.dev.plain_traceback)
    added = [structlog.contextvars.merge_contextvars, structlog.processors.add_log_level]
    structlog.reset_defaults()
    structlog.configure(processors=[*added, rendered])
