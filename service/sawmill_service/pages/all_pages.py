"""Routes of all pages; a page with a place in the header is in `navigation` too."""

from sawmill_service import retention
from sawmill_service.pages import fixed_pairs, jobs, logs, problem_pages, scans
from sawmill_service.pages.calibrate import calibrate, report
from sawmill_service.pages.frame import page_frame
from sawmill_service.pages.help import help as help_pages
from sawmill_service.pages.phantoms import phantoms
from sawmill_service.pages.scanners import comparison, scanner, scanner_history, today
from sawmill_service.pages.system import system, webhooks

PAGES = (
    calibrate.router,
    comparison.router,
    fixed_pairs.router,
    help_pages.router,
    jobs.router,
    logs.router,
    page_frame.router,
    phantoms.router,
    problem_pages.router,
    report.router,
    retention.pages,
    scanner.router,
    scanner_history.router,
    scans.router,
    system.router,
    today.router,
    webhooks.router,
)
