"""Routes of all pages; a page with a place in the header is in `navigation` too."""

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
