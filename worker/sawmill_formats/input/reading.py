"""The one entry point: any file, with the client's parameters, to a canonical scan."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.input.angles import AngleList, AnglesGiven, AngleSteps
from sawmill_formats.input.arrays import MAX_BYTES, Bounds, as_fields
from sawmill_formats.input.canonical import AveragedRows, CanonicalScan
from sawmill_formats.input.contents import (
    FieldKind,
    FileContents,
    FilePitch,
    Projections,
    Wanted,
    fields_in_order,
    in_order,
    named_axes,
)
from sawmill_formats.input.given_fields import with_fields, without_odd_fields
from sawmill_formats.input.hdf5.links import LinkedFilesOnDisk
from sawmill_formats.input.plausible import closes, unit_of_angles_asked
from sawmill_formats.input.recognising import recognise
from sawmill_vocabulary import WIDEST_CELL_MM
from sawmill_vocabulary.messages import Reason, selected
from sawmill_vocabulary.reading_messages import ReadingMessage

ANGLE_TOLERANCE_DEG = 1e-6
SINGLE_PRECISION = 2.0**-23
PITCH_TOLERANCE = 1e-6
ROWS_FIRST = "axes=rows,views,cells, on the command line --axes rows,views,cells"
TRANSPOSE_FLAG = "on the command line --transpose"
TRANSPOSE = f"transpose, {TRANSPOSE_FLAG}"
ROWS_LAST = "axes=views,cells,rows, on the command line --axes views,cells,rows"
# A line of this few cells shows no log; a stack of this many rows is rather the line.
LEAST_ROWS_DOUBTED, MOST_CELLS_DOUBTED = 256, 32
# A short scan covers a half turn and the fan of the rays.
HALF_TURN_DEG, WIDEST_FAN_DEG = 180.0, 60.0
# Share of the free memory for data that are read as a whole; the rest is for one block at a time, and the libraries.
MEMORY_SHARE = 0.9


@contextmanager
def reading_scan(
    path: Path,
    *,
    counts: bool,
    dataset: str | None = None,
    angles_deg: AnglesGiven | None = None,
    detector_pitch_mm: float | None = None,
    row_pitch_mm: float | None = None,
    rows_missing: bool = False,
    averaged_rows: int | None = None,
    turns: bool = True,
    transpose: bool = False,
    axes: str | None = None,
    flats: Path | None = None,
    darks: Path | None = None,
    follow_links: bool = False,
    max_bytes: int = MAX_BYTES,
    free_bytes: int | None = None,
) -> Iterator[CanonicalScan]:
    """Open a scan's file of any supported format, recognised by its content and never by its name.

    The file stays open in the block: `CanonicalScan.blocks` reads its projections.

    Parameters
    ----------
    path : Path
        The file, as it was uploaded.
    counts : bool
        Whether the data are detector counts; else they are line integrals. This is never guessed.
    dataset : str, optional
        Path or name of the projections, where the file holds several candidates.
    angles_deg : AngleSteps or AngleList, optional
        The views' angles, where the file carries none.
    detector_pitch_mm, row_pitch_mm : float, optional
        Known distances between cells and between rows; a file with other values is refused.
    rows_missing : bool
        Whether views may lack rows at the top or the bottom: NaN in every cell, for counts also zero. They become NaN.
    averaged_rows : int, optional
        The number of detector rows whose line integrals were averaged into the one row of the file.
    turns : bool
        Whether the object turns; else the views are passages through a fixed pair, and their angles are not read.
    transpose : bool
        Whether the file has the axes in reverse order, (detector, views) or (detector, rows, views).
    axes : str, optional
        Names of the file's axes in their order, such as rows,views,cells, as an alternative to `transpose`.
    flats, darks : Path, optional
        Files of the flat and of the dark fields, where the scan's file carries none.
    follow_links : bool
        Whether HDF5 may lead into other files, by links, as virtual datasets or as raw data; never for an upload.
    max_bytes : int
        Largest size of one array, as float32 or as stored, whichever is more.
    free_bytes : int, optional
        The machine's free memory: what has to be read as a whole and does not fit is refused before it is read.

    Raises
    ------
    UnreadableScan
        When the file cannot be read, is not a scan, or contradicts a parameter.
    """
    if not counts and (flats or darks):
        raise UnreadableScan(
            "contradiction",
            "flat and dark fields (--flats, --darks) belong to counts and the data were declared line integrals; "
            "declare counts, or leave the fields out",
        )
    with reading_contents(
        path,
        counts=counts,
        dataset=dataset,
        deviations=averaged_rows is not None,
        turns=turns,
        transpose=transpose,
        axes=axes,
        flats=flats,
        darks=darks,
        follow_links=follow_links,
        max_bytes=max_bytes,
        free_bytes=free_bytes,
    ) as contents:
        yield canonical_scan(
            contents,
            counts=counts,
            angles_deg=angles_deg,
            detector_pitch_mm=detector_pitch_mm,
            row_pitch_mm=row_pitch_mm,
            rows_missing=rows_missing,
            averaged_rows=averaged_rows,
            turns=turns,
        )


@contextmanager
def reading_contents(
    path: Path,
    *,
    counts: bool = False,
    dataset: str | None = None,
    deviations: bool = False,
    turns: bool = True,
    transpose: bool = False,
    axes: str | None = None,
    flats: Path | None = None,
    darks: Path | None = None,
    follow_links: bool = False,
    max_bytes: int = MAX_BYTES,
    free_bytes: int | None = None,
) -> Iterator[FileContents]:
    """Open a file for what it holds of a scan, and files of fields; other parameters as in `reading_scan`.

    Parameters
    ----------
    counts : bool
        Whether counts were declared, which need fields: they are recognised by similar names too.
    deviations : bool
        Whether the file may hold the projections' standard deviations.
    """
    recognised = recognise(path)
    elsewhere = {FieldKind.FLATS: flats, FieldKind.DARKS: darks}
    similar = frozenset(kind for kind, file in elsewhere.items() if counts and file is None)
    apart = frozenset(file.resolve() for file in elsewhere.values() if file is not None)
    selection = Wanted(
        dataset, deviations=deviations, transpose=transpose, apart=apart, axes=axes, similar=similar, turns=turns
    )
    with ExitStack() as files:
        linked = LinkedFilesOnDisk(files) if follow_links else None
        bounds = replace(reading_bounds(free_bytes, max_bytes), linked=linked)
        with library_errors_translated(recognised.name):
            contents = recognised.read(path, selection, bounds, files)
        contents = _in_order(with_fields(contents, flats, darks, bounds), selection)
        together, shape = contents.projections.together, contents.projections.shape
        views, rows = (min(n, most) for n, most in zip(together, shape, strict=False))
        # Twice in memory, as stored and as float32.
        if (needed := 4 * views * rows * shape[-1]) > bounds.piece:
            raise UnreadableScan(
                "too-large",
                f"the file stores its projections in pieces of {needed} bytes, where pieces of {bounds.piece} fit into "
                "the free memory; store them in smaller chunks",
            )
        other_files = contents.others if linked is None else (*contents.others, *linked.paths)
        yield replace(contents, projections=_translated(contents.projections, recognised.name), others=other_files)


def reading_bounds(free_bytes: int | None, max_bytes: int = MAX_BYTES) -> Bounds:
    """Return how much may be read with this free memory, or any amount for None."""
    # Divided by two: for a moment an array is there as stored and as float32, and there are flat and dark fields.
    return Bounds(max_bytes, max_bytes if free_bytes is None else min(max_bytes, int(MEMORY_SHARE * free_bytes) // 2))


def canonical_scan(
    contents: FileContents,
    *,
    counts: bool,
    angles_deg: AnglesGiven | None = None,
    detector_pitch_mm: float | None = None,
    row_pitch_mm: float | None = None,
    rows_missing: bool = False,
    averaged_rows: int | None = None,
    turns: bool = True,
) -> CanonicalScan:
    """Build the scan from a file's contents, compared with the client's parameters; parameters as in `reading_scan`."""
    projections = contents.projections
    dimensions = len(projections.shape)
    angles, remarks = agree_on_angles(contents, angles_deg) if turns else (np.zeros(projections.shape[0]), ())
    pitch_mm = agree_on_pitch("detector_pitch_mm", contents.pitch, detector_pitch_mm)
    row_pitch_mm = agree_on_pitch("row_pitch_mm", contents.row_pitch, row_pitch_mm)
    remarks = (*remarks, *(unit_of_angles_asked(angles, contents.angles.unit) if turns else ()))
    if pitch_mm is not None and pitch_mm > WIDEST_CELL_MM:
        remarks += (ReadingMessage.PITCH_ASKED(pitch_mm=pitch_mm, largest_mm=WIDEST_CELL_MM),)
    remarks += _darks_lacking(contents) if counts else ()
    if counts and contents.flats is None and FieldKind.FLATS in contents.possible_fields:
        raise UnreadableScan(
            "flats-missing",
            "counts need at least one flat field, and it is not clear which of these arrays they are: "
            f"{contents.possible_fields[FieldKind.FLATS]}; name the right one flats, or give its file (--flats)",
        )
    flats = None if contents.flats is None else as_fields("flat", contents.flats, dimensions)
    darks = None if contents.darks is None else as_fields("dark", contents.darks, dimensions)
    if flats is not None and len(flats) and (darks is None or darks.shape[1:] == flats.shape[1:]):
        flats, darks, of_fields = without_odd_fields(flats, darks)
        remarks = (*remarks, *of_fields)
    return CanonicalScan(
        projections=projections,
        angles_rad=np.deg2rad(angles),
        counts=counts,
        flats=flats,
        darks=darks,
        detector_pitch_mm=pitch_mm,
        row_pitch_mm=row_pitch_mm,
        format=contents.format,
        remarks=(*contents.remarks, *remarks),
        rows_missing=rows_missing,
        unused=contents.unused,
        others=contents.others,
        detector_modules=contents.detector_modules,
        turns=turns,
        detector_arc_radius_mm=contents.detector_arc_radius_mm,
        averaged=(
            None if averaged_rows is None else AveragedRows.of(averaged_rows, projections.shape, contents.deviations)
        ),
    )


def _darks_lacking(contents: FileContents) -> tuple[Reason, ...]:
    if contents.darks is None:
        unclear = contents.possible_fields.get(FieldKind.DARKS)
        return (ReadingMessage.DARKS_UNCLEAR(arrays=unclear) if unclear else ReadingMessage.NO_DARKS(),)
    return () if contents.darks.any() else (ReadingMessage.DARKS_ZERO(),)


def _steps_doubted(contents: FileContents, angles_given: AnglesGiven | None) -> tuple[Reason, ...]:
    """Remark that the axes may be in another order, where steps or lengths fit another one; else steps of no turn."""
    views, *several, cells = contents.projections.shape
    rows = several[0] if several else 1
    option = ROWS_LAST if rows >= LEAST_ROWS_DOUBTED and cells <= MOST_CELLS_DOUBTED else None
    step_deg = abs(angles_given.step_deg) if isinstance(angles_given, AngleSteps) else 0.0
    covered_deg, open_turn = views * step_deg, step_deg > 0.0 and not closes(views, step_deg, 360.0)
    if open_turn and not (180.0 <= covered_deg <= 360.0 or closes(views, step_deg, 180.0)):
        others = ((rows, ROWS_FIRST), (cells, TRANSPOSE))
        option = next((cure for length, cure in others if closes(length, step_deg, 360.0)), option)
    if option and not (contents.order or contents.angles_of_axis):
        return (ReadingMessage.AXES_DOUBTED(views=views, rows=rows, cells=cells, option=option),)
    is_short_scan = HALF_TURN_DEG + step_deg < covered_deg <= HALF_TURN_DEG + WIDEST_FAN_DEG
    if not open_turn or is_short_scan or contents.angles.deg is not None:
        return ()
    return (ReadingMessage.NO_WHOLE_TURN(views=views, step_deg=f"{step_deg:g}", covered_deg=f"{covered_deg:g}"),)


def _in_order(contents: FileContents, selection: Wanted) -> FileContents:
    """Put the axes of the projections, and of all parts with the same axes, into our order, and remark on it."""
    given_order = selection.order(len(contents.projections.shape))
    order = given_order or contents.order
    if order is None:
        return contents
    projections = in_order(contents.projections, order)
    flats, darks, deviations = (
        fields_in_order(fields, order, projections.shape)
        for fields in (contents.flats, contents.darks, contents.deviations)
    )
    ordered = ReadingMessage.AXES_ORDERED if given_order else ReadingMessage.AXES_STATED
    return replace(
        contents,
        projections=projections,
        flats=flats,
        darks=darks,
        deviations=deviations,
        order=order,
        remarks=(*contents.remarks, ordered(axes=named_axes(order))),
    )


def _translated(projections: Projections, what: str) -> Projections:
    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        with library_errors_translated(what):
            return projections.read(views, rows)

    return replace(projections, read=read)


def agree_on_angles(
    contents: FileContents, angles_given: AnglesGiven | None
) -> tuple[NDArray[np.float64], tuple[Reason, ...]]:
    """Return the views' angles (views,) in degrees, from the file or as given, and remarks."""
    carried, of_axis = contents.angles, contents.angles_of_axis
    if carried.deg is not None:
        _check_axis("the file carries", carried.deg.size, contents)
    if isinstance(angles_given, AngleList):
        _check_axis("there are", len(angles_given.values_deg), contents)
    hint = None
    if of_axis is not None:
        what = "cells" if of_axis[0] == len(contents.projections.shape) - 1 else "rows"
        hint = f"{of_axis[1]} fits the {what}, not the views: {_ordering(contents, of_axis[0])}"
    doubts = _steps_doubted(contents, angles_given)
    if angles_given is None:
        if carried.deg is not None:
            return carried.deg, doubts
        reason = carried.unusable or hint or "the file carries no angles"
        raise UnreadableScan(
            "angles-mismatch" if any(selected((reason,), ReadingMessage.ANGLES_OF_OTHER_NUMBER)) else "angles-missing",
            f"{reason}; give the angles as START:STEP in degrees, as in 0.5:1, or one for each view (angles_deg, on "
            "the command line --angles-deg or --angles-file)",
        )
    angles = angles_given.expand(contents.projections.shape[0])
    if carried.deg is not None:
        if carried.deg.shape != angles.shape:
            raise UnreadableScan(
                "angles-mismatch",
                f"the file carries {carried.deg.size} angles for {angles.size} views; each view needs its own",
            )
        # A file may keep its angles in single precision, which is coarser than the tolerance near 360 degrees.
        different = ~(np.abs(carried.deg - angles) <= ANGLE_TOLERANCE_DEG + SINGLE_PRECISION * np.abs(angles))
        if different.any():
            view = int(np.argmax(different))
            raise UnreadableScan(
                "contradiction",
                f"the file says that view {view} is at {carried.deg[view]:.9g} degrees and the angles given say "
                f"{angles[view]:.9g}; leave the angles out or correct them",
            )
        return carried.deg, doubts
    if carried.unusable is not None:
        return angles, (*doubts, ReadingMessage.ANGLES_GIVEN(carried.unusable))
    return angles, doubts if hint is None else (*doubts, ReadingMessage.ANGLES_GIVEN_BUT(why=hint))


def _check_axis(who: str, number: int, contents: FileContents) -> None:
    """Refuse a number of angles that equals the length of another axis and not of the first."""
    views, *rows, cells = contents.projections.shape
    if number not in {1, views} and number in {*rows, cells}:
        axis, what = (len(rows) + 1, "cell") if number == cells else (1, "row")
        option = _ordering(contents, axis)
        raise UnreadableScan("angles-mismatch", f"{who} {number} angles, one for each {what}: {option}")


def _ordering(contents: FileContents, axis: int) -> str:
    """Return the option by which another axis than the first is read as the views'."""
    views, *rows, cells = contents.projections.shape
    read, order = f"the file was read as {views} views of {cells} cells", contents.order
    if order == tuple(reversed(range(len(rows) + 2))):
        return (
            f"with transpose {read}; if it holds {cells} views of {views} cells, leave transpose out ({TRANSPOSE_FLAG})"
        )
    if order is not None:
        return f"in the order {named_axes(order)} {read}; correct that order (axes, on the command line --axes)"
    if axis <= len(rows):
        return f"{read} by {rows[0]} rows; if it holds {rows[0]} views, give the order of its axes: {ROWS_FIRST}"
    return (
        f"{read}; if it holds {cells} views of {views} cells, as MATLAB's radon writes them, give transpose "
        f"({TRANSPOSE_FLAG})"
    )


def agree_on_pitch(name: str, carried: FilePitch, given_mm: float | None) -> float | None:
    """Return a distance in mm, from the file or as given, or None; refuse two that differ.

    The file's may be given as it was before it was multiplied by the binning.
    """
    if carried.mm is None or given_mm is None:
        return carried.mm if given_mm is None else given_mm
    for in_file in (carried.mm, carried.mm / carried.binning):
        if abs(in_file - given_mm) <= PITCH_TOLERANCE * abs(given_mm):
            return in_file
    raise UnreadableScan(
        "contradiction",
        f"the file says that {name} is {carried.mm:.9g} and {given_mm:.9g} was given (by flag, or the scanner's); "
        "correct one of them",
    )
