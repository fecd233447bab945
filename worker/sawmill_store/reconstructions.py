"""Reconstructions, as requests that a job answers, and the names that people give them."""

from sawmill_contracts import mill_events
from sawmill_contracts.reconstructions import Reconstruction, ReconstructionAsk
from sawmill_platform.database.paging import hold
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import announce
from sawmill_store.mill_tables import ReconstructionRow
from sawmill_store.requests.asked import Asked
from sawmill_store.requests.references import found_asked


class Reconstructions(Asked[ReconstructionAsk, Reconstruction]):
    """Store of the reconstructions: every method is one transaction."""

    def rename(self, identifier: str, name: str | None) -> Reconstruction:
        """Give a reconstruction a name; None takes its name away.

        Raises
        ------
        NotFound
            There is no such reconstruction.
        """
        with self._database.write() as session:
            hold(session, ReconstructionRow, "reconstruction", identifier)  # the rules may remove it at any time
            row = found_asked(session, self._declared, identifier)
            assert isinstance(row, ReconstructionRow)  # noqa: S101 - the table of the kind
            if difference := changed({"name": row.name}, {"name": name}):
                row.name, now = name, self._database.now()
                kind, group_id = mill_events.RECONSTRUCTION_RENAMED, row.scanner_id
                announce(session, now, kind, "reconstruction", identifier, group_id=group_id, decided=difference)
            return self._read(row)
