"""Inspection of a file: contents, the part that would be read as a scan, and missing data; nothing is converted."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sawmill_calibration.failures import memory_available
from sawmill_calibration.pictures.images import small_square
from sawmill_calibration.result_file import read_saved_calibration
from sawmill_calibration.scans.scan_rows import links_offered, of_file
from sawmill_calibration.view_vectors import list_of_views
from sawmill_contracts.inspections import (
    PICTURE_PX,
    FilePart,
    FileVerdict,
    InspectedReading,
    InspectionResult,
    MissingPart,
    ScanPicture,
    ViewAngles,
)
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scans import ScanShape
from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.input.angles import AnglesGiven
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.contents import FileContents, Projections, alike_together
from sawmill_formats.input.hdf5.links import LinkedFilesOnDisk
from sawmill_formats.input.own import OwnKind, own_kind
from sawmill_formats.input.picture import is_picture, picture_parts
from sawmill_formats.input.reading import canonical_scan, reading_bounds, reading_contents
from sawmill_formats.input.recognising import Format, recognise
from sawmill_formats.reading_apart import read_apart
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_tomography.geometry.geometry import turning
from sawmill_vocabulary import DataKind, GeometryError, angle_difference, wrap_angle

# Largest number of listed parts: a person reads the first page, and a program names the part that it needs.
MOST_PARTS = 2_000
# Most bytes of the projections that are read for a picture.
MOST_READ_BYTES = 2**28
PNG = "PNG"
NO_SCAN: Mapping[str | None, tuple[str, str]] = {
    OwnKind.VOLUME: (
        "volume-file",
        "it is a reconstructed volume and no scan; docs/look-up/formats.md names the programs that show it",
    ),
    OwnKind.CALIBRATION: ("calibration-file", "it is a calibration and no scan"),
    PNG: ("picture-file", "it is a picture and no scan"),
}
GIVEN_ELSEWHERE: Mapping[str | None, str] = {
    OwnKind.CALIBRATION: "give it as --calibration",
    PNG: "a phantom's drawing is given as --phantom, with --phantom-width-mm",
}

Fields = dict[str, Any]  # fields of an `InspectionResult`


@dataclass(frozen=True)
class InspectionInput:
    """A file and the values that its owner gives with it; names and units as in `reading_scan`."""

    path: Path
    data: DataKind | None = None
    dataset: str | None = None
    angles: AnglesGiven | None = None
    detector_pitch_mm: float | None = None
    row_pitch_mm: float | None = None
    flats: Path | None = None
    darks: Path | None = None
    follow_links: bool = False
    transpose: bool = False
    axes: str | None = None
    uploaded: bool = False  # whether a service has it, which reads one file alone and has no flags
    pictures: Path | None = None  # folder for a picture of the scan; None: none is drawn, and no projection is read


def inspect_file(source: InspectionInput) -> InspectionResult:
    """Inspect a file's headers and the data that reading would begin with.

    Flat and dark fields, angles and short texts are read, and of the projections only what a picture shows. Defects of
    the file are part of the answer.

    Raises
    ------
    OSError
        The file cannot be opened.
    """
    result = InspectionResult(
        file=str(source.path), size_bytes=_size(source.path), verdict=FileVerdict.REFUSED, parts=[]
    )
    try:
        if not source.uploaded:  # an upload is inspected in a process that may end
            read_apart(source.path, source.flats, source.darks, follow_links=source.follow_links)
        _refuse_vectors(source.path)
        format_ = None if source.path.is_file() and is_picture(source.path) else recognise(source.path)
    except UnreadableScan as error:
        result = result.model_copy(update={"refusal": _failure(error.code, str(error))})
        return _of_calibration_json(source, result) if error.code == "unknown-format" else result
    kind = own_kind(source.path)
    parts, ended = _listed(source.path, format_, follow_links=source.follow_links)
    no_scan = kind if format_ else PNG
    read: Fields = {"refusal": _no_scan(source, no_scan)} if no_scan in NO_SCAN else _read(source, kind)
    if "refusal" not in read:
        read["verdict"] = FileVerdict.INCOMPLETE if any(part.needed for part in read["missing"]) else FileVerdict.READY
    of_file = {"format": format_.name if format_ else PNG, "own_kind": kind, "listing_ended": ended}
    listed = {"parts": parts[:MOST_PARTS], "parts_left_out": max(0, len(parts) - MOST_PARTS)}
    return result.model_copy(update={**of_file, **listed, **read})


def _refuse_vectors(path: Path) -> None:
    """Refuse vectors of views, by the numbers with which a scanner starts whose angles increase from 0 on."""
    views = list_of_views(path)
    if views is None:
        return
    try:
        turn = turning(views)
        turn.check_even()
        theta = replace(turn.theta, initial_angle_rad=wrap_angle(turn.theta.initial_angle_rad + turn.angles_rad[0]))
        turned = " --rotation reversed" if angle_difference(*turn.angles_rad[1::-1]) < 0.0 else ""
        r_s, pitch = (f"{each:.10g} mm" for each in (turn.scanner.source_to_cor_mm, turn.scanner.detector_pitch_mm))
        numbers = f"as numbers: --theta {theta.written(12)}{turned}, source to turning axis {r_s}, cells of {pitch}"
    except GeometryError as error:
        numbers = str(error)
    what = f"it is a geometry of {views.sinogram_shape[0]} views and no scan; give it as --geometry; {numbers}"
    raise UnreadableScan("geometry-file", what)


def _of_calibration_json(source: InspectionInput, refused: InspectionResult) -> InspectionResult:
    """Name a file of no format that is a calibration's answer, as the service or the command line wrote it."""
    try:
        identifier = read_saved_calibration(source.path).header.get("id")
    except JobFailure:
        return refused
    with suppress(ValidationError):  # another program may have written the id
        refused = refused.model_copy(update={"calibration_id": TypeAdapter(Identifier).validate_python(identifier)})
    refusal = _no_scan(source, OwnKind.CALIBRATION)
    return refused.model_copy(update={"own_kind": OwnKind.CALIBRATION, "refusal": refusal})


def _size(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    files = filter(Path.is_file, path.iterdir()) if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def _listed(path: Path, format_: Format | None, *, follow_links: bool) -> tuple[list[FilePart], str | None]:
    """List the parts of a file of a known format or of a picture, and the reason if the list is incomplete."""
    parts: list[FilePart] = []
    try:
        with ExitStack() as files, library_errors_translated(format_.name if format_ else PNG):
            linked = LinkedFilesOnDisk(files) if follow_links else None
            bounds = replace(reading_bounds(memory_available()), linked=linked)
            listed = format_.parts(path, bounds) if format_ else picture_parts(path)
            parts.extend(FilePart.model_validate(asdict(part)) for part in alike_together(listed))
    except UnreadableScan as error:
        return parts, str(error)
    return parts, None


def _read(source: InspectionInput, kind: OwnKind | None) -> Fields:
    """Return the result's fields on what reading would begin with, or on why the file is not read."""
    try:
        opened = reading_contents(source.path, **of_file(source))
        with links_offered(followed=source.follow_links or source.uploaded), opened as contents:
            return _of_contents(contents, source, kind)
    except UnreadableScan as error:
        return _refused_or_missing(error, source)


def _no_scan(source: InspectionInput, kind: str | None) -> Failure:
    (code, what), given_elsewhere = NO_SCAN[kind], GIVEN_ELSEWHERE.get(kind)
    return _failure(code, what if source.uploaded or given_elsewhere is None else f"{what}; {given_elsewhere}")


def _refused_or_missing(error: UnreadableScan, source: InspectionInput) -> Fields:
    """Return an error as a missing part where an option supplies it, else as a refusal."""
    supplied_by: dict[str, tuple[str, str, str | None]] = {
        "dataset-ambiguous": ("which array holds the projections", "--dataset", "dataset"),
        "external-storage": ("what other files hold", "--follow-links", None),
        "angles-missing": ("the views' angles", "--angles-deg or --angles-file", "angles_deg"),
    }
    what, flag, field = supplied_by.get(error.code, ("", "", None))
    if not what or (source.uploaded and field is None):
        return {"refusal": _failure(error.code, str(error))}
    return {"missing": [MissingPart(name=what, flag=flag, field=field, why=str(error))]}


def _of_contents(contents: FileContents, source: InspectionInput, kind: OwnKind | None) -> Fields:
    scan, read = None, Fields()
    of_integrals = source.data is DataKind.LINE_INTEGRALS
    lacks_flats = contents.flats is None and not of_integrals
    try:
        # As it would be read once its kind is given, and its flat fields if they are missing.
        scan = canonical_scan(
            replace(contents, darks=None) if lacks_flats else contents,
            counts=not (of_integrals or lacks_flats),
            angles_deg=source.angles,
            detector_pitch_mm=source.detector_pitch_mm,
            row_pitch_mm=source.row_pitch_mm,
        )
    except UnreadableScan as error:
        read = _refused_or_missing(error, source)
    if source.pictures is not None and "refusal" not in read:
        try:
            _draw(contents.projections, source.pictures)
        except UnreadableScan as error:
            read["refusal"] = _failure(error.code, str(error))
    reading = _reading(contents, source, scan)
    missing = (*read.get("missing", ()), *_missing(contents, reading, kind, uploaded=source.uploaded))
    in_order = sorted(missing, key=lambda part: not part.needed)
    return {**read, "format": contents.format, "reading": reading, "missing": in_order}


def _draw(projections: Projections, folder: Path) -> None:
    """Draw the first view or the middle row's sinogram, whichever needs less of the file, unless both need too much."""
    views, *several, cells = projections.shape
    rows = several[0] if several else 1
    together_views, together_rows = projections.together
    of_view, of_row = min(together_views, views) * rows, views * min(together_rows, rows)
    if 4 * cells * min(of_view, of_row) > MOST_READ_BYTES:
        return
    if rows > 1 and of_view <= of_row:
        name, image = ScanPicture.VIEW, projections.read(slice(0, 1), slice(0, rows))[0]
    else:
        name, image = ScanPicture.SINOGRAM, projections.read(slice(0, views), slice(rows // 2, rows // 2 + 1))[:, 0]
    grey = 255 * small_square(np.nan_to_num(image), PICTURE_PX)
    (folder / name).write_bytes(np.rint(grey).astype(np.uint8).tobytes())


def _reading(contents: FileContents, source: InspectionInput, scan: CanonicalScan | None) -> InspectedReading:
    views, *rows, detector = contents.projections.shape
    fields = [
        None if fields is None else len(fields) if fields.ndim == len(contents.projections.shape) else 1
        for fields in (contents.flats, contents.darks)
    ]
    remarks = contents.remarks if scan is None else scan.remarks
    return InspectedReading(
        data=source.data,
        shape=ScanShape(views=views, rows=rows[0] if rows else 1, detector=detector),
        flats=fields[0],
        darks=fields[1],
        angles=None if scan is None else _angles(scan, contents),
        detector_pitch_mm=contents.pitch.mm or source.detector_pitch_mm,
        row_pitch_mm=contents.row_pitch.mm or source.row_pitch_mm,
        detector_modules=list(contents.detector_modules),
        detector_arc_radius_mm=contents.detector_arc_radius_mm,
        unused=contents.unused,
        other_files=[str(path) for path in contents.others],
        remarks=list(remarks),
        coded_remarks=[CodedReason.of(each) for each in remarks],
    )


def _angles(scan: CanonicalScan, contents: FileContents) -> ViewAngles:
    first, last = np.rad2deg(scan.angles_rad[[0, -1]]).tolist()
    return ViewAngles(
        first_deg=first, last_deg=last, from_file=contents.angles.deg is not None, file_unit=contents.angles.unit
    )


def _missing(
    contents: FileContents, reading: InspectedReading, kind: OwnKind | None, *, uploaded: bool
) -> Iterator[MissingPart]:
    if reading.data is None:
        yield _missing_kind(contents, kind, uploaded=uploaded)
    if contents.flats is None and reading.data is DataKind.COUNTS:
        yield MissingPart(name="flat fields", flag="--flats", why="counts need at least one")
    hint = "" if contents.unused is None else f"; it holds {contents.unused}"
    if reading.detector_pitch_mm is None:
        why = f"the file carries no distance between detector cells{hint}"
        yield MissingPart(name="detector pitch", flag="--detector-pitch-mm", field="detector_pitch_mm", why=why)
    if reading.row_pitch_mm is None and reading.shape.rows > 1:
        why = "without the distance between rows slices are counted, not placed in mm"
        yield MissingPart(name="row pitch", flag="--row-pitch-mm", field="row_pitch_mm", why=why, needed=False)
    if contents.darks is None and reading.data is DataKind.COUNTS:
        why = "without dark fields the detector's offset is taken as zero"
        yield MissingPart(name="dark fields", flag="--darks", why=why, needed=False)
    why = f"calibrate needs the distance from the source to the centre of rotation, and reads it from no scan{hint}"
    yield MissingPart(
        name="source to centre of rotation", flag="--source-to-cor-mm", field="source_to_cor_mm", why=why, needed=False
    )


def _missing_kind(contents: FileContents, kind: OwnKind | None, *, uploaded: bool) -> MissingPart:
    flats = "flat fields in the same file" if uploaded else "--flats here"
    flag, why = "--data counts|line-integrals", f"no file states reliably what its numbers are; counts need {flats}"
    if contents.flats is not None:
        flag, why = "--data counts", "the file carries flat fields, as counts do; line integrals are refused with them"
    elif kind is OwnKind.SCAN:
        flag, why = "--data line-integrals", "this product wrote the file, of line integrals"
    return MissingPart(name="what the numbers are", flag=flag, field="data", why=why)


def _failure(code: str, detail: str) -> Failure:
    return Failure(kind=FailureKind.INPUT, code=code, detail=detail)
