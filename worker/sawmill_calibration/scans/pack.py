"""Packing of a scan for other people: images and geometry alone, without names, times, serial numbers and paths."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
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
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.own import is_own_scan
from sawmill_formats.input.reading import reading_bounds, reading_scan
from sawmill_formats.input.statements import statements
from sawmill_formats.nexus import CHUNK_BYTES
from sawmill_formats.output.scan_reader import open_scan
from sawmill_formats.output.scan_writer import write_raw_scan
from sawmill_formats.reading_apart import read_apart


@dataclass(frozen=True, eq=False)
class ScanPack:
    """A scan that is ready to be packed."""

    kept: dict[str, str]  # what is kept, in words, by what it is
    left_out: dict[str, str]  # what else the scan's file states, by its place
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
    source_to_cor_mm, drawing : optional
        What the owner gives: r_S, mm, and the drawing of the phantom in the scan.

    Raises
    ------
    UnreadableScan, InputError
        The scan cannot be used, or was prepared from counts.
    """
    options, path = source.options, source.path
    read_apart(path, options.flats, options.darks, follow_links=options.follow_links)
    given: dict[str, Any] = {"source_to_cor_mm": source_to_cor_mm, "object_turns": options.object_turns.value}
    given["detector_arc_radius_mm"] = options.detector_arc_radius_mm
    given[nxtomo.PHANTOM_JSON] = drawing and _unnamed(drawing)
    given = {name: value for name, value in given.items() if value is not None}
    with library_errors_translated("scan"):
        left_out = dict(statements(path, reading_bounds(memory_available())))
    for each in path.absolute().parent.glob(f"{path.stem}.*"):
        left_out |= {} if each.name == path.name else {f"beside it: {each.name}": "is not read"}
    with open_scan(path) if is_own_scan(path) else nullcontext() as own:
        if own is not None and not (own.air_level is own.present is own.deviations is None):
            raise refused("scan-refused", f"{path.name!r} was prepared from counts: pack the scanner's own file")
    opened = reading_scan(
        path,
        **of_file(options),
        angles_deg=source.angles,
        detector_pitch_mm=options.detector_pitch_mm,
        row_pitch_mm=options.row_pitch_mm,
    )
    with links_offered(followed=options.follow_links), opened as scan:
        if scan.detector_arc_radius_mm is not None:
            given.setdefault("detector_arc_radius_mm", scan.detector_arc_radius_mm)
        kept, unknown = _described(scan, given)
        yield ScanPack(kept, left_out, unknown, partial(_write, scan, given))


def _unnamed(drawing: PhantomDrawing) -> str:
    """Return the drawing as JSON, without names, and without who measured it, with what and when."""
    gone: dict[str, Any] = dict.fromkeys(("measured_on", "instrument", "expires_on"))
    other = gone | {"dimension": "length"}
    measured = [one.model_copy(update=gone if one.dimension in {"x", "y"} else other) for one in drawing.measurements]
    bare = drawing.model_copy(update={"name": "phantom", "follows": None, "measurements": measured})
    return bare.model_dump_json(exclude_none=True)


def _described(scan: CanonicalScan, given: dict[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Describe what is kept, and name the flags of what is not known."""
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
        "modules": str(1 + len(scan.detector_modules)),
        **{name: f"{pitch:.9g} mm" for name, pitch in pitches.items() if pitch is not None},
        **{name: str(value) for name, value in (held | given).items()},
    }
    return kept, {name: flag for name, flag in flags.items() if name not in kept}


def _write(scan: CanonicalScan, given: dict[str, Any], path: Path) -> None:
    """Write counts with their fields, or line integrals, in the layout of a scanner."""
    words = ", ".join(f"{name} ({value})" for name, value in given.items() if name != nxtomo.PHANTOM_JSON)
    views, rows, cells = scan.shape
    step = max(scan.projections.together[0], CHUNK_BYTES // (4 * rows * cells))
    blocks = (scan.projections.read(slice(at, min(at + step, views)), slice(0, rows)) for at in range(0, views, step))
    write_raw_scan(
        path,
        scan.shape,
        np.dtype(np.float32),
        counts=blocks,
        flats=scan.flats,
        darks=scan.darks,
        angles_rad=scan.angles_rad,
        detector_pitch_mm=scan.detector_pitch_mm,
        row_pitch_mm=scan.row_pitch_mm,
        detector_modules=scan.detector_modules,
        detector_arc_radius_mm=given.get("detector_arc_radius_mm"),
        given=given | {nxtomo.CONSTANTS: words},
    )
