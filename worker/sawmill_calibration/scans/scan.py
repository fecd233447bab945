"""Scans in memory: read from a file, or made from arrays."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_calibration.failures import InputError, input_errors_translated, options_of, refused
from sawmill_calibration.pictures.templating import html_of
from sawmill_calibration.scans.scan_rows import ScanRows, ScanSource, chosen_rows, chosen_views, open_rows, unreported
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scans import UnregisteredScanOptions
from sawmill_formats.input.angles import AngleList, AnglesGiven, parse_angles
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import (
    AirCorrection,
    DataKind,
    DetectorModule,
    FaultyCells,
    ObjectTurns,
    ProgressCallback,
    RingRemoval,
    RowAlignment,
    Scanner,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_scanner(constants: ScannerConstants) -> Scanner:
    """Return the constants without the rows' pitch: a dataclass equals only one of the same class."""
    three = constants.source_to_cor_mm, constants.num_detector_pixels, constants.detector_pitch_mm
    return Scanner(*three).with_cells_of(constants)


@dataclass(frozen=True, eq=False)
class Scan:
    """Line integrals in memory with each view's angle; axes and signs as in docs/look-up/conventions.md.

    Attributes
    ----------
    line_integrals : (views, rows, cells) float32, dimensionless
        NaN in every cell of rows that a view lacks, which only a file that was read with `align_rows` has.
    angles_rad : (views,) float64
        View angles.
    scanner : Scanner
        Known constants of the scanner.
    rows : (first, stop)
        Rows of the file that are held: the first, and the one after the last.
    row_step : int
        Step of these rows.
    rows_chosen : bool
        Whether the user chose the rows: a calibration then averages all of them, and else finds the phantom's rows.
    row_pitch_mm : float or None
        Distance between two rows of the detector, where it is known.
    from_counts : bool
        Whether the line integrals were made from counts: volumes are then in 1/mm.
    sha256 : str
        Checksum of the file, or of the array.
    remarks : tuple of str
        Changes that were made to the data on reading.
    averaged_rows : int or None
        Number of rows, for a scan whose one row came as a mean of rows.
    deviations : (views, rows, cells) float32, or None
        Standard deviations of the line integrals, where they came with them.
    saturated_share : float
        Share of the detector's cells that are saturated, as far as it is known.
    detector_modules : tuple of DetectorModule
        Modules of the detector after the first, where the file states them.
    """

    line_integrals: NDArray[np.float32] = field(repr=False)
    angles_rad: FloatArray = field(repr=False)
    scanner: Scanner
    rows: tuple[int, int]
    row_step: int = 1
    rows_chosen: bool = False
    row_pitch_mm: float | None = None
    from_counts: bool = False
    sha256: str = field(default="", repr=False)
    remarks: tuple[str, ...] = ()
    averaged_rows: int | None = None
    deviations: NDArray[np.float32] | None = field(default=None, repr=False)
    saturated_share: float = 0.0
    detector_modules: tuple[DetectorModule, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        line_integrals: ArrayLike,
        angles_rad: ArrayLike,
        scanner: Scanner,
        *,
        row_pitch_mm: float | None = None,
        from_counts: bool = False,
    ) -> Self:
        """Make a scan of line integrals.

        Parameters
        ----------
        line_integrals : (views, rows, cells) or (views, cells)
            Line integrals, or one sinogram; dimensionless.
        angles_rad : (views,)
            View angles, rad.
        scanner : Scanner
            Known constants of the scanner.
        row_pitch_mm : float, optional
            Distance between two rows of the detector.
        from_counts : bool
            Whether the line integrals were made from counts: volumes are then in 1/mm.
        """
        values, angles = np.asarray(line_integrals, np.float32), np.asarray(angles_rad, np.float64)
        stack = np.ascontiguousarray(values[:, np.newaxis] if values.ndim == 2 else values)
        expected = (angles.size, scanner.num_detector_pixels)
        if stack.ndim != 3 or angles.ndim != 1 or (len(stack), stack.shape[2]) != expected or not stack.size:
            raise refused(
                "wrong-shape",
                f"line_integrals must be (views, cells) or (views, rows, cells) with {expected[0]} views, as "
                f"angles_rad has, and {expected[1]} cells, as the scanner has, not {values.shape}",
            )
        if not (np.isfinite(stack).all() and np.isfinite(angles).all()):
            raise refused("not-finite", "line_integrals and angles_rad must be finite numbers")
        digest = hashlib.sha256(stack.data).hexdigest()
        rows = (0, stack.shape[1])
        return cls(stack, angles, scanner, rows, row_pitch_mm=row_pitch_mm, from_counts=from_counts, sha256=digest)

    @property
    def constants(self) -> ScannerConstants:
        """The scanner's constants with the rows' pitch and the detector's modules."""
        known = options_of(ScannerConstants, {**vars(self.scanner), "row_pitch_mm": self.row_pitch_mm})
        return replace(known, detector_modules=self.detector_modules)

    @property
    def sinogram(self) -> FloatArray:
        """Mean over the rows that each view has, (views, cells) float64; NaN where a view has none."""
        mean, sinogram = mean_of_rows(self.line_integrals), np.full(self.line_integrals[:, 0].shape, np.nan)
        sinogram[mean.views] = mean.sinogram
        return sinogram

    def select(self, *, rows: str | None = None, views: int | None = None) -> "Scan":
        """Select a part of the scan.

        Parameters
        ----------
        rows : str, optional
            Rows `A:B` or `A:B:STEP`, counted within this scan.
        views : int, optional
            Number of views to use: every (total / views)-th.

        Raises
        ------
        ValueError
            There are no such rows, or fewer views.
        """
        if rows is None and views is None:
            return self
        total_views, total_rows, _ = self.line_integrals.shape
        part, kept = chosen_rows(rows, total_rows), chosen_views(views, total_views)
        numbers = range(*self.rows, self.row_step)[part]
        return replace(
            self,
            line_integrals=np.ascontiguousarray(self.line_integrals[kept, part]),
            angles_rad=self.angles_rad[kept],
            rows=(numbers.start, numbers.stop),
            row_step=numbers.step,
            rows_chosen=self.rows_chosen or rows is not None,
            deviations=None if self.deviations is None else self.deviations[kept, part],
        )

    def plot(self, row: int | None = None) -> "Figure":
        """Draw the sinogram of one row, counted within this scan, or the mean over the rows."""
        from sawmill_calibration.pictures.figures import sinogram_figure  # noqa: PLC0415 - matplotlib is slow to import

        sinogram = self.sinogram if row is None else self.line_integrals[:, row]
        title = "mean over the rows" if row is None else f"row {range(*self.rows, self.row_step)[row]}"
        return sinogram_figure(
            sinogram, angles_deg=np.rad2deg(self.angles_rad), pitch_mm=self.scanner.detector_pitch_mm, title=title
        )

    def _repr_html_(self) -> str:
        views, rows, cells = self.line_integrals.shape
        first, last = np.rad2deg(self.angles_rad[[0, -1]])
        table = [
            ("views", f"{views}, {first:.4g} to {last:.4g} degrees"),
            ("rows", f"{rows} ({self.rows[0]}:{self.rows[1]})"),
            ("cells", f"{cells}, {self.scanner.detector_pitch_mm:.6g} mm apart"),
            ("source to centre of rotation", f"{self.scanner.source_to_cor_mm:.6g} mm"),
            ("made of counts", "yes" if self.from_counts else "no"),
        ]
        return html_of("Scan", table, sentences=self.remarks)


def check_is_scan(scan: object) -> None:
    """Raise `InputError` for anything but a scan, such as an array or a path."""
    if not isinstance(scan, Scan):
        raise InputError("options", f"scan must be a Scan, which Scan(...) or read_scan(path) makes, not {type(scan)}")


def rows_in_file(scan: Scan, rows: str) -> str:
    """Convert rows A:B that count within a scan to rows of the file."""
    check_is_scan(scan)
    numbers = range(*scan.rows, scan.row_step)[chosen_rows(rows, scan.line_integrals.shape[1])]
    return f"{numbers.start}:{numbers.stop}"


def rows_of_memory(
    scan: Scan, *, rows: str | None = None, views: int | None = None, on_progress: ProgressCallback = unreported
) -> ScanRows:
    """Select a part of a scan for a calibration, a drift check or a reconstruction, which can read other rows too."""
    check_is_scan(scan)
    part, numbers = scan.select(rows=rows, views=views), range(*scan.rows, scan.row_step)
    kept = chosen_views(views, len(scan.line_integrals))

    def read_row(row: int) -> NDArray[np.float32]:
        if row in numbers:
            return np.asarray(scan.line_integrals[kept, numbers.index(row)])
        return np.full((kept.size, scan.line_integrals.shape[2]), np.nan, np.float32)

    return ScanRows(
        read=lambda start, stop: part.line_integrals[:, start:stop],
        read_row=read_row,
        usable_rows=scan.rows,
        angles_rad=part.angles_rad,
        rows=part.rows,
        row_step=part.row_step,
        scanner=scan.constants,
        counts=scan.from_counts,
        sha256=scan.sha256,
        remarks=scan.remarks,
        on_progress=on_progress,
        rows_named=part.rows_chosen,
        averaged_rows=scan.averaged_rows,
        deviations=part.deviations,
        saturated_share=scan.saturated_share,
        used_views=np.isin(np.arange(len(scan.line_integrals)), kept),
    )


def read_scan(
    path: str | Path,
    *,
    data: DataKind | str,
    source_to_cor_mm: float,
    angles_deg: str | Sequence[float] | None = None,
    detector_pitch_mm: float | None = None,
    row_pitch_mm: float | None = None,
    detector_arc_radius_mm: float | None = None,
    object_turns: ObjectTurns | str = ObjectTurns.IN_ONE_SCAN,
    dataset: str | None = None,
    follow_links: bool = False,
    flats: str | Path | None = None,
    darks: str | Path | None = None,
    rows: str | None = None,
    views: int | None = None,
    averaged_rows: int | None = None,
    transpose: bool = False,
    axes: str | None = None,
    air: AirCorrection | str = AirCorrection.AUTO,
    faulty_cells: FaultyCells | str = FaultyCells.AUTO,
    rings: RingRemoval | str = RingRemoval.OFF,
    align_rows: RowAlignment | str = RowAlignment.OFF,
    on_progress: ProgressCallback = unreported,
) -> Scan:
    """Read a scan from a file as the command line does (docs/look-up/formats.md).

    Parameters
    ----------
    path : str or Path
        A file (HDF5, TIFF, a ZIP of TIFFs, NPY, NPZ, MAT), or a folder of TIFFs.
    data : str
        Kind of the numbers, `counts` or `line-integrals`; never guessed.
    source_to_cor_mm : float
        r_S, source to centre of rotation, mm.
    angles_deg : str or sequence of float, optional
        View angles: `START:STEP` in degrees, or every view's angle; for a file that carries none.
    detector_pitch_mm : float, optional
        Distance between two cells, mm; for a file that does not carry it.
    row_pitch_mm : float, optional
        Distance between two rows of the detector, mm; for a file that does not carry it.
    detector_arc_radius_mm : float, optional
        Radius of the detector, mm, where its cells lie on an arc.
    object_turns : str
        When the object turns: `in-one-scan`, or `between-passages`, one for each view.
    dataset : str, optional
        Path or variable of the projections, where the file holds several.
    follow_links : bool
        Whether HDF5 may lead into other files, by links, as virtual datasets or as raw data.
    flats : str or Path, optional
        File or folder of the flat fields of counts; for a file that carries none.
    darks : str or Path, optional
        File or folder of the dark fields of counts; for a file that carries none.
    rows : str, optional
        Rows `A:B` or `A:B:STEP`; all by default.
    views : int, optional
        Number of views to use: every (total / views)-th.
    averaged_rows : int, optional
        The number of detector rows whose line integrals were averaged into the file's one row.
    transpose : bool
        Whether the axes are in reverse order: (cells, views), as MATLAB's radon writes, or (cells, rows, views).
    axes : str, optional
        Order of the file's axes, such as `rows,views,cells`, as an alternative to `transpose`.
    air : str
        Correction of the source's drift by the air beside the log (docs/understand/preparation.md).
    faulty_cells : str
        Bridging of dead and hot cells.
    rings : str
        Removal of rings.
    align_rows : str
        Alignment of views that lost rows.
    on_progress : callable, optional
        Called with an object that has the `fraction` of the work that is done, from 0 to 1, and its `stage`.

    Raises
    ------
    ValueError
        `InputError`: the file, or a parameter, cannot be used.
    """
    options = options_of(
        UnregisteredScanOptions,
        {
            "data": data,
            "dataset": dataset,
            "detector_pitch_mm": detector_pitch_mm,
            "row_pitch_mm": row_pitch_mm,
            "detector_arc_radius_mm": detector_arc_radius_mm,
            "object_turns": object_turns,
            "follow_links": follow_links,
            "flats": None if flats is None else Path(flats),
            "darks": None if darks is None else Path(darks),
            "averaged_rows": averaged_rows,
            "transpose": transpose,
            "axes": axes,
            "air": air,
            "faulty_cells": faulty_cells,
            "rings": rings,
            "align_rows": align_rows,
        },
    )
    with input_errors_translated():
        source = ScanSource(Path(path), options, _angles_given(angles_deg), views, rows)
        with open_rows(source, source_to_cor_mm=source_to_cor_mm, on_progress=on_progress) as used:
            return Scan(
                line_integrals=used.stack(),
                angles_rad=used.angles_rad,
                scanner=replace(as_scanner(used.scanner), detector_modules=()),
                rows=used.rows,
                row_step=used.row_step,
                rows_chosen=rows is not None,
                row_pitch_mm=used.scanner.row_pitch_mm,
                from_counts=used.counts,
                sha256=used.sha256,
                remarks=used.remarks,
                averaged_rows=averaged_rows,
                deviations=used.deviations,
                saturated_share=used.saturated_share,
                detector_modules=used.scanner.detector_modules,
            )


def _angles_given(angles_deg: str | Sequence[float] | None) -> AnglesGiven | None:
    if angles_deg is None or isinstance(angles_deg, str):
        return None if angles_deg is None else parse_angles(angles_deg)
    return AngleList(tuple(float(angle) for angle in angles_deg))
