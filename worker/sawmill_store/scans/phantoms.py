"""Phantoms: built in, drawn, or traced from a picture by a job."""

from collections.abc import Mapping

from sqlalchemy import func, select

from sawmill_contracts import kinds, mill_events, phantoms
from sawmill_contracts.phantoms import MeasurementsRequest, PhantomDrawing, PhantomPicture, PhantomState, StoredPhantom
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.database.database import lock_for_setup
from sawmill_platform.database.paging import found, new_id, read_page, refuse_taken
from sawmill_platform.errors import Conflict, Invalid
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.ledger.events import announce
from sawmill_platform.uploads.upload_store import kept_upload
from sawmill_store.mill_tables import PhantomRow, ScanRow
from sawmill_store.queuing import QueuingPart
from sawmill_store.requests.references import check_usable, kept_by


class Phantoms(QueuingPart):
    """Store of phantoms."""

    def seed_built_in(self, drawings: Mapping[str, PhantomDrawing]) -> None:
        """Add or update the built-in phantoms; safe when several processes start together."""
        with self._database.write() as session:
            lock_for_setup(session)
            for phantom_id, drawing in drawings.items():
                row = session.get(PhantomRow, phantom_id)
                if row is None:
                    session.add(self._drawn(phantom_id, drawing, built_in=True))
                else:
                    row.name, row.drawing = drawing.name, drawing.model_dump(mode="json")

    def create(self, drawing: PhantomDrawing, *, phantom_id: str | None = None) -> StoredPhantom:
        """Add a drawn phantom, which is ready at once.

        Raises
        ------
        Conflict
            The id is taken.
        """
        row = self._drawn(phantom_id or new_id(), drawing, built_in=False)
        with self._database.write() as session:
            refuse_taken(session, PhantomRow, "phantom", row.id)
            session.add(row)
            announce(session, row.created_at, mill_events.PHANTOM_CREATED, "phantom", row.id)
            return StoredPhantom.of_row(row)

    def measure(self, phantom_id: str, measured: MeasurementsRequest) -> StoredPhantom:
        """Add a phantom with new measurements; the phantom before stays unchanged for everything that refers to it.

        Raises
        ------
        NotFound, Conflict
            There is no such phantom, or it has no drawing.
        Invalid
            The measurements contradict the drawing.
        """
        with self._database.write() as session:
            before = found(session, PhantomRow, "phantom", phantom_id)
            if before.drawing is None:
                raise Conflict(
                    "phantom-without-drawing", f"phantom {phantom_id!r} is {before.state} and has no drawing to measure"
                )
            drawing = PhantomDrawing.model_validate(before.drawing)
            try:
                drawing = drawing.measured_anew(phantom_id, measured.measurements, stretched=measured.stretch_drawing)
            except ValueError as error:
                raise Invalid("measurement-of-another-phantom", str(error)) from error
            row = self._drawn(new_id(), drawing, built_in=False)
            session.add(row)
            announce(session, row.created_at, mill_events.PHANTOM_CREATED, "phantom", row.id)
            return StoredPhantom.of_row(row)

    def followers(self) -> dict[str, str]:
        """Return, by the id of each phantom that was measured again, the id of the newest phantom made so."""
        follows = PhantomRow.drawing["follows"].as_string().label("follows")
        followed = select(follows, PhantomRow.id).where(follows.is_not(None)).order_by(PhantomRow.created_at)
        with self._database.read() as session:
            return {row.follows: row.id for row in session.execute(followed)}

    def replaced(self) -> set[str]:
        """Return the ids of phantoms that a newly measured phantom has replaced; never of a built-in phantom."""
        # A mill may have several bodies of a built-in drawing, of which one was measured.
        with self._database.read() as session:
            built_in_ids = set(session.scalars(select(PhantomRow.id).where(PhantomRow.built_in)))
        return self.followers().keys() - built_in_ids

    def accept_picture(
        self,
        picture: PhantomPicture,
        received: Received,
        *,
        phantom_id: str | None = None,
        priority: Priority = Priority.INTERACTIVE,
    ) -> StoredPhantom:
        """Keep an uploaded PNG and queue the job that traces it.

        Raises
        ------
        Conflict
            The id is taken. The upload is discarded.
        QueueFull
            The allowed number of jobs is waiting already.
        """
        row = PhantomRow(
            id=phantom_id or new_id(),
            created_at=self._database.now(),
            name=picture.name,
            built_in=False,
            state=PhantomState.TRACING,
            picture=picture.model_dump(mode="json"),
        )
        with kept_upload(self.files, received, kinds.TRACE_PHANTOM, row.id) as keep, self._database.write() as session:
            refuse_taken(session, PhantomRow, "phantom", row.id)
            self._add_with_job(session, row, phantoms.DECLARATION, received, group_id=None, priority=priority)
            keep(session, row.created_at)
        return StoredPhantom.of_row(row)

    def get(self, phantom_id: str) -> StoredPhantom:
        """Return a phantom, or raise `NotFound`."""
        with self._database.read() as session:
            return StoredPhantom.of_row(found(session, PhantomRow, "phantom", phantom_id))

    def usable(self, phantom_id: str) -> StoredPhantom:
        """Return a phantom that a calibration may use.

        Raises
        ------
        NotFound, Conflict
            There is no such phantom, or its picture was refused.
        """
        with self._database.read() as session:
            row = found(session, PhantomRow, "phantom", phantom_id)
            check_usable(row)
            return StoredPhantom.of_row(row)

    def picture(self, phantom_id: str) -> PhantomPicture:
        """Return the data given with a phantom's picture, or raise `NotFound`; raise `Conflict` for a drawn phantom."""
        with self._database.read() as session:
            return picture_of(found(session, PhantomRow, "phantom", phantom_id))

    def page(self, *, after: str | None = None, limit: int = 50) -> Page[StoredPhantom]:
        """Return a page of phantoms, newest first."""
        with self._database.read() as session:
            return read_page(session, select(PhantomRow), PhantomRow, StoredPhantom.of_row, after=after, limit=limit)

    def delete(self, phantom_id: str) -> None:
        """Remove a phantom that nothing refers to, and its files after the commit.

        Raises
        ------
        NotFound, Conflict
            There is no such phantom, or it is built in, being traced, or used by a scan or a calibration.
        """
        with self._database.write() as session:
            row = found(session, PhantomRow, "phantom", phantom_id, lock=True)
            if row.built_in:
                raise Conflict("phantom-built-in", f"phantom {phantom_id!r} is built in and stays")
            if row.state is PhantomState.TRACING:
                msg = f"phantom {phantom_id!r} is still being traced; cancel job {row.job_id!r} first"
                raise Conflict("phantom-in-use", msg)
            scans = session.scalar(select(func.count()).where(ScanRow.phantom_id == phantom_id)) or 0
            for plural, used in [("scans", scans), *kept_by(session, "phantom_id", phantom_id)]:
                if used:
                    msg = f"phantom {phantom_id!r} is used by {plural}; a used phantom stays"
                    raise Conflict("phantom-in-use", msg)
            now = self._database.now()
            announce(session, now, mill_events.PHANTOM_DELETED, "phantom", phantom_id, decided=row.drawing)
            session.delete(row)
        self.files.remove(self.files.results(kinds.TRACE_PHANTOM, phantom_id))
        self.files.remove_upload(kinds.TRACE_PHANTOM, phantom_id)

    def _drawn(self, phantom_id: str, drawing: PhantomDrawing, *, built_in: bool) -> PhantomRow:
        return PhantomRow(
            id=phantom_id,
            created_at=self._database.now(),
            name=drawing.name,
            built_in=built_in,
            state=PhantomState.READY,
            drawing=drawing.model_dump(mode="json"),
        )


def picture_of(row: PhantomRow) -> PhantomPicture:
    """Return the data given with a phantom's picture, for the job that traces the picture."""
    if row.picture is None:
        raise Conflict("phantom-without-picture", f"phantom {row.id!r} was drawn, it has no picture")
    return PhantomPicture.model_validate(row.picture)
