"""Failures of jobs and their causes: the only module that translates errors of science and readers."""

from collections.abc import Iterator
from contextlib import contextmanager

from sawmill_calibration.process_memory import limit_bytes, ran_short
from sawmill_formats.errors import UnreadableScan
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.errors import DamagedResult
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.phantoms.phantom import PhantomError
from sawmill_tomography.preparing.line_integrals import CountsError
from sawmill_tomography.preparing.row_shifts import RowsError


def refused(code: str, detail: str) -> JobFailure:
    """Create a failure that the user can correct."""
    return JobFailure(FailureKind.INPUT, code, detail)


@contextmanager
def input_errors_translated() -> Iterator[None]:
    """Turn errors of readers and science about unusable input into a failure of the input, with the cause chained."""
    try:
        yield
    except UnreadableScan as error:
        raise _of_file(error) from error
    except (CalibrationError, DamagedResult, DriftError) as error:
        raise refused(error.code, str(error)) from error
    except GeometryError as error:
        raise refused("geometry", str(error)) from error
    except PhantomError as error:
        raise refused("phantom", str(error)) from error
    except RowsError as error:
        raise refused("rows-not-aligned", str(error)) from error
    except CountsError as error:
        raise refused("counts", str(error)) from error


def _of_file(error: UnreadableScan) -> JobFailure:
    """Convert a reader's error; some libraries report a damaged file when they had no memory to unpack it."""
    limit = limit_bytes()
    if error.code != "broken-file" or limit is None or not ran_short():
        return refused(error.code, str(error))
    return refused(
        "out-of-memory",
        f"reading the file took most of the {limit / 2**30:.3g} GiB of memory that it may take, and failed: it unpacks "
        "to more than that, or is damaged; store it in smaller pieces, or export it again",
    )
