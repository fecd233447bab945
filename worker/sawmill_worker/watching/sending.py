"""Upload of a taken file, and creation of exactly one scan, however often this process is killed.

The record of a taking holds each identifier from the service before the identifier is used. The service makes one scan
from an upload, in one transaction, and reports for a day which scan (`used_by`). If a process restarts after the
upload's row is gone, the scan is searched for among the scans that were made since.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace

from sawmill_platform.files.whole_files import open_regular
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.watching.durable import FileChanged, sha256_of, signature
from sawmill_worker.watching.service import Json, Service
from sawmill_worker.watching.settings import WatchedFolder, scan_name
from sawmill_worker.watching.stopping import Stop
from sawmill_worker.watching.takings import Taking, Takings

ShowProgress = Callable[[str], AbstractContextManager[ProgressCallback]]

_SCANS = "/v1/scans/"


class FileSending:
    """Sending of the files of one folder.

    Parameters
    ----------
    settings
        Settings of the folder.
    takings
        Records of the takings.
    service
        The service that receives the files.
    stop
        Ends the sending between two pieces of a file.
    show_progress
        Shows a person the progress of a file.
    """

    def __init__(
        self, settings: WatchedFolder, takings: Takings, service: Service, stop: Stop, show_progress: ShowProgress
    ) -> None:
        self._settings = settings
        self._takings = takings
        self._service = service
        self._stop = stop
        self._show_progress = show_progress

    def send(self, taking: Taking, query: dict[str, str]) -> Taking:
        """Send a file and make its scan; return the taking with the scan's id.

        Parameters
        ----------
        query
            Query of `POST /v1/scans`.

        Raises
        ------
        FileChanged
            The file is being written to; no scan was made.
        ServiceWaits, Refusal
            The service cannot be used, or refuses the request.
        Stopped, OSError
            The watcher was asked to end, or the file cannot be read.
        """
        upload = None
        while upload is None:
            taking = self._summed(taking)
            if taking.upload_id is None:
                taking, upload = self._begun(taking)
            else:
                upload = self._service.found(f"/v1/uploads/{taking.upload_id}", "upload-not-found")
            if upload is None:
                taking = self._after_expiry(taking)
                if taking.scan_id is not None:
                    return taking
        if upload["state"] == "receiving":
            self._check_unchanged(taking)
            upload = self._sent(taking, upload)
        if upload["state"] == "used":
            scan_id = upload["used_by"].removeprefix(_SCANS)
        else:
            self._check_unchanged(taking)
            scan_id = self._service.make_scan(upload["id"], query)["id"]
        return self._takings.save(replace(taking, scan_id=scan_id))

    def is_unchanged(self, taking: Taking) -> bool:
        """Return whether the file equals what was sent; only a file with another time or size is read again."""
        path = self._takings.path(taking)
        return signature(path) == taking.signature or sha256_of(path, self._stop) == taking.sha256

    def _summed(self, taking: Taking) -> Taking:
        if taking.sha256 is not None:
            return taking
        path = self._takings.path(taking)
        digest, present = sha256_of(path, self._stop), signature(path)
        if present != taking.signature:
            self._takings.save(taking.restarted(present))
            raise FileChanged("it was written to after it was taken")
        return self._takings.save(replace(taking, sha256=digest))

    def _begun(self, taking: Taking) -> tuple[Taking, Json]:
        declaration = {"size_bytes": taking.signature[0], "name": scan_name(taking.name), "sha256": taking.sha256}
        upload = self._service.begin_upload(declaration, once=taking.upload_name)
        began = replace(taking, upload_id=upload["id"], upload_began=upload["created_at"])
        return self._takings.save(began), upload

    def _after_expiry(self, taking: Taking) -> Taking:
        """Return the taking with the scan of an upload whose row is gone; without a scan, with nothing sent."""
        scan = self._service.find_scan(
            scanner_id=self._settings.scanner_id,
            name=scan_name(taking.name),
            sha256=str(taking.sha256),
            since=str(taking.upload_began),
        )
        updated = taking.restarted(taking.signature) if scan is None else replace(taking, scan_id=scan["id"])
        return self._takings.save(updated)

    def _sent(self, taking: Taking, upload: Json) -> Json:
        path = self._takings.path(taking)
        with open_regular(path) as file, self._show_progress(taking.name) as on_progress:
            return self._service.send_rest(upload, file, on_progress)

    def _check_unchanged(self, taking: Taking) -> None:
        if self.is_unchanged(taking):
            return
        self._service.delete_upload(str(taking.upload_id))
        self._takings.save(taking.restarted(signature(self._takings.path(taking))))
        raise FileChanged("it was written to while it was sent")
