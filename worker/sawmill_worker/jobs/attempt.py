"""The argument of a job's functions."""

from typing import TypeVar

from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.attempts import work
from sawmill_platform.contracts.base import Contract

Asked = TypeVar("Asked", bound=Contract)


class MillAttempt(work.Attempt[HandedOver]):
    """Attempt at a job of the mill."""

    @property
    def scanner(self) -> StoredScanner:
        """The scanner of the scan, or of the ask."""
        assert self.given.scanner is not None  # noqa: S101 - of a kind that has one
        return self.given.scanner

    def asked(self, contract: type[Asked]) -> Asked:
        """Read the job's own row as the contract that its kind answers with while it is unfinished."""
        assert self.given.asked_json is not None  # noqa: S101 - of a kind that is asked for
        return contract.model_validate_json(self.given.asked_json)
