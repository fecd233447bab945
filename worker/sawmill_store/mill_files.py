"""The data folder of a mill, in addition to the files of `sawmill_platform/files/file_store.py`.

uploads/{scans,phantoms}/<id>/  the uploaded file, unchanged
uploads/inspections/<id>/       the uploaded file, for a day; a scan made of it has a second name of the same bytes
inspections/<id>/               view.grey or sinogram.grey, a picture of what the file shows
scans/<id>/scan.h5              line integrals
calibrations/<id>/              result.h5; report.png and overlay.png, drawn from it at the first request
reconstructions/<id>/           volume.h5
"""

from pathlib import Path

from sawmill_contracts import kinds
from sawmill_platform.files.file_store import FileStore

SCAN_FILE = "scan.h5"
VOLUME_FILE = "volume.h5"


class MillFiles(FileStore):
    """The data folder, with the files that pages and routes read."""

    def scan(self, scan_id: str) -> Path:
        """Return the canonical file of a scan, which `ingest` wrote, as `result` does."""
        return self.result(kinds.INGEST, scan_id, SCAN_FILE)

    def volume(self, reconstruction_id: str) -> Path:
        """Return the volume of a reconstruction, as `result` does."""
        return self.result(kinds.RECONSTRUCT, reconstruction_id, VOLUME_FILE)
