"""Output of a reconstruction's volume with all data about its origin."""

from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_formats.output.volume_writer import NewVolume, new_reconstruction
from sawmill_vocabulary import Handedness, Rotation, Theta
from sawmill_vocabulary.version import VERSION


@dataclass(frozen=True)
class VolumeOrigin:
    """Origin of a volume: the scan, its rows, and the geometry."""

    scanner: ScannerConstants
    theta: Theta
    rotation: Rotation
    handedness: Handedness
    rows: tuple[int, int]
    input_sha256: str
    preparation: tuple[str, ...] = ()
    row_step: int = 1


def new_volume(
    path: Path,
    shape: tuple[int, int, int],
    origin: VolumeOrigin,
    options: ReconstructionOptions,
    *,
    unit: str,
    views: int,
) -> AbstractContextManager[NewVolume]:
    """Create a volume (slice, x, y) as HDF5, to which slices are written one after another (`new_reconstruction`)."""
    # Fields of the request beyond the options, for example a job's identifiers, are no parameters of the method.
    parameters = options.model_dump(mode="json", exclude_none=True, include=set(ReconstructionOptions.model_fields))
    pitch = origin.scanner.row_pitch_mm
    step = "" if origin.row_step == 1 else f":{origin.row_step}"
    return new_reconstruction(
        path,
        shape,
        pixel_mm=options.field_mm / options.size,
        row_pitch_mm=None if pitch is None else pitch * origin.row_step,
        centre_mm=options.field_centre_mm,
        # The scan's first row is at 0, so that volumes of other rows of the same scan have consistent positions.
        first_slice_mm=(pitch or 0.0) * origin.rows[0],
        unit=unit,
        geometry={
            **{name: value for name, value in asdict(origin.scanner).items() if value is not None and value != ()},
            **vars(origin.theta),
            "rotation": origin.rotation.value,
            "handedness": origin.handedness.value,
        },
        parameters={
            **parameters,
            "views": views,
            "rows": f"{origin.rows[0]}:{origin.rows[1]}{step}",
            "preparation": list(origin.preparation),
        },
        software_version=VERSION,
        input_sha256=origin.input_sha256,
    )
