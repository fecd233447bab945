"""Reconstruction of rows to a volume, block by block, shared by the job, the command line and Python users."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.checkpoints import NOTHING_KEPT, Keeper
from sawmill_calibration.failures import check_disk, memory_available
from sawmill_calibration.reconstruction.block_solvers import (
    BlockSolver,
    Images,
    LogTask,
    Settings,
    method_of,
    solver_of,
)
from sawmill_calibration.reconstruction.kept_blocks import FinishedBlock, KeptVolume, keep_settings, settings_of
from sawmill_calibration.reconstruction.method_findings import CurvePoints, gathered
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_calibration.view_vectors import AnyGeometry, ImportedGeometry, vectors_of
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_formats.output.volume_writer import NewVolume, new_reconstruction
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FanViews, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.choosing import recommend, views_of_step
from sawmill_tomography.reconstruction.iterative.coarse_outside import fitted_size
from sawmill_tomography.reconstruction.method import DirectMethod
from sawmill_tomography.reconstruction.object_extent import object_radius_mm, seen_radius_mm
from sawmill_tomography.reconstruction.stack import reconstruct_stack
from sawmill_tomography.reconstruction.view_poses import LEAST_VIEWS, find_view_poses, is_between_air
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.present_rows import filled, present_rows
from sawmill_tomography.sinograms.scattered_radiation import STEEPEST, straightened, without_scatter
from sawmill_vocabulary import (
    HardeningHandling,
    ObjectTurns,
    PoseHandling,
    Progress,
    ProgressCallback,
    ReconstructionMethod,
)
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection, BeamHardening
from sawmill_vocabulary.version import VERSION

# Returns the line integrals (views, stop - start, detector) float32 of the slices start..stop.
ReadRows = Callable[[int, int], NDArray[np.float32]]

# Takes the number of a block's first slice, the block's images, and the block's data for the report.
Write = Callable[[int, Images, FinishedBlock], None]

# Share of the free memory that blocks take at most: the rest is for file caches and other processes.
MEMORY_SHARE = 0.5
# Within the first block the remaining time is reported once this share of the work is done, or after this time.
PACE_SHARE, PACE_SECONDS = 0.05, 2.0
# Number of rows along the log whose extent is determined: a log tapers, bends and flares at its butt.
EXTENT_ROWS = 17
# Number of slices around the middle from which the coupling of slices is chosen.
SLICES_AROUND = 6
# Number of rows along the log from which the poses of its views are found.
POSE_ROWS = 3
# Number of values from which a volume's range is determined, and the percentiles of the range.
SAMPLED_VALUES = 4_000_000
PERCENTILES = (0.1, 97.0, 99.9)
# Metal is many times as dense as wood, and a nail that lies in a slice covers more than a thousandth of it. Knots are
# below this number of times the 97th percentile, which lies in the wood.
MOST_WOOD = 2.5


def volume_unit(*, counts: bool) -> str:
    """Return the unit of a volume: counts give attenuation per mm; line integrals keep their own unit."""
    return "1/mm" if counts else "line integral/mm"


def _with_beam_corrected(
    scan: ScanRows, beam: BeamCorrection, options: ReconstructionOptions
) -> tuple[ScanRows, BeamCorrection]:
    """Remove the calibration's scatter, with the air's level, and hardening; add remarks, and return what is gone."""
    if beam == NOTHING_FOUND or options.hardening is HardeningHandling.NONE:
        return scan, NOTHING_FOUND
    if beam.from_counts != scan.counts:
        names = {"scattered radiation": beam.scatter, "beam hardening": beam.hardening}
        corrections = " with the ".join(name for name, of in names.items() if of is not None)
        kinds = ("counts", "line integrals") if beam.from_counts else ("line integrals", "counts")
        sentence = "the {} of the calibration was not taken out: it is of {}, and this scan of {}".format(
            corrections, *kinds
        )
        return replace(scan, remarks=(*scan.remarks, sentence)), NOTHING_FOUND
    slices = len(range(*scan.rows, scan.row_step))
    sample = filled(scan.read(slices // 2, slices // 2 + 1), scan.angles_rad)[:, 0]
    level = kept = _air_level(sample)
    beside = np.float32(0.0)
    sample = sample - level
    sentences: list[str] = []
    if beam.scatter is not None:
        primary = without_scatter(beam.scatter, sample)
        kept, beside = np.float32(0.0), _air_level(primary)
        sentences.append(_scatter_sentence(float((primary - sample).max())))
        sample = primary - beside
    if beam.hardening is not None:
        sentences.append(_hardening_sentence(beam.hardening, float(sample.max())))

    def read(start: int, stop: int) -> NDArray[np.float32]:
        lines = scan.read(start, stop) - level
        if beam.scatter is not None:
            lines = without_scatter(beam.scatter, lines) - beside
        return (lines if beam.hardening is None else straightened(beam.hardening, lines)) + kept

    return replace(scan, read=read, remarks=(*scan.remarks, *sentences)), beam


def _air_level(line: NDArray[np.float32]) -> np.float32:
    air = find_air(line)
    return np.float32(0.0 if air is None else air.background)


def _scatter_sentence(largest_change: float) -> str:
    """Describe the removal of scatter; `largest_change` is the largest change of a line integral."""
    share = 1.0 - math.exp(-largest_change)
    sentence = f"scattered radiation of {share:.1%} of the intensity in the deepest shadow was taken out"
    limited = share > 0.999 * (1.0 - 1.0 / STEEPEST)
    return f"{sentence}, the largest share that is" if limited else f"{sentence}, as the calibration found it"


def _hardening_sentence(hardening: BeamHardening, longest: float) -> str:
    """Describe the removal of hardening; `longest` is the largest line integral of the scan."""
    share = ""
    if longest > 0.0:
        change = longest / float(straightened(hardening, np.array([longest], np.float32))[0]) - 1.0
        share = f" of {change:+.1%} on the longest path"
    sentence = f"beam hardening{share}, as the calibration found it, was taken out"
    if longest > hardening.longest:
        excess = longest / hardening.longest - 1.0
        sentence += f"; the longest line integral is {excess:.0%} larger than any of the phantom's: extrapolated"
    return sentence


class ReconstructedVolume(NamedTuple):
    """A volume (slices, x, y) float32 in the result's unit, and the result."""

    data: Images
    result: ReconstructionResult


def run_reconstruction(
    scan: ScanRows,
    geometry: AnyGeometry,
    options: ReconstructionOptions,
    output: Path,
    report: ProgressCallback,
    keeper: Keeper = NOTHING_KEPT,
) -> ReconstructionResult:
    """Reconstruct each row into the volume's file, which appears when it is complete, and return the result.

    The keeper keeps finished blocks, and the settings that were chosen for all blocks.

    Raises
    ------
    GeometryError, JobFailure
        The geometry or the options cannot be used, or the volume does not fit into the memory or on the disk.
    OSError
        The file cannot be written.
    """
    run = _Run(scan, geometry, options, report)
    needed_bytes, remedy = cost.volume_bytes(options.size, run.slices), "ask for fewer rows or a smaller size"
    check_disk(output.parent, "a volume", run.shape, needed_bytes, remedy)
    settings = settings_of(keeper)

    def on_chosen(chosen: Settings) -> None:
        if keeper.has_begun:
            keep_settings(keeper, chosen)

    solver = run.solver(settings, on_chosen)
    with run.new_volume(output) as volume:
        kept = KeptVolume(volume, solver, keeper, settings)
        result, curve = run.reconstruct(solver, kept.write, kept.take_up)
        assert result.method is not None  # noqa: S101 - a new reconstruction has a report
        volume.note_method(result.method.model_dump(mode="json", exclude_none=True))
        if curve is not None:
            volume.note_alpha_curve({name: np.array(column) for name, column in curve.columns.items()})
    return result.model_copy(update={"time_s": run.elapsed_s})


def reconstruct_in_memory(
    scan: ScanRows, geometry: AnyGeometry, options: ReconstructionOptions, report: ProgressCallback
) -> ReconstructedVolume:
    """Reconstruct each row into a volume in memory."""
    run = _Run(scan, geometry, options, report)
    data = np.empty(run.shape, np.float32)

    def write(start: int, images: Images, _block: FinishedBlock) -> None:
        data[start : start + len(images)] = images

    result, _ = run.reconstruct(run.solver(), write)
    return ReconstructedVolume(data, result)


class _Run:
    """A reconstruction: the geometry, the grid, the solver, and the blocks to solve."""

    def __init__(
        self, scan: ScanRows, geometry: AnyGeometry, options: ReconstructionOptions, report: ProgressCallback
    ) -> None:
        self._started = time.perf_counter()
        self._scan, self._beam = _with_beam_corrected(scan, geometry.beam, options)
        self._geometry, self._options = geometry, options
        self._scanner = scan.scanner.with_cells_of(geometry.scanner)
        grid = ImageGrid(options.size, options.field_mm, options.field_centre_mm)
        self._projector = Projector(
            geometry.views
            if isinstance(geometry, ImportedGeometry)
            else FanBeamGeometry(self._scanner, geometry.theta, geometry.rotation.apply(scan.angles_rad)),
            grid,
        )
        seen_mm = seen_radius_mm(self._projector.geometry)
        if grid.nearest_mm >= seen_mm:
            raise GeometryError(
                f"the field around field_centre_mm {grid.centre_mm[0]:g}, {grid.centre_mm[1]:g} begins "
                f"{grid.nearest_mm:.4g} mm from the rotation centre, and the rays see {seen_mm:.4g} mm around it: "
                "move it nearer"
            )
        self.slices = len(range(*scan.rows, scan.row_step))
        self._pose_remarks, self._has_poses = list[str](), False
        declared = ObjectTurns.BETWEEN_PASSAGES in {geometry.scanner.object_turns, scan.scanner.object_turns}
        if options.view_poses is PoseHandling.FROM_LOG or (options.view_poses is PoseHandling.AUTO and declared):
            self._take_poses()
        self.shape = (self.slices, options.size, options.size)
        self._reporting = _SliceProgress(self.slices, report)

    def _take_poses(self) -> None:
        """Use the poses of the views that rows of the log show, if there is air on both sides of it."""
        projector = self._projector
        numbers = sorted({round(n) for n in np.linspace(0, self.slices - 1, POSE_ROWS + 2)[1:-1]})
        rows = [filled(self._scan.read(n, n + 1), self._scan.angles_rad)[:, 0] for n in numbers]
        whole = [row - _air_level(row) for row in rows if is_between_air(row)]
        if self.views < LEAST_VIEWS or not whole:
            self._pose_remarks.append(ImageMessage.POSES_NOT_FOUND(views=LEAST_VIEWS))
        else:
            poses = find_view_poses(projector.geometry, np.stack(whole))
            self._projector = Projector(poses.of(projector.geometry), projector.grid)
            self._has_poses = True
            shift_mm, roll_deg = poses.across_mm.std(), math.degrees(poses.roll_rad.std())
            self._pose_remarks.append(ImageMessage.VIEWS_STAND_ELSEWHERE(shift_mm=shift_mm, roll_deg=roll_deg))

    @property
    def elapsed_s(self) -> float:
        return time.perf_counter() - self._started

    @property
    def views(self) -> int:
        """Number of views that are used."""
        return int(self._scan.angles_rad.size)

    def solver(
        self, settings: Settings | None = None, on_chosen: Callable[[Settings], None] = lambda _: None
    ) -> BlockSolver:
        """Create the solver of the requested method or, for `auto`, of a method chosen by the middle slice."""
        middle = self.slices // 2
        sample = np.ascontiguousarray(filled(self._scan.read(middle, middle + 1), self._scan.angles_rad)[:, 0])
        radius_mm = _radius_mm(self._scan.read, self._projector.geometry, self.slices)
        name, recommended = self._options.method, None
        if name is ReconstructionMethod.AUTO:
            projector, options = self._projector, self._options
            size = fitted_size(projector.grid, radius_mm)
            recommended = recommend(projector.geometry, sample, projector.grid, fitted_size=size, prefer=options.prefer)
            name = recommended.method
            sample = self._thin_out(recommended.view_step, sample)
        scan, method = self._scan, method_of(name, self._options)
        self._reporting.predict(
            method.seconds(self._projector, self.slices) if isinstance(method, DirectMethod) else None
        )
        task = LogTask(
            options=self._options,
            projector=self._projector,
            sample=sample,
            radius_mm=radius_mm,
            slices=self.slices,
            middle_row=scan.rows[0] + middle * scan.row_step,
            counts=scan.counts,
            beam=self._beam,
            memory_bytes=int(MEMORY_SHARE * memory_available()),
            on_progress=self._reporting.within_block,
            on_chosen=on_chosen,
            around=self._around_the_middle,
        )
        return solver_of(name, task, recommended, settings)

    def new_volume(self, path: Path) -> AbstractContextManager[NewVolume]:
        """Create a volume (slice, x, y) as HDF5 with all data about its origin."""
        scan, geometry, options = self._scan, self._geometry, self._options
        # Fields of the request beyond the options, for example a job's identifiers, are no parameters of the method.
        pitch = self._scanner.row_pitch_mm
        step = "" if scan.row_step == 1 else f":{scan.row_step}"
        return new_reconstruction(
            path,
            self.shape,
            pixel_mm=self._projector.grid.pixel_mm,
            row_pitch_mm=None if pitch is None else pitch * scan.row_step,
            centre_mm=options.field_centre_mm,
            # The scan's first row is at 0, so that volumes of other rows of the same scan have consistent positions.
            first_slice_mm=(pitch or 0.0) * scan.rows[0],
            unit=volume_unit(counts=scan.counts),
            geometry={
                **{name: value for name, value in asdict(self._scanner).items() if value is not None and value != ()},
                **({} if geometry.theta is None else vars(geometry.theta)),
                **(vectors_of(self._projector.geometry) if geometry.theta is None or self._has_poses else {}),
                "object_turns": self._scanner.object_turns.value,
                "rotation": geometry.rotation.value,
                "handedness": geometry.handedness.value,
            },
            parameters={
                **options.model_dump(mode="json", exclude_none=True, include=set(ReconstructionOptions.model_fields)),
                "views": self.views,
                "rows": f"{scan.rows[0]}:{scan.rows[1]}{step}",
                "preparation": list(scan.remarks),
            },
            software_version=VERSION,
            input_sha256=scan.sha256,
        )

    def _around_the_middle(self) -> tuple[NDArray[np.int64], Images]:
        """Return numbers and lines (slices, views, detector) around the middle, missing views interpolated in angle."""
        first = max(self.slices // 2 - SLICES_AROUND // 2, 0)
        numbers = np.arange(first, min(first + SLICES_AROUND, self.slices))
        complete = filled(self._scan.read(first, first + numbers.size), self._scan.angles_rad)
        return numbers, np.ascontiguousarray(complete.transpose(1, 0, 2))

    def _thin_out(self, step: int, sample: NDArray[np.float32]) -> NDArray[np.float32]:
        """Keep every step-th view from here on, and return the sample with these views."""
        if step == 1:
            return sample
        used, scan = views_of_step(self._scan.angles_rad, step), self._scan
        self._projector = Projector(self._projector.geometry.at(used), self._projector.grid)
        self._scan = replace(
            scan, angles_rad=scan.angles_rad[used], read=lambda start, stop: scan.read(start, stop)[used]
        )
        return sample[used]

    def reconstruct(
        self, solver: BlockSolver, write: Write, take_up: Callable[[int], FinishedBlock | None] = lambda _: None
    ) -> tuple[ReconstructionResult, CurvePoints | None]:
        """Reconstruct all blocks but those that `take_up` wrote; return also how the middle slice's parameters came."""
        scan, geometry, options = self._scan, self._geometry, self._options
        seen, blocks = ValueRange(self.slices, options.size), dict[int, FinishedBlock]()

        def reconstruct_block(start: int, stop: int) -> Iterator[None]:
            block = take_up(start)
            yield
            if block is None:
                first = max(start - solver.halo, 0)
                rows = scan.read(first, min(stop + solver.halo, self.slices))
                part = slice(start - first, stop - first)
                yield
                images, findings = solver(first, rows, part)
                yield
                block = FinishedBlock(seen.sample(images), findings, int(present_rows(rows)[:, part].sum(axis=0).min()))
                write(start, images, block)
            blocks[start] = block

        reconstruct_stack(
            self.slices, reconstruct_block, step=solver.step, concurrent=solver.concurrent, done=self._reporting
        )
        in_order = [blocks[start] for start in sorted(blocks)]
        for block in in_order:
            seen.add(block.sample)
        merged = gathered(block.findings for block in in_order)
        merged.remarks.extend(self._pose_remarks)
        predicted = geometry.predicted_ray_error_mm if isinstance(geometry, CalibrationResult) else None
        if predicted is not None and predicted.contrast_loss is not None and predicted.contrast_loss.matters:
            merged.remark(ImageMessage.GEOMETRY_LOSES_CONTRAST(loss_percent=predicted.contrast_loss.knot_10_mm_percent))
        result = ReconstructionResult(
            shape=self.shape,
            pixel_mm=self._projector.grid.pixel_mm,
            unit=volume_unit(counts=scan.counts),
            value_range=seen.percentiles(),
            theta=geometry.theta,
            rotation=geometry.rotation,
            handedness=geometry.handedness,
            views=self.views,
            fewest_views=min(block.fewest_views for block in in_order),
            rows=scan.rows,
            row_step=scan.row_step,
            time_s=self.elapsed_s,
            software_version=VERSION,
            input_sha256=scan.sha256,
            preparation=list(scan.remarks),
            coded_preparation=[CodedReason.of(each) for each in scan.remarks],
            method=solver.report(merged),
        )
        return result, merged.curve


def _radius_mm(read: ReadRows, geometry: FanViews, slices: int) -> float:
    """Return the radius of the disc that holds the log in rows all along its length, including first and last."""
    lines = (read(n, n + 1)[:, 0] for n in sorted({round(n) for n in np.linspace(0, slices - 1, EXTENT_ROWS)}))
    return max(object_radius_mm(geometry, line[present_rows(line)]) for line in lines)


class _SliceProgress:
    """Progress with the remaining time, from the number of finished slices."""

    def __init__(self, slices: int, report: ProgressCallback) -> None:
        self._started, self._slices, self._report = time.perf_counter(), slices, report
        self._done = 0

    def predict(self, seconds: float | None) -> None:
        """Report the predicted time of the whole work, if it is known."""
        self._send(0.0, seconds)

    def within_block(self, more: float) -> None:
        """Report work on a block, as a number of slices in addition to the finished slices."""
        done = self._done + more
        paced = done >= PACE_SHARE * self._slices or (done > 0.0 and self._elapsed_s >= PACE_SECONDS)
        self._send(done, self._left(done) if paced else None)

    def __call__(self, done: int) -> None:
        """Report the number of finished slices."""
        self._done = done
        self._send(done, self._left(done))

    @property
    def _elapsed_s(self) -> float:
        return time.perf_counter() - self._started

    def _left(self, done: float) -> float:
        return cost.seconds_left(self._elapsed_s, done, self._slices)

    def _send(self, done: float, seconds_left: float | None) -> None:
        # The last slices are finished before they are written.
        rounded = None if seconds_left is None else round(seconds_left, 1)
        self._report(Progress(fraction=done / (self._slices + 1), stage="reconstruct", seconds_left=rounded))


class ValueRange:
    """Range in which a picture shows the wood, from every n-th pixel of a volume that is never in memory as a whole."""

    def __init__(self, slices: int, size: int) -> None:
        self._step = max(1, math.ceil(math.sqrt(slices * size * size / SAMPLED_VALUES)))
        self._samples: list[NDArray[np.float32]] = []

    def sample(self, block: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sampled values of some slices (slices, x, y)."""
        return block[:, :: self._step, :: self._step].ravel()

    def add(self, sample: NDArray[np.float32]) -> None:
        """Add a sample."""
        self._samples.append(sample)

    def percentiles(self) -> tuple[float, float]:
        """Return the 0.1 and the 99.9 percentile of the added samples, the second without metal."""
        low, wood, high = np.percentile(np.concatenate(self._samples), PERCENTILES)
        return float(low), float(min(high, MOST_WOOD * wood) if wood > 0.0 else high)
