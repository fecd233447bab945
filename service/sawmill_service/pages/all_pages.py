"""The routes of every page; each that has a place in the header also stands in `navigation`."""

from sawmill_service.pages import calibrate, jobs, logs, look, phantoms, report, scanner, scans, system, today

PAGES = (
    calibrate.router,
    jobs.router,
    logs.router,
    look.router,
    phantoms.router,
    report.router,
    scanner.router,
    scans.router,
    system.router,
    today.router,
)
