"""The one entry point: any file, with the client's parameters, to a canonical scan."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.input.angles import AngleList, AnglesGiven, AngleSteps
from sawmill_formats.input.arrays import MAX_BYTES, Bounds, as_fields
from sawmill_formats.input.averaged import AveragedRows
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.contents import FileContents, Projections, fields_in_order, in_order, named_axes
from sawmill_formats.input.given_fields import with_fields
from sawmill_formats.input.hdf5.links import LinkedFilesOnDisk
from sawmill_formats.input.odd_fields import without_odd_fields
from sawmill_formats.input.plausible import (
    LARGEST_USUAL_PITCH_MM,
    closes,
    unit_of_angles_asked,
)
from sawmill_formats.input.recognising import recognise
from sawmill_formats.input.wanted import FieldKind, Wanted
from sawmill_vocabulary.messages import Reason, selected
from sawmill_vocabulary.reading_messages import ReadingMessage

ANGLE_TOLERANCE_DEG = 1e-6
SINGLE_PRECISION = 2.0**-23
PITCH_TOLERANCE = 1e-6
ROWS_FIRST = "axes=rows,views,cells, on the command line --axes rows,views,cells"
TRANSPOSE = "transpose, on the command line --transpose"
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
    opened = reading_contents(
        path,
        counts=counts,
        dataset=dataset,
        deviations=averaged_rows is not None,
        transpose=transpose,
        axes=axes,
        flats=flats,
        darks=darks,
        follow_links=follow_links,
        max_bytes=max_bytes,
        free_bytes=free_bytes,
    )
    with opened as contents:
        yield canonical_scan(
            contents,
            counts=counts,
            angles_deg=angles_deg,
            detector_pitch_mm=detector_pitch_mm,
            row_pitch_mm=row_pitch_mm,
            rows_missing=rows_missing,
            averaged_rows=averaged_rows,
        )


@contextmanager
def reading_contents(
    path: Path,
    *,
    counts: bool = False,
    dataset: str | None = None,
    deviations: bool = False,
    transpose: bool = False,
    axes: str | None = None,
    flats: Path | None = None,
    darks: Path | None = None,
    follow_links: bool = False,
    max_bytes: int = MAX_BYTES,
    free_bytes: int | None = None,
) -> Iterator[FileContents]:
    """Open a file for what it holds of a scan, and the files of its fields; other parameters as in `reading_scan`.

    Parameters
    ----------
    counts : bool
        Whether counts were declared, which need fields: they are recognised by similar names too.
    deviations : bool
        Whether the file may hold the projections' standard deviations.

    Raises
    ------
    UnreadableScan
        When a file cannot be read, or is not a scan.
    """
    recognised = recognise(path)
    elsewhere = {FieldKind.FLATS: flats, FieldKind.DARKS: darks}
    similar = frozenset(kind for kind, file in elsewhere.items() if counts and file is None)
    apart = frozenset(file.resolve() for file in elsewhere.values() if file is not None)
    selection = Wanted(dataset, deviations=deviations, transpose=transpose, apart=apart, axes=axes, similar=similar)
    with ExitStack() as files:
        linked = LinkedFilesOnDisk(files) if follow_links else None
        bounds = replace(reading_bounds(free_bytes, max_bytes), linked=linked)
        with library_errors_translated(recognised.name):
            contents = recognised.read(path, selection, bounds, files)
        contents = with_fields(contents, flats, darks, bounds)
        given_order = selection.order(len(contents.projections.shape))
        order = given_order or contents.order
        if order is not None:
            asked = ReadingMessage.AXES_REVERSED() if transpose else ReadingMessage.AXES_ORDERED(axes=named_axes(order))
            contents = _in_order(contents, order, (asked,) if given_order else ())
        _check_piece(contents.projections, bounds.piece)
        other_files = contents.others if linked is None else (*contents.others, *linked.paths)
        yield replace(contents, projections=_translated(contents.projections, recognised.name), others=other_files)


def reading_bounds(free_bytes: int | None, max_bytes: int = MAX_BYTES) -> Bounds:
    """Return how much may be read with this free memory, or any amount for None."""
    # Divided by two: for a moment an array is there as stored and as float32, and there are flat and dark fields.
    piece = max_bytes if free_bytes is None else min(max_bytes, int(MEMORY_SHARE * free_bytes) // 2)
    return Bounds(max_bytes, piece)


def canonical_scan(
    contents: FileContents,
    *,
    counts: bool,
    angles_deg: AnglesGiven | None = None,
    detector_pitch_mm: float | None = None,
    row_pitch_mm: float | None = None,
    rows_missing: bool = False,
    averaged_rows: int | None = None,
) -> CanonicalScan:
    """Build the scan from a file's contents, compared with the client's parameters; parameters as in `reading_scan`.

    Raises
    ------
    UnreadableScan
        When contents and parameters contradict each other, or the parts do not agree.
    """
    projections = contents.projections
    dimensions = len(projections.shape)
    angles, remarks = agree_on_angles(contents, angles_deg)
    pitch_mm = agree_on_pitch(
        "detector_pitch_mm", contents.detector_pitch_mm, detector_pitch_mm, binning=contents.detector_binning
    )
    row_pitch_mm = agree_on_pitch("row_pitch_mm", contents.row_pitch_mm, row_pitch_mm, binning=contents.row_binning)
    doubts = (*_axes_doubted(contents, angles_deg), *unit_of_angles_asked(angles, contents.angles_unit))
    remarks = (*remarks, *doubts, *_pitch_asked(pitch_mm), *(_darks_lacking(contents) if counts else ()))
    if counts and contents.flats is None and FieldKind.FLATS in contents.possible_fields:
        raise UnreadableScan(
            "flats-missing",
            "counts need at least one flat field, and it is not clear which of these arrays they are: "
            f"{contents.possible_fields[FieldKind.FLATS]}; name the right one flats, or give its file (--flats)",
        )
    flats = None if contents.flats is None else as_fields("flat", contents.flats, dimensions)
    darks = None if contents.darks is None else as_fields("dark", contents.darks, dimensions)
    if flats is not None and flats.size and (darks is None or (darks.size and darks.shape[1:] == flats.shape[1:])):
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
        averaged=(
            None if averaged_rows is None else AveragedRows.of(averaged_rows, projections.shape, contents.deviations)
        ),
    )


def _darks_lacking(contents: FileContents) -> tuple[Reason, ...]:
    if contents.darks is None:
        unclear = contents.possible_fields.get(FieldKind.DARKS)
        return (ReadingMessage.DARKS_UNCLEAR(arrays=unclear) if unclear else ReadingMessage.NO_DARKS(),)
    return () if contents.darks.any() else (ReadingMessage.DARKS_ZERO(),)


def _pitch_asked(pitch_mm: float | None) -> tuple[Reason, ...]:
    if pitch_mm is None or pitch_mm <= LARGEST_USUAL_PITCH_MM:
        return ()
    return (ReadingMessage.PITCH_ASKED(pitch_mm=pitch_mm, largest_mm=LARGEST_USUAL_PITCH_MM),)


def _axes_doubted(contents: FileContents, angles_given: AnglesGiven | None) -> tuple[Reason, ...]:
    """Return the remark that the axes may be in another order, where steps or lengths fit another one."""
    views, *several, cells = contents.projections.shape
    rows, option = several[0] if several else 1, None
    if rows >= LEAST_ROWS_DOUBTED and cells <= MOST_CELLS_DOUBTED:
        option = ROWS_LAST
    if isinstance(angles_given, AngleSteps) and not 180.0 <= views * abs(angles_given.step_deg) <= 360.0:
        fits_turn = partial(closes, step=angles_given.step_deg, period=360.0)
        if not closes(views, angles_given.step_deg, 180.0):
            option = ROWS_FIRST if fits_turn(rows) else TRANSPOSE if fits_turn(cells) else option
    if option is None or contents.order or contents.angles_of_axis:
        return ()
    return (ReadingMessage.AXES_DOUBTED(views=views, rows=rows, cells=cells, option=option),)


def _in_order(contents: FileContents, order: tuple[int, ...], remarks: tuple[Reason, ...]) -> FileContents:
    """Put the axes of the projections, and of all parts with the same axes, into our order."""
    projections = in_order(contents.projections, order)
    flats, darks, deviations = (
        fields_in_order(fields, order, projections.shape)
        for fields in (contents.flats, contents.darks, contents.deviations)
    )
    return replace(
        contents,
        projections=projections,
        flats=flats,
        darks=darks,
        deviations=deviations,
        order=order,
        remarks=(*contents.remarks, *remarks),
    )


def _check_piece(projections: Projections, most_bytes: int) -> None:
    """Refuse data stored in pieces that cannot be in memory twice, as stored and as float32."""
    views, rows = (min(n, most) for n, most in zip(projections.together, projections.shape, strict=False))
    needed = 4 * views * rows * projections.shape[-1]
    if needed > most_bytes:
        raise UnreadableScan(
            "too-large",
            f"the file stores its projections in pieces of {needed} bytes, where pieces of {most_bytes} fit into the "
            "free memory; store them in smaller chunks",
        )


def _translated(projections: Projections, what: str) -> Projections:
    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        with library_errors_translated(what):
            return projections.read(views, rows)

    return replace(projections, read=read)


def agree_on_angles(
    contents: FileContents, angles_given: AnglesGiven | None
) -> tuple[NDArray[np.float64], tuple[Reason, ...]]:
    """Return the views' angles (views,) in degrees, from the file or as given, and remarks.

    Raises
    ------
    UnreadableScan
        There are no angles, or the file's and the given ones differ, or their number is the number of cells.
    """
    _check_axis("the file carries", None if contents.angles_deg is None else contents.angles_deg.size, contents)
    _check_axis("there are", len(angles_given.values_deg) if isinstance(angles_given, AngleList) else None, contents)
    hint = None
    if contents.angles_of_axis is not None:
        axis, arrays = contents.angles_of_axis
        what = "cells" if axis == len(contents.projections.shape) - 1 else "rows"
        hint = f"{arrays} fits the {what}, not the views: {_ordering(contents, axis)}"
    if angles_given is None:
        if contents.angles_deg is None:
            reason = contents.angles_unusable or hint or "the file carries no angles"
            other_number = any(selected((reason,), ReadingMessage.ANGLES_OF_OTHER_NUMBER))
            raise UnreadableScan(
                "angles-mismatch" if other_number else "angles-missing",
                f"{reason}; give the angles as START:STEP in degrees, as in 0.5:1, or one for each view "
                "(angles_deg, on the command line --angles-deg or --angles-file)",
            )
        return contents.angles_deg, ()
    angles = angles_given.expand(contents.projections.shape[0])
    if contents.angles_deg is not None:
        _check_same_angles(contents.angles_deg, angles)
        return contents.angles_deg, ()
    turn = _no_whole_turn(angles_given, angles.size)
    if contents.angles_unusable is not None:
        return angles, (*turn, ReadingMessage.ANGLES_GIVEN(contents.angles_unusable))
    return angles, turn if hint is None else (*turn, ReadingMessage.ANGLES_GIVEN_BUT(why=hint))


def _no_whole_turn(angles_given: AnglesGiven, views: int) -> tuple[Reason, ...]:
    """Remark steps that make neither whole turns, of which the last view may repeat the first one, nor a short scan."""
    if not isinstance(angles_given, AngleSteps):
        return ()
    step_deg = abs(angles_given.step_deg)
    covered_deg = views * step_deg
    # Half a step less than a turn to half a step more than a turn and one view.
    beyond_deg = (covered_deg + step_deg / 2) % 360.0
    is_short_scan = HALF_TURN_DEG + step_deg < covered_deg <= HALF_TURN_DEG + WIDEST_FAN_DEG
    if is_short_scan or (covered_deg + step_deg / 2 >= 360.0 and beyond_deg <= 2.0 * step_deg):
        return ()
    return (ReadingMessage.NO_WHOLE_TURN(views=views, step_deg=f"{step_deg:g}", covered_deg=f"{covered_deg:g}"),)


def _check_axis(who: str, number: int | None, contents: FileContents) -> None:
    """Refuse a number of angles that equals the length of another axis and not of the first."""
    views, *rows, cells = contents.projections.shape
    if number in {None, 1, views} or number not in {*rows, cells}:
        return
    axis, what = (-1, "cell") if number == cells else (1, "row")
    raise UnreadableScan("angles-mismatch", f"{who} {number} angles, one for each {what}: {_ordering(contents, axis)}")


def _ordering(contents: FileContents, axis: int) -> str:
    """Return the option by which another axis than the first is read as the views'."""
    shape = contents.projections.shape
    read = f"the file was read as {shape[0]} views of {shape[-1]} cells"
    if contents.order is not None and contents.order != tuple(reversed(range(len(shape)))):
        return (
            f"in the order {named_axes(contents.order)} {read}; correct that order (axes, on the command line --axes)"
        )
    if shape[axis] != shape[-1]:
        return f"{read} by {shape[1]} rows; if it holds {shape[1]} views, give the order of its axes: {ROWS_FIRST}"
    if contents.order is not None:
        return (
            f"with transpose {read}; if it holds {shape[-1]} views of {shape[0]} cells, leave transpose out (on the "
            "command line --transpose)"
        )
    return (
        f"{read}; if it holds {shape[-1]} views of {shape[0]} cells, as MATLAB's radon writes them, give transpose (on "
        "the command line --transpose)"
    )


def _check_same_angles(in_file: NDArray[np.float64], angles_given: NDArray[np.float64]) -> None:
    if in_file.shape != angles_given.shape:
        raise UnreadableScan(
            "angles-mismatch",
            f"the file carries {in_file.size} angles for {angles_given.size} views; each view needs its own",
        )
    # A file may keep its angles in single precision, which is coarser than the tolerance near 360 degrees.
    different = ~(np.abs(in_file - angles_given) <= ANGLE_TOLERANCE_DEG + SINGLE_PRECISION * np.abs(angles_given))
    if different.any():
        view = int(np.argmax(different))
        raise UnreadableScan(
            "contradiction",
            f"the file says that view {view} is at {in_file[view]:.9g} degrees and the angles given say "
            f"{angles_given[view]:.9g}; leave the angles out or correct them",
        )


def agree_on_pitch(name: str, in_file: float | None, given_mm: float | None, *, binning: int = 1) -> float | None:
    """Return a distance in mm, from the file or as given, or None; refuse two that differ.

    The file's may be given as it was before it was multiplied by the binning.
    """
    if in_file is None or given_mm is None:
        return in_file if given_mm is None else given_mm
    if binning > 1 and abs(in_file / binning - given_mm) <= PITCH_TOLERANCE * abs(given_mm):
        return given_mm
    if abs(in_file - given_mm) > PITCH_TOLERANCE * abs(given_mm):
        raise UnreadableScan(
            "contradiction",
            f"the file says that {name} is {in_file:.9g} and {given_mm:.9g} was given (by flag, or the "
            "scanner's); correct one of them",
        )
    return in_file
