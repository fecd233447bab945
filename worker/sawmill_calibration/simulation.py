"""Simulated scans, exact and seeded, in memory or as a file: line integrals, or counts with a mill's physics."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter

from sawmill_calibration.failures import InputError, input_errors_translated, options_of, read_json
from sawmill_calibration.known_geometry import drawing_of, to_phantom
from sawmill_calibration.scans.scan import Scan, read_scan
from sawmill_contracts.geometry import SimulationOptions
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.output.scan_writer import new_scan, write_raw_scan
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, SourceFrame, to_vector
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel, log_slices
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.physics.passages import Passage, simulate_passages
from sawmill_tomography.projection.simulate import UNEQUAL_CELLS, SimulatedStack, simulate_rows, simulate_stack
from sawmill_vocabulary import DataKind, Handedness, PairedScanner, Rotation, Scanner, Theta
from sawmill_vocabulary.physics import Physics


def simulate_phantom_scan(
    phantom: Phantom | str | Path,
    scanner: Scanner,
    theta: Theta,
    *,
    views: int | None = None,
    angles_deg: ArrayLike | None = None,
    rows: int = 1,
    position_mm: tuple[float, float] = (0.0, 0.0),
    handedness: Handedness | str = Handedness.AS_DRAWN,
    rotation: Rotation | str = Rotation.AS_GIVEN,
    noise: float = 0.0,
    background: float = 0.0,
    physics: Physics | Mapping[str, object] | str | Path | None = None,
    photons: float = 30_000.0,
    seed: int = 1,
) -> Scan:
    """Simulate a scan of a phantom, the same in each row.

    Parameters
    ----------
    phantom : Phantom, str or Path
        A phantom, the name of a built-in one, or the path of a drawing (JSON).
    scanner : Scanner
        Known constants of the scanner.
    theta : Theta
        The scanner's geometry.
    views : int, optional
        Number of views of a full turn, 360 by default, starting at half a step.
    angles_deg : (views,), optional
        Every view's angle, degrees, instead of `views`.
    rows : int
        Number of detector rows.
    position_mm : (x, y)
        Position of the drawing's origin, mm.
    handedness : str
        End from which the phantom is seen, `as-drawn` or `from-behind`.
    rotation : str
        Sense of rotation, `as-given` or `reversed`: which way the angles count.
    noise : float
        Standard deviation, relative to the RMS of the noise-free sinogram.
    background : float
        Constant that is added to all line integrals.
    physics : mapping, or the path of a JSON file, optional
        Effects of a mill, with the fields in docs/do/simulate.md: the scan is then made as counts with ten flat and
        dark fields, read as a file of counts is, and has no other noise or background.
    photons : float
        Number of photons in air, a cell and view; used with physics.
    seed : int
        Seed of the noise.
    """
    _check(rows=rows, noise=noise, background=background, photons=photons, seed=seed)
    wood = physics is not None
    if wood and (noise or background):
        raise InputError("options", "give physics, or noise and background, not both: counts have their own noise")
    slices = phantom_slices(drawing_of(phantom), rows, Handedness(handedness), position_mm, as_wood=wood)
    angles = _angles_rad(views, angles_deg)
    geometry = FanBeamGeometry(scanner, theta, Rotation(rotation).apply(angles))
    if physics is None:
        return _scan_of(slices, geometry, angles, noise, background, seed, None)
    effects = read_physics(Path(physics)) if isinstance(physics, str | Path) else options_of(Physics, physics)
    with input_errors_translated(), TemporaryDirectory(prefix="sawmill-") as folder:
        path = Path(folder) / "scan.h5"
        write_counts(path, slices, geometry, angles, effects, photons=photons, seed=seed, row_pitch_mm=None)
        return read_scan(path, data=DataKind.COUNTS, source_to_cor_mm=scanner.source_to_cor_mm)


def simulate_log_scan(
    scanner: Scanner,
    theta: Theta,
    *,
    views: int | None = None,
    angles_deg: ArrayLike | None = None,
    rows: int = 1,
    row_pitch_mm: float = 2.0,
    rotation: Rotation | str = Rotation.AS_GIVEN,
    noise: float = 0.0,
    background: float = 0.0,
    seed: int = 1,
) -> Scan:
    """Simulate a scan of a synthetic log with knots.

    Parameters
    ----------
    scanner : Scanner
        Known constants of the scanner.
    theta : Theta
        The scanner's geometry.
    views : int, optional
        Number of views of a full turn, 360 by default, starting at half a step.
    angles_deg : (views,), optional
        Every view's angle, degrees, instead of `views`.
    rows : int
        Number of detector rows.
    row_pitch_mm : float
        Distance between two rows in the log, mm.
    rotation : str
        Sense of rotation, `as-given` or `reversed`: which way the angles count.
    noise : float
        Standard deviation, relative to the RMS of the noise-free sinogram.
    background : float
        Constant that is added to all line integrals.
    seed : int
        Seed of the log and of the noise.
    """
    _check(rows=rows, noise=noise, background=background, seed=seed)
    slices = log_slices(rows, row_pitch_mm=row_pitch_mm, seed=seed)
    angles = _angles_rad(views, angles_deg)
    geometry = FanBeamGeometry(scanner, theta, Rotation(rotation).apply(angles))
    return _scan_of(slices, geometry, angles, noise, background, seed, row_pitch_mm)


# How a board lies in simulated passages: places within this of the centre, mm, rolls that differ by this or more, rad,
# and standard deviations of slopes of place, mm per mm, and roll, rad per mm, along the feed.
PLACE_MM, APART_RAD, SLOPE, TWIST = 25.0, 0.5, 2e-3, 1e-6


def random_passages(count: int, seed: int) -> list[Passage]:
    """Draw how a body lies in each passage; no two rolls are alike."""
    rng = np.random.default_rng(seed)
    while True:
        rolls = rng.uniform(0.0, TAU, count)
        apart = np.abs(np.angle(np.exp(1j * (rolls[:, None] - rolls)))) + APART_RAD * np.eye(count)
        if (apart >= min(APART_RAD, TAU / (2 * count))).all():
            break
    return [
        Passage((float(x), float(y)), float(roll), (float(dx), float(dy)), float(TWIST * rng.standard_normal()))
        for (x, y), roll, (dx, dy) in zip(
            rng.uniform(-PLACE_MM, PLACE_MM, (count, 2)), rolls, SLOPE * rng.standard_normal((count, 2)), strict=True
        )
    ]


def write_passages(
    path: Path,
    body: Phantom | None,
    scanner: PairedScanner,
    physics: Physics | None = None,
    *,
    passages: int,
    rows: int,
    row_pitch_mm: float,
    off_mm: float,
    photons: float,
    seed: int,
) -> list[Path]:
    """Simulate passages of a phantom, or a log with nails, through fixed pairs into a file for each; return the files.

    The true places of the pairs are off the scanner's by `off_mm`, and by a tenth of as many degrees (standard
    deviations); a further file, whose name ends in `-true.json`, has them as a scanner. For a log, one that ends in
    `-marks.json` has the places (x, y, height) of metal and nails in each passage, mm in the same axes.
    """
    rng = np.random.default_rng((seed, passages))
    spread = off_mm * np.array([math.radians(0.1), 1.0, 1.0, 1.0, math.radians(0.1)])
    frames = [
        SourceFrame.from_vector(to_vector(pair.frame) + spread * rng.standard_normal(5)) for pair in scanner.pairs
    ]
    lies, log = random_passages(passages, seed), LogModel.with_nails(seed, length_mm=rows * row_pitch_mm)
    passed = simulate_passages(
        log.slice_at if body is None else body.centred(),
        scanner,
        frames,
        lies,
        physics or UNEQUAL_CELLS,
        rows=rows,
        row_pitch_mm=row_pitch_mm,
        photons=photons,
        seed=seed,
    )
    files = [path.with_name(f"{path.stem}-{number}{path.suffix}") for number in range(1, len(passed) + 1)]
    for file, pair, one in zip(files, scanner.pairs, passed, strict=True):
        flats, darks = (np.repeat(fields[:, None], rows, axis=1) for fields in (one.flats, one.darks))
        stack = SimulatedStack(one.counts, flats, darks)
        write_simulated_scan(file, stack, np.zeros(passages), pair.scanner, row_pitch_mm)
    if body is None:
        marks = [[lie.place_of(place) for place in log.metal_places_mm] for lie in lies]
        path.with_name(f"{path.stem}-marks.json").write_text(json.dumps({"passages": marks}, indent=2) + "\n")
    true = PairedScanner(tuple(pair.at(frame) for pair, frame in zip(scanner.pairs, frames, strict=True)))
    path.with_name(f"{path.stem}-true.json").write_bytes(TypeAdapter(PairedScanner).dump_json(true, indent=2) + b"\n")
    return files


def _check(**numbers: float) -> None:
    options_of(SimulationOptions, numbers)


def _angles_rad(views: int | None, angles_deg: ArrayLike | None) -> FloatArray:
    """Return the angles as `sawmill simulate` has them; giving both is wrong use."""
    if angles_deg is not None:
        if views is not None:
            raise InputError("options", "give views or angles_deg, not both")
        return np.deg2rad(np.asarray(angles_deg, np.float64))
    count = 360 if views is None else views
    _check(views=count)
    return np.deg2rad(AngleSteps(180.0 / count, 360.0 / count).expand(count))


def _scan_of(
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    angles_rad: FloatArray,
    noise: float,
    background: float,
    seed: int,
    row_pitch_mm: float | None,
) -> Scan:
    stack = simulate_rows(slices, geometry, noise=noise, background=background, seed=seed)
    return Scan.from_arrays(stack, angles_rad, geometry.scanner, row_pitch_mm=row_pitch_mm)


def phantom_slices(
    drawing: PhantomDrawing, rows: int, handedness: Handedness, position_mm: tuple[float, float], *, as_wood: bool
) -> list[Phantom]:
    """Return the same phantom for each row; with `as_wood` it attenuates like sapwood, else by its drawn densities."""
    drawn = to_phantom(drawing)
    moved = (drawn if handedness is Handedness.AS_DRAWN else drawn.mirrored()).moved(*position_mm)
    return [moved.of_density(SAPWOOD_PER_MM) if as_wood else moved] * rows


def read_physics(path: Path) -> Physics:
    """Read physical effects from a JSON file, whose fields docs/do/simulate.md lists; refuse any other file."""
    return read_json(path, Physics, code="physics", otherwise="no file of physics")


def write_counts(
    path: Path,
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    angles_rad: FloatArray,
    physics: Physics | None = None,
    *,
    photons: float,
    seed: int,
    row_pitch_mm: float | None,
) -> None:
    """Simulate counts with flat and dark fields, one cross-section (1/mm) per row, into an NXtomo file.

    The scanner counts angles_rad (views,), the geometry has the angles as they are.
    """
    stack = simulate_stack(slices, geometry, physics or UNEQUAL_CELLS, photons=photons, seed=seed)
    write_simulated_scan(path, stack, angles_rad, geometry.scanner, row_pitch_mm)


def write_line_integrals(
    path: Path,
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    angles_rad: FloatArray,
    *,
    noise: float,
    background: float,
    seed: int,
    row_pitch_mm: float | None,
) -> None:
    """Simulate line integrals, one cross-section per row, into a file, for angles_rad as in `write_counts`."""
    theta = json.dumps(vars(geometry.theta), separators=(",", ":"))
    stack = simulate_rows(slices, geometry, noise=noise, background=background, seed=seed)
    with new_scan(
        path,
        stack.shape,
        angles_rad=angles_rad,
        detector_pitch_mm=geometry.scanner.detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        detector_arc_radius_mm=geometry.scanner.detector_arc_radius_mm,
    ) as written:
        written.data[...] = stack
        written.note(air_level=None, provenance={"simulated": slices[-1].name, "seed": str(seed), "theta": theta})


def write_simulated_scan(
    path: Path, stack: SimulatedStack, angles_rad: FloatArray, scanner: Scanner, row_pitch_mm: float | None
) -> None:
    """Write counts, flat and dark fields as an NXtomo file; angles_rad (views,) are as the scanner counts them."""
    write_raw_scan(
        path,
        stack.counts.shape,
        stack.counts.dtype,
        counts=[stack.counts],
        flats=stack.flats,
        darks=stack.darks,
        angles_rad=angles_rad,
        detector_pitch_mm=scanner.detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        detector_arc_radius_mm=scanner.detector_arc_radius_mm,
    )
