"""Drawing of the phantom that a command line specifies."""

from sawmill_contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_worker.commands.phantom_options import PhantomSource


def drawing_of(source: PhantomSource) -> PhantomDrawing:
    """Return a built-in phantom, the drawing in a file, or the tracing of a picture.

    Raises
    ------
    JobFailure, UnreadableScan, PhantomError
        The file holds no phantom.
    """
    if source.is_built_in:
        return BUILT_IN_PHANTOMS[source.text]
    # Imported here because a built-in phantom needs no readers of files and pictures.
    from sawmill_calibration.phantom_drawings import read_drawing, traced_drawing  # noqa: PLC0415

    if source.width_mm is not None:
        return traced_drawing(source.path, source.width_mm, name=source.path.stem)
    return read_drawing(source.path)
