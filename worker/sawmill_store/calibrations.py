"""Calibrations and their activation, and reconstructions: requests and results as of every kind."""

from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.calibrations import CalibrationRequest, CalibrationSucceeded, CalibrationUnfinished
from sawmill_contracts.reconstructions import MOST_MARKS, MarkRequest, Reconstruction, ReconstructionRequest
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.database.paging import found, hold
from sawmill_platform.database.tables import Json
from sawmill_platform.errors import Conflict
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import announce
from sawmill_store import mill_tables
from sawmill_store.activations import activate, active_calibration_id, discard
from sawmill_store.requests.asked import Asked
from sawmill_store.scanners.scanners import read_scanner


class Calibrations(Asked[CalibrationRequest, CalibrationUnfinished | CalibrationSucceeded]):
    """Store of calibrations."""

    def activate(self, calibration_id: str, reason: str) -> StoredScanner:
        """Make a calibration its scanner's active one, or go back to an older one.

        Parameters
        ----------
        calibration_id
            A calibration that has succeeded, whatever its verdict: the technician decides.
        reason
            Reason of the activation, for the history.

        Raises
        ------
        NotFound, Conflict
            There is no such calibration, or the calibration has no result.
        """
        with self._database.write() as session:
            row = found(session, mill_tables.CalibrationRow, "calibration", calibration_id)
            if row.result is None:
                raise Conflict(
                    "calibration-without-result",
                    f"calibration {calibration_id!r} is {row.job.state}; only one that succeeded can be activated",
                )
            scanner = found(session, mill_tables.ScannerRow, "scanner", row.scanner_id, lock=True)
            hold(session, mill_tables.CalibrationRow, "calibration", row.id)
            activate(session, scanner.id, row.id, reason, self._database.now())
            return read_scanner(session, scanner)

    def discard(self, calibration_id: str, reason: str) -> StoredScanner:
        """Put a failed or unaccepted calibration aside: it stays in the history, and its scanner is shown without it.

        Raises
        ------
        NotFound, Conflict
            There is no such calibration; it has not ended, or it is in use.
        """
        with self._database.write() as session:
            row = found(session, mill_tables.CalibrationRow, "calibration", calibration_id)
            scanner = found(session, mill_tables.ScannerRow, "scanner", row.scanner_id, lock=True)
            if not row.job.state.ended:
                raise Conflict("calibration-unfinished", f"calibration {row.id!r} is {row.job.state}: cancel its job")
            if row.id == active_calibration_id(session, scanner.id):
                raise Conflict(
                    "calibration-in-use", f"calibration {row.id!r} is in use: accept another one, or roll back to one"
                )
            discard(session, scanner.id, row.id, reason, self._database.now())
            return read_scanner(session, scanner)


class Reconstructions(Asked[ReconstructionRequest, Reconstruction]):
    """Store of the reconstructions."""

    def rename(self, identifier: str, name: str | None) -> Reconstruction:
        """Give a reconstruction a name; None takes its name away.

        Raises
        ------
        NotFound
            There is no such reconstruction.
        """
        with self._database.write() as session:
            row = found(session, mill_tables.ReconstructionRow, "reconstruction", identifier, lock=True)
            if difference := changed({"name": row.name}, {"name": name}):
                row.name = name
                self._announce(session, row, mill_events.RECONSTRUCTION_RENAMED, difference)
            return self._read(row)

    def mark(self, identifier: str, mark_id: str, mark: MarkRequest | None) -> Reconstruction:
        """Keep a mark with a reconstruction, in place of the one of the same id; None removes it, if it is there.

        Raises
        ------
        NotFound, Conflict
            There is no such reconstruction, or it has the largest number of marks.
        """
        with self._database.write() as session:
            row = found(session, mill_tables.ReconstructionRow, "reconstruction", identifier, lock=True)
            before = {each["id"]: each for each in row.marks}
            after = before | {mark_id: {"id": mark_id, **mark.model_dump(mode="json")} if mark else None}
            if difference := changed(before, after):
                row.marks = [each for each in after.values() if each]
                if len(row.marks) > MOST_MARKS:
                    raise Conflict("too-many-marks", f"{identifier!r} has {MOST_MARKS} marks already: remove one")
                self._announce(session, row, mill_events.RECONSTRUCTION_MARKED, difference)
            return self._read(row)

    def file_name(self, identifier: str) -> str:
        """Return the name of a reconstruction's files: its own, or its scanner's name and its number there."""
        with self._database.read() as session:
            row = found(session, mill_tables.ReconstructionRow, "reconstruction", identifier)
            scanner = found(session, mill_tables.ScannerRow, "scanner", row.scanner_id)
            return row.name or f"{scanner.spec['name']}-{row.number}"

    def _announce(self, session: Session, row: mill_tables.ReconstructionRow, kind: EventType, decided: Json) -> None:
        """Add an event of a person's change."""
        now, group_id = self._database.now(), row.scanner_id
        announce(session, now, kind, "reconstruction", row.id, group_id=group_id, decided=decided)
