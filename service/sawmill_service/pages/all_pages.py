"""The routes of every page; each that has a place in the header also stands in `navigation`."""

from sawmill_service.pages import logs, look, phantoms, report, scans

PAGES = (logs.router, look.router, phantoms.router, report.router, scans.router)
