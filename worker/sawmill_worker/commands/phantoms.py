"""The drawing of the phantom that the command line means."""

from pydantic import ValidationError

from sawmill_worker.commands.options import PhantomSource
from sawmill_worker.contracts.base import complaint
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.phantoms import PhantomAsk, PhantomDrawing
from sawmill_worker.readers.picture import read_picture
from sawmill_worker.tomography.tracing import trace
from sawmill_worker.use_cases.conversion import from_phantom
from sawmill_worker.use_cases.failures import refused


def drawing_of(source: PhantomSource) -> PhantomDrawing:
    """A built-in phantom, a drawing from its file, or a traced picture.

    Raises
    ------
    JobFailure, UnreadableScan, PhantomError
        The file holds no phantom.
    """
    if source.is_built_in:
        return BUILT_IN_PHANTOMS[source.text]
    if source.width_mm is not None:
        return from_phantom(trace(read_picture(source.path), source.width_mm, name=source.path.stem))
    try:
        return PhantomAsk.model_validate_json(source.path.read_bytes())
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"])
        place = f"{where}: " if where else ""
        raise refused("phantom", f"{source.path.name} is not a phantom's drawing: {place}{complaint(error)}") from error
