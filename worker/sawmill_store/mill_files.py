"""The data folder of a mill: the files of scans and of reconstructions."""

from pathlib import Path

from sawmill_contracts import job_kinds
from sawmill_platform.files.file_store import FileStore

SCAN_FILE = "scan.h5"


class MillFiles(FileStore):
    """The data folder, with the files that pages and routes read."""

    def scan(self, scan_id: str) -> Path:
        """Return the canonical file of a scan, which `ingest` wrote, or raise `NotFound`."""
        return self.result(job_kinds.INGEST, scan_id, SCAN_FILE)

    def volume(self, reconstruction_id: str) -> Path:
        """Return the volume of a reconstruction, or raise `NotFound`."""
        return self.result(job_kinds.RECONSTRUCT, reconstruction_id, "volume.h5")
