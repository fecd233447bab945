"""The drawing of the phantom that the command line means."""

from sawmill_contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_worker.commands.phantom_options import PhantomSource
from sawmill_worker.use_cases.phantom_file import read_drawing


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
        # Imported here: no other phantom needs the readers of pictures.
        from sawmill_worker.use_cases.phantom_picture import traced_drawing  # noqa: PLC0415

        return traced_drawing(source.path, source.width_mm, name=source.path.stem)
    return read_drawing(source.path)
