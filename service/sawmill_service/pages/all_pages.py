"""The routes of every page; each that has a place in the header also stands in `navigation`."""

from sawmill_service.pages import look, phantoms

PAGES = (look.router, phantoms.router)
