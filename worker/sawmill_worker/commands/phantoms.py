"""The drawing of the phantom that the command line means."""

from pydantic import ValidationError

from sawmill_worker.commands.options import PhantomSaid, complaint
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.phantoms import PhantomAsk, PhantomDrawing
from sawmill_worker.readers.picture import read_picture
from sawmill_worker.tomography.tracing import trace
from sawmill_worker.use_cases.conversion import from_phantom
from sawmill_worker.use_cases.failures import refused


def drawing_of(said: PhantomSaid) -> PhantomDrawing:
    """A built-in phantom, a drawing from its file, or a traced picture.

    Raises
    ------
    JobFailure, UnreadableScan, PhantomError
        The file holds no phantom.
    """
    if said.text in BUILT_IN_PHANTOMS:
        return BUILT_IN_PHANTOMS[said.text]
    if said.width_mm is not None:
        return from_phantom(trace(read_picture(said.path), said.width_mm, name=said.path.stem))
    try:
        return PhantomAsk.model_validate_json(said.path.read_bytes())
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"])
        place = f"{where}: " if where else ""
        raise refused("phantom", f"{said.path.name} is not a phantom's drawing: {place}{complaint(error)}") from error
