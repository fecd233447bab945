"""Preparation of a scan into the file that every job uses: corrected line integrals, in bounded memory.

Masked rays of a scan that was sent as the mean over rows are interpolated, with larger standard deviations.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.failures import check_disk
from sawmill_calibration.scans.row_alignment import AlignedRows, Views, align_rows
from sawmill_contracts.scans import PrepareOptions
from sawmill_formats.input.canonical import AveragedRows, CanonicalScan
from sawmill_formats.output.scan_writer import RowsPresent, new_scan
from sawmill_tomography.preparing.line_integrals import SATURATION, Exposure
from sawmill_tomography.preparing.row_corrections import Corrections, RowCorrector
from sawmill_tomography.sinograms.present_rows import bridge_masked, present_rows
from sawmill_tomography.sinograms.screening import usable_views
from sawmill_vocabulary import AirCorrection, FaultyCells, Progress, ProgressCallback, RingRemoval, RowAlignment
from sawmill_vocabulary.messages import Reason, numbered, selected
from sawmill_vocabulary.reading_messages import PreparingMessage

Stack = NDArray[np.float32]

# Samples in memory at a time, as float32. Intermediate results, of a row or a view at a time, need additional memory.
WINDOW_BYTES = 128 * 2**20
# The largest drift of the source since the flat fields, as a line integral: a quarter fewer counts. A level beyond it
# is not air (tests/worker/jobs/test_prepare.py).
LARGEST_DRIFT = 0.3


class AveragedRays:
    """Rays of a scan (views, 1, detector) that was sent as a mean of rows; deviations are 0 where not known."""

    def __init__(self, averaged: AveragedRows, shape: tuple[int, int, int]) -> None:
        self._averaged, self._shape, self._masked, self._samples = averaged, shape, 0, 0
        self.deviations = None if averaged.deviations is None else averaged.deviations.copy()

    def bridge(self, samples: NDArray[np.float32], first_view: int) -> None:
        """Interpolate masked rays, NaN in (views, 1, detector), in place; their deviations are at least the median."""
        rays = samples[:, 0]
        masked = np.isnan(rays)
        self._samples += masked.size
        if not masked.any():
            return
        self._masked += int(masked.sum())
        bridged = rays.astype(np.float64)
        missed = bridge_masked(bridged, masked)
        rays[...] = bridged
        if self.deviations is None:
            self.deviations = np.zeros(self._shape[::2], np.float32)
        for deviations, misses, gaps in zip(self.deviations[first_view:], missed, masked, strict=False):
            deviations[gaps] = np.maximum(misses[gaps], np.median(deviations[~gaps]))

    def remarks(self) -> tuple[Reason, ...]:
        """Report what was sent, and how it was changed."""
        alone = self._averaged.deviations is None
        came = PreparingMessage.MEAN_OF_ROWS if alone else PreparingMessage.MEAN_WITH_DEVIATIONS
        return came(rows=self._averaged.rows), (
            PreparingMessage.RAYS_MASKED(masked=self._masked, samples=self._samples)
            if self._masked
            else PreparingMessage.NO_RAY_MASKED()
        )


def of_masked_rays(remarks: Collection[str]) -> str | None:
    """Select the remark on a prepared scan that reports masked rays; None if no ray was masked."""
    return next(selected(remarks, PreparingMessage.RAYS_MASKED), None)


@dataclass(frozen=True)
class PreparedScan:
    """Shape (views, rows, detector) of a prepared scan, the steps, rows that enough views have, and corrupt views."""

    shape: tuple[int, int, int]
    remarks: tuple[Reason, ...]
    usable_rows: tuple[int, int] | None = None
    views_left_out: tuple[int, ...] = ()


def prepare_scan(
    read: CanonicalScan,
    options: PrepareOptions,
    output: Path,
    *,
    detector_pitch_mm: float,
    report: ProgressCallback,
    provenance: Mapping[str, str] | None = None,
    window_bytes: int = WINDOW_BYTES,
) -> PreparedScan:
    """Write a scan to a file: counts become line integrals; faulty cells, air, rings and missing rows are corrected.

    Rows are prepared while they are read if the file can be read row by row; otherwise all rows are read a second
    time. Aligned views are read two or three more times. The output file appears when it is complete.

    Parameters
    ----------
    read : CanonicalScan
        An open scan.
    output : Path
        The file that is written; `sawmill_formats.output.scan_reader` reads it.
    provenance : mapping of str to str, optional
        Origin of the data; written into the file with the remarks.
    window_bytes : int
        Samples in memory at a time, as float32: at least what the file stores in one piece, one view, and one row of
        all views.

    Raises
    ------
    UnreadableScan, CountsError, RowsError
        The samples cannot belong to a scan, the counts cannot be converted, or the views cannot be aligned.
    JobFailure, OSError
        The file does not fit on the disk, or cannot be written.
    """
    check_disk(output.parent, "a scan", read.shape, 4 * math.prod(read.shape), "give fewer rows")
    preparation, aligns = _RowPreparation(read, options), options.align_rows is not RowAlignment.OFF
    step_views, _ = read.block_shape(window_bytes)
    by_views = step_views < read.shape[0]
    afterwards = preparation.needed and (by_views or aligns)
    # A scan that is prepared later is read again, and its views may be moved.
    progress = _PassProgress(report, read.shape, passes=1 + afterwards + (2 + afterwards) * aligns)
    at_a_time = _within(window_bytes, read.shape[1:])
    with new_scan(
        output,
        read.shape,
        angles_rad=read.angles_rad,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=read.row_pitch_mm,
        detector_modules=read.detector_modules,
        detector_arc_radius_mm=read.detector_arc_radius_mm,
        views_together=min(step_views, at_a_time) if by_views or aligns else None,
    ) as written:
        averaged = None if read.averaged is None else AveragedRays(read.averaged, read.shape)
        present = _copy(read, written.data, averaged, None if afterwards else preparation, window_bytes, progress)

        prepare = partial(_prepare_rows, written.data, preparation, window_bytes, progress) if afterwards else None
        aligned: AlignedRows | None = None
        if aligns:
            aligned = align_rows(
                Views(written.data, present, at_a_time, lambda samples: progress.add(samples, "align rows")),
                read.angles_rad,
                options.align_rows,
                estimate=preparation.estimate,
                prepare=prepare,
            )
        elif prepare is not None:
            prepare()
        preparation.check_signal()
        came_as = () if averaged is None else averaged.remarks()
        left_out = preparation.views_left_out
        of_views = PreparingMessage.VIEWS_LEFT_OUT(number=len(left_out), total=read.shape[0], views=numbered(left_out))
        remarks = (*read.remarks, *came_as, *preparation.remarks(), *([of_views] if left_out else []))
        if aligned is not None:
            remarks = (*remarks, *aligned.remarks(options.align_rows))
        lacking = None if aligned is None or aligned.present.all() else RowsPresent(aligned.present, aligned.usable)
        written.note(
            air_level=_air_level(preparation, aligned),
            saturated_share=preparation.saturated_share(),
            provenance={**(provenance or {}), "remarks": "\n".join(remarks)},
            row_shifts=None if aligned is None else aligned.shifts.rows,
            row_shift_deviations=None if aligned is None else aligned.shifts.standard_deviation,
            rows_present=lacking,
            deviations=None if averaged is None else averaged.deviations,
            views_left_out=left_out,
        )
        return PreparedScan(written.data.shape, remarks, None if lacking is None else lacking.usable, left_out)


def repeated(remarks: Collection[str]) -> tuple[str, ...]:
    """Select the remarks on a prepared scan that a calibration must repeat."""
    return tuple(selected(remarks, *SATURATION, PreparingMessage.VIEWS_LEFT_OUT))


def _air_level(preparation: "_RowPreparation", aligned: AlignedRows | None) -> Stack | None:
    """Return the air level of counts, (rows, detector) float32; the median where file rows mix detector rows."""
    level = preparation.air_level()
    if level is None or aligned is None or not aligned.mixed:
        return level
    return np.tile(np.median(level, axis=0), (len(level), 1))


class _RowPreparation:
    """Preparation of any rows of a scan: conversion of counts to line integrals, then corrections."""

    def __init__(self, read: CanonicalScan, options: PrepareOptions) -> None:
        self._views, rows, self._cells = read.shape
        self._exposure = None if read.flats is None else Exposure.of(read.flats, read.darks)
        self._corrections = _corrections(options, counts=read.counts)
        self._corrector = RowCorrector(self._corrections, rows, self._cells)
        self._starved, self._samples, self._brightest = 0, 0, 0.0
        self._at_largest = np.zeros((rows, self._cells), np.intp)
        self._sums, self._numbers = np.zeros((self._views, self._cells)), np.zeros((self._views, 1), np.intp)

    @property
    def needed(self) -> bool:
        """True if the scan needs any preparation."""
        return self._exposure is not None or not self._corrections.none

    def apply(self, stack: Stack, first_view: int, first_row: int) -> None:
        """Prepare rows (views, rows, detector) in place: all views of some rows where something is to be prepared."""
        there = present_rows(stack)[:, :, np.newaxis]
        if self._exposure is not None:
            at_largest = self._exposure.at_largest(stack)
            brightest = np.max(stack, axis=(1, 2), where=there, initial=0.0)
            starved = self._exposure.to_line_integrals(stack, first_row)
        sums, numbers = np.sum(stack, axis=1, dtype=np.float64, where=there), there.sum(axis=1)
        self._sums[first_view : first_view + len(stack)] += sums
        self._numbers[first_view : first_view + len(stack)] += numbers
        if not self.needed:
            return
        # Corrupt views would spoil what is learnt from all views of a row.
        usable = usable_views(sums / np.maximum(numbers, 1))
        part = stack if usable.all() else stack[usable]
        if self._exposure is not None:
            self._brightest = max(self._brightest, float(brightest[usable].max()))
            self._at_largest[first_row : first_row + stack.shape[1]] += at_largest[usable].sum(axis=0)
            self._starved += int(starved[usable].sum())
            self._samples += part.size
        if not self._corrections.none:
            self._corrector.correct(part, first_row)
        if part is not stack:
            stack[usable] = part

    @property
    def views_left_out(self) -> tuple[int, ...]:
        """Numbers of the views that are corrupt in the mean over the rows."""
        return tuple(np.flatnonzero(~usable_views(self._sums / np.maximum(self._numbers, 1))).tolist())

    def check_signal(self) -> None:
        """Refuse counts without signal, after all counts were prepared."""
        if self._exposure is not None:
            self._exposure.check_signal(self._starved, self._samples)

    def remarks(self) -> tuple[Reason, ...]:
        """Describe the steps that were applied."""
        of_counts: tuple[Reason, ...] = ()
        if self._exposure is not None:
            of_counts = self._exposure.remarks(self._starved, int(self._saturated(self._exposure).sum()))
        return of_counts if self._corrections.none else (*of_counts, *self._corrector.result().remarks)

    def saturated_share(self) -> float | None:
        """Return the share of the cells that are saturated in the flats or in the views; None for line integrals."""
        exposure = self._exposure
        return None if exposure is None else exposure.saturated_share(self._saturated(exposure), self._views)

    def _saturated(self, exposure: Exposure) -> NDArray[np.intp]:
        return exposure.saturated_samples(self._at_largest, self._brightest)

    def air_level(self) -> Stack | None:
        """Return the air level of counts, mean flat minus mean dark, (rows, detector) float32; 0 in bridged cells."""
        if self._exposure is None:
            return None
        return np.where(self._corrector.result().faulty, np.float32(0.0), self._exposure.air_level)

    def estimate(self, stack: Stack) -> None:
        """Convert (views, rows, detector) in place while row numbers and faulty cells are unknown: medians of 3."""
        if self._exposure is not None:
            self._exposure.same_in_all_rows().to_line_integrals(stack)
        for image in stack:  # image by image, so that the temporary arrays fit into memory with a block
            left, right = image[:, :-2].copy(), image[:, 2:].copy()
            np.clip(image[:, 1:-1], np.minimum(left, right), np.maximum(left, right), out=image[:, 1:-1])


def _corrections(options: PrepareOptions, *, counts: bool) -> Corrections:
    """Resolve `auto` in the options: counts are corrected, declared line integrals are used unchanged."""
    by_kind = FaultyCells.BRIDGE if counts else FaultyCells.KEEP
    faulty_cells = by_kind if options.faulty_cells is FaultyCells.AUTO else options.faulty_cells
    return Corrections(
        air=(AirCorrection.VIEWS if counts else AirCorrection.OFF)
        if options.air is AirCorrection.AUTO
        else options.air,
        largest_air_level=LARGEST_DRIFT if options.air is AirCorrection.AUTO else math.inf,
        bridge_faulty_cells=faulty_cells is FaultyCells.BRIDGE,
        remove_rings=options.rings is RingRemoval.SORTING,
    )


class _PassProgress:
    """Progress over several passes through a scan, in samples."""

    def __init__(self, report: ProgressCallback, shape: tuple[int, ...], *, passes: int) -> None:
        self._report, self._total, self._done = report, passes * math.prod(shape), 0

    def add(self, samples: int, stage: str) -> None:
        """Report a number of additional samples."""
        self._done += samples
        self._report(Progress(fraction=min(self._done / self._total, 1.0), stage=stage))


def _within(window_bytes: int, shape: tuple[int, ...]) -> int:
    """Return the number of arrays of a shape that fit into the window; at least one."""
    return max(1, window_bytes // (4 * math.prod(shape)))


def _copy(
    read: CanonicalScan,
    data: h5py.Dataset,
    averaged: AveragedRays | None,
    preparation: _RowPreparation | None,
    window_bytes: int,
    progress: _PassProgress,
) -> NDArray[np.bool_]:
    """Copy every sample into the dataset, prepared if a preparation is given; return the present (views, rows)."""
    present = np.empty(read.shape[:2], bool)
    for block in read.blocks(window_bytes):
        if averaged is not None:
            averaged.bridge(block.samples, block.views.start)
        present[block.views, block.rows] = present_rows(block.samples)
        if preparation is not None:
            preparation.apply(block.samples, block.views.start, block.rows.start)
        data[block.views, block.rows] = block.samples
        progress.add(block.samples.size, "read")
        del block  # before the next block is read
    return present


def _prepare_rows(data: h5py.Dataset, preparation: _RowPreparation, window_bytes: int, progress: _PassProgress) -> None:
    views, rows, cells = data.shape
    step = _within(window_bytes, (views, cells))
    for first in range(0, rows, step):
        block = data[:, first : first + step]
        preparation.apply(block, 0, first)
        data[:, first : first + step] = block
        progress.add(block.size, "prepare")
        del block  # before the next block is read
