"""The data of a scanner of fixed pairs, and how the board lies in each passage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray, rotate
from sawmill_tomography.projection.analytic import DetectorCells


@dataclass(frozen=True, eq=False)
class PairData:
    """The line integrals of one pair; the cells count along the detector's axis, clockwise about the centre."""

    lines: FloatArray  # (passages, groups, cells): means over groups of neighbouring rows
    heights_mm: FloatArray  # (groups,): height of each group on the object
    cells: DetectorCells

    def binned(self, cells: int) -> "PairData":
        """Return the means over all rows, and over groups of cells."""
        count = self.cells.count // cells
        means = self.lines.mean(axis=1)[:, : count * cells].reshape(-1, 1, count, cells).mean(axis=3)
        modules = self.cells.modules if cells == 1 else ()
        wider = replace(self.cells, width_mm=self.cells.width_mm * cells, count=count, modules=modules)
        return PairData(means, self.heights_mm.mean(keepdims=True), wider)

    @property
    def shadow_power(self) -> float:
        """Sum of squares of the line integrals above the least of each line."""
        return float(((self.lines - self.lines.min(axis=-1, keepdims=True)) ** 2).sum())

    @property
    def reversed(self) -> "PairData":
        """The data with the cells in the other order."""
        return replace(self, lines=np.ascontiguousarray(self.lines[..., ::-1]))


def seen_by_views(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the view angles (views,), rad, and positions (views, 2), mm, at which a drawing lies as the poses say.

    A pose (views, 3) is x and y in mm and the roll in rad. A body that rolls is seen as by a scanner that turns the
    other way.
    """
    return -poses[:, 2], np.stack(rotate(-poses[:, 2], poses[:, 0], poses[:, 1]), -1)


def by_pose(poses: FloatArray, by_angle: FloatArray, by_position: FloatArray) -> FloatArray:
    """Return the derivatives by the pose (3, ...) from those by view angle (...) and position (2, ...).

    Views are the first axis of (...).
    """
    x, y, roll = poses.T.reshape(3, -1, *[1] * (by_angle.ndim - 1))
    c, s = np.cos(roll), np.sin(roll)
    by_x, by_y = c * by_position[0] - s * by_position[1], s * by_position[0] + c * by_position[1]
    return np.stack([by_x, by_y, y * by_x - x * by_y - by_angle])


def moved_frames(frames: FloatArray, motion: Sequence[float]) -> FloatArray:
    """Return the frames (pairs, 5) in coordinates turned by motion[2] and then shifted by motion[:2], mm and rad."""
    turned = np.stack(rotate(motion[2], *np.eye(2)))
    return np.array([mapped(frame, turned, np.asarray(motion[:2])) for frame in frames])


def mapped(frame: FloatArray, linear: FloatArray, shift_mm: FloatArray) -> FloatArray:
    """Return one frame (5,) with its rays mapped by a matrix (2, 2) and then shifted (2,), by the ray through 0."""
    psi, r, sdd, u_c, tau = frame
    along = linear @ rotate(psi + tau, 1.0, 0.0)
    wider = float(np.hypot(*along))
    source = linear @ rotate(psi, 0.0, -r) + shift_mm
    # From the source to the detector's middle: cells that are further apart belong to a nearer detector.
    middle = linear @ (np.array(rotate(psi, 0.0, sdd)) - u_c * np.array(rotate(psi + tau, 1.0, 0.0))) / wider
    along = along / wider
    f, foot = float(along[0] * middle[1] - along[1] * middle[0]), -float(along @ middle)
    angle = float(np.arctan2(source[0], -source[1]))
    omega = float(np.arctan2(along[1], along[0]))
    tilt = float(np.arctan2(np.sin(omega - angle), np.cos(omega - angle)))
    return np.array([angle, np.hypot(*source), f / np.cos(tilt), foot + f * np.tan(tilt), tilt])
