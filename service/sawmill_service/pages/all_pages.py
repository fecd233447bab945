"""The routes of every page; each that has a place in the header also stands in `navigation`."""

from sawmill_service.pages import (
    calibrate,
    jobs,
    logs,
    look,
    phantoms,
    problem_types,
    report,
    retention,
    scanner,
    scanner_history,
    scans,
    system,
    today,
    webhooks,
)

PAGES = (
    calibrate.router,
    jobs.router,
    logs.router,
    look.router,
    phantoms.router,
    problem_types.router,
    report.router,
    retention.router,
    scanner.router,
    scanner_history.router,
    scans.router,
    system.router,
    today.router,
    webhooks.router,
)
