"""Simulated scans in memory, exact and seeded: line integrals, or counts with a mill's physics."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import ArrayLike

from sawmill_calibration.conversion import to_phantom
from sawmill_calibration.input_errors import InputError, input_errors, options_of
from sawmill_calibration.phantoms import drawing_of
from sawmill_calibration.scans.scan import Scan, read_scan
from sawmill_calibration.scans.simulation import read_physics, write_simulated_scan
from sawmill_contracts.simulating import SimulationOptions
from sawmill_formats.input.angles import AngleSteps
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, log_slices
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import simulate_rows, simulate_stack
from sawmill_vocabulary import DataKind, Handedness, Rotation, Scanner, Theta
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

    Raises
    ------
    ValueError
        The phantom, the geometry or the physics is impossible.
    """
    _check(rows=rows, noise=noise, background=background, photons=photons, seed=seed)
    drawn = to_phantom(drawing_of(phantom))
    seen = drawn if Handedness(handedness) is Handedness.AS_DRAWN else drawn.mirrored()
    slices = [seen.moved(*position_mm)] * rows
    angles = _angles_rad(views, angles_deg)
    if physics is None:
        return _scan_of(slices, scanner, theta, angles, Rotation(rotation), noise, background, seed, None)
    if noise or background:
        raise InputError("options", "give physics, or noise and background, not both: counts have their own noise")
    geometry = FanBeamGeometry(scanner, theta, Rotation(rotation).apply(angles))
    return _counted(slices, geometry, angles, _physics(physics), photons, seed)


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

    Raises
    ------
    ValueError
        The geometry is impossible.
    """
    _check(rows=rows, noise=noise, background=background, seed=seed)
    slices = log_slices(rows, row_pitch_mm=row_pitch_mm, seed=seed)
    angles = _angles_rad(views, angles_deg)
    return _scan_of(slices, scanner, theta, angles, Rotation(rotation), noise, background, seed, row_pitch_mm)


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
    scanner: Scanner,
    theta: Theta,
    angles_rad: FloatArray,
    rotation: Rotation,
    noise: float,
    background: float,
    seed: int,
    row_pitch_mm: float | None,
) -> Scan:
    geometry = FanBeamGeometry(scanner, theta, rotation.apply(angles_rad))
    stack = simulate_rows(slices, geometry, noise=noise, background=background, seed=seed)
    return Scan.from_arrays(stack, angles_rad, scanner, row_pitch_mm=row_pitch_mm)


def _physics(physics: Physics | Mapping[str, object] | str | Path) -> Physics:
    if isinstance(physics, str | Path):
        with input_errors():
            return read_physics(Path(physics))
    return options_of(Physics, physics)


def _counted(
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    angles_rad: FloatArray,
    physics: Physics,
    photons: float,
    seed: int,
) -> Scan:
    """Simulate a scan of wood through a file of counts, which is read as a scanner's is."""
    wood = [body.of_density(SAPWOOD_PER_MM) for body in slices]
    with input_errors(), TemporaryDirectory(prefix="sawmill-") as folder:
        stack = simulate_stack(wood, geometry, physics, photons=photons, seed=seed)
        path = Path(folder) / "scan.h5"
        write_simulated_scan(
            path, stack, angles_rad, detector_pitch_mm=geometry.scanner.detector_pitch_mm, row_pitch_mm=None
        )
        return read_scan(path, data=DataKind.COUNTS, source_to_cor_mm=geometry.scanner.source_to_cor_mm)
