"""Pages that the header leads to, in the order of the header."""

from sawmill_service.pages.frame.languages import marked

NAVIGATION = (
    ("/", marked("Today")),
    ("/calibrate", marked("Calibrate")),
    ("/logs", marked("Logs")),
    ("/scans", marked("Scans")),
    ("/phantoms", marked("Phantoms")),
    ("/jobs", marked("Jobs")),
    ("/system", marked("System")),
)
