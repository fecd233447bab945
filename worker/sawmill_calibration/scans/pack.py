"""Packing of a scan for other people: images and geometry alone, without names, times, serial numbers and paths."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sawmill_calibration.failures import memory_available, refused
from sawmill_calibration.scans.scan_rows import ScanSource, links_offered, of_file
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_formats import nxtomo
from sawmill_formats.errors import library_errors_translated
from sawmill_formats.input.arrays import as_fields
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.own import is_prepared_from_counts
from sawmill_formats.input.reading import canonical_scan, reading_bounds, reading_contents
from sawmill_formats.input.statements import Statement, statements
from sawmill_formats.nexus import CHUNK_BYTES
from sawmill_formats.output.scan_writer import write_raw_scan
from sawmill_formats.reading_apart import read_apart
from sawmill_vocabulary import DataKind

# Fields of a phantom's measurement that say who measured, with what and when.
OF_THE_MEASUREMENT = dict.fromkeys(("measured_on", "instrument", "expires_on"))


@dataclass(frozen=True, eq=False)
class ScanPack:
    """A scan that is ready to be packed."""

    kept: dict[str, str]  # what is kept, in words, by what it is
    left_out: list[Statement]  # what else the scan's files state
    unknown: dict[str, str]  # what a calibration may need and the pack lacks, with the flag that gives it
    write: Callable[[Path], None]  # writes the packed file, whole or not at all


@contextmanager
def packing(
    source: ScanSource, *, source_to_cor_mm: float | None = None, drawing: PhantomDrawing | None = None
) -> Iterator[ScanPack]:
    """Open a scan to pack it; the packed file is read as the scan is, and holds nothing that is not listed as kept.

    Parameters
    ----------
    source : ScanSource
        The scan, and the options of reading it.
    source_to_cor_mm : float, optional
        r_S, mm, which no scan states.
    drawing : PhantomDrawing, optional
        Drawing of the phantom that the scan shows.

    Raises
    ------
    UnreadableScan
        The scan, or a value that was given for it, cannot be used.
    """
    options, path = source.options, source.path
    read_apart(path, options.flats, options.darks, follow_links=options.follow_links)
    arc, turns = options.detector_arc_radius_mm, options.object_turns.value
    given: dict[str, Any] = {"source_to_cor_mm": source_to_cor_mm, "detector_arc_radius_mm": arc, "object_turns": turns}
    given[nxtomo.PHANTOM_JSON] = None if drawing is None else _unnamed(drawing)
    given = {name: value for name, value in given.items() if value is not None}
    with library_errors_translated("scan"):
        stated = list(statements(path, reading_bounds(memory_available())))
    beside = (each for each in path.absolute().parent.glob(f"{path.stem}.*") if each.name != path.name)
    stated += [Statement("a file beside it", each.name, private=True) for each in beside]
    if is_prepared_from_counts(path):
        raise refused("prepared-scan", f"{path.name!r} was prepared from counts: pack the file that the scanner wrote")
    opened = reading_contents(path, **of_file(options))
    with links_offered(followed=options.follow_links), opened as contents:
        scan = canonical_scan(
            contents,
            counts=options.data is DataKind.COUNTS,
            angles_deg=source.angles,
            detector_pitch_mm=options.detector_pitch_mm,
            row_pitch_mm=options.row_pitch_mm,
        )
        yield _pack(scan, stated, given, partial(_write, contents, scan, given))


def _unnamed(drawing: PhantomDrawing) -> str:
    """Return the drawing as JSON, without names and days."""
    measured = [
        each.model_copy(update=OF_THE_MEASUREMENT | ({} if each.dimension in {"x", "y"} else {"dimension": "length"}))
        for each in drawing.measurements
    ]
    bare = drawing.model_copy(update={"name": "phantom", "follows": None, "measurements": measured})
    return bare.model_dump_json(exclude_none=True)


def _pack(
    scan: CanonicalScan, left_out: list[Statement], given: dict[str, Any], write: Callable[[Path], None]
) -> ScanPack:
    views, rows, cells = scan.shape
    first, last = np.rad2deg(scan.angles_rad[[0, -1]])
    fields = {"flat fields": "--flats", "dark fields": "--darks"} if scan.counts else {}
    flags = {"detector pitch": "--detector-pitch-mm", "row pitch": "--row-pitch-mm", **fields}
    flags |= {"source_to_cor_mm": "--source-to-cor-mm", nxtomo.PHANTOM_JSON: "--phantom, of a scan of a phantom"}
    held = {name: len(images) for name in fields if (images := getattr(scan, f"{name[:4]}s")) is not None}
    pitches = {"detector pitch": scan.detector_pitch_mm, "row pitch": scan.row_pitch_mm}
    kept = {
        "projections": f"{views} views x {rows} rows x {cells} cells, {'counts' if scan.counts else 'line integrals'}",
        "angles": f"{first:.7g} to {last:.7g} degrees",
        **{name: f"{pitch:.9g} mm" for name, pitch in pitches.items() if pitch is not None},
        **{name: str(value) for name, value in (held | given).items()},
    }
    if scan.detector_modules:
        kept["modules"] = ", ".join(f"at cell {module.first_cell}" for module in scan.detector_modules)
    return ScanPack(kept, left_out, {name: flag for name, flag in flags.items() if name not in kept}, write)


def _write(contents: FileContents, scan: CanonicalScan, given: dict[str, Any], path: Path) -> None:
    """Write counts with all fields, or line integrals, in the layout of a scanner."""
    flats, darks = (
        None if images is None else as_fields("field", images, len(contents.projections.shape))
        for images in (contents.flats, contents.darks)
    )
    views, rows, cells = scan.shape
    step = max(contents.projections.together[0], CHUNK_BYTES // (4 * rows * cells))
    starts = range(0, views, step)
    blocks = (contents.projections.read(slice(first, min(first + step, views)), slice(0, rows)) for first in starts)
    write_raw_scan(
        path,
        scan.shape,
        np.dtype(np.float32),
        counts=blocks,
        flats=flats,
        darks=darks,
        angles_rad=scan.angles_rad,
        detector_pitch_mm=scan.detector_pitch_mm,
        row_pitch_mm=scan.row_pitch_mm,
        detector_modules=scan.detector_modules,
        given=given,
    )
