from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.adjustment import Adjustment
from ..models.axis import Axis
from ..models.calibration_method import CalibrationMethod
from ..models.handedness import Handedness
from ..models.rotation import Rotation
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.paper_options import PaperOptions


T = TypeVar("T", bound="CalibrationAsk")


@_attrs_define
class CalibrationAsk:
    """Ask for a calibration."""

    scan_id: str
    """ Id of the scan that shows the phantom. """
    activate: bool | Unset = False
    """ Make it the scanner's active calibration if its rays_verdict is pass: an uncertain scale blurs nothing and
    does not stop it. """
    fresh: bool | Unset = False
    """ Compute it even where the same was computed before, of the same input, with the same parameters and the same
    version of the software. Otherwise that result answers at once, and `answered_from` names it. """
    handedness: Handedness | None | Unset = UNSET
    """ From which end the phantom was seen. By default the scanner's, else both are tried. """
    log_rows: None | str | Unset = UNSET
    """ Detector rows A:B that show a log beside the phantom, the second witness for u_c and tilt. By default they
    are looked for. """
    method: CalibrationMethod | Unset = UNSET
    """ `default` is what users want; `paper` is the published search. """
    paper: PaperOptions | Unset = UNSET
    """ Switches of the published search (arXiv 2206.14444). """
    phantom_id: None | str | Unset = UNSET
    """ Id of the phantom in the scan. Null: the one that the scan names. """
    rays_per_cell: int | None | Unset = UNSET
    """ Rays a cell in the model, a count. By default the average over the whole cell, as of a real detector. """
    rotation: None | Rotation | Unset = UNSET
    """ Which way the angles count. By default the scanner's, else both are tried. """
    rows: None | str | Unset = UNSET
    """ Detector rows A:B to average, the first included, the last not. By default the scan's phantom rows, else
    they are found. """
    seed: int | Unset = 7
    """ Seed of the search's random numbers, no unit. """
    size_tolerance_percent: float | None | Unset = UNSET
    """ Relative standard uncertainty of the phantom's size, in per cent. By default that of its drawing, 0.15 where
    nobody stated one. """
    true_axis: Axis | None | Unset = UNSET
    """ Axis of the drawing along which the phantom's size is right. By default the drawing's, else neither: half
    the difference between the two is then added to the scale's uncertainty. """
    views: int | None | Unset = UNSET
    """ Number of views to use: every (total / views)-th, each with its own angle. By default all. """
    without: list[Adjustment] | Unset = UNSET
    """ Corrections of a scan with faults that are left out. """

    def to_dict(self) -> dict[str, Any]:
        scan_id = self.scan_id

        activate = self.activate

        fresh = self.fresh

        handedness: None | str | Unset
        if isinstance(self.handedness, Unset):
            handedness = UNSET
        elif isinstance(self.handedness, Handedness):
            handedness = self.handedness.value
        else:
            handedness = self.handedness

        log_rows: None | str | Unset
        if isinstance(self.log_rows, Unset):
            log_rows = UNSET
        else:
            log_rows = self.log_rows

        method: str | Unset = UNSET
        if not isinstance(self.method, Unset):
            method = self.method.value

        paper: dict[str, Any] | Unset = UNSET
        if not isinstance(self.paper, Unset):
            paper = self.paper.to_dict()

        phantom_id: None | str | Unset
        if isinstance(self.phantom_id, Unset):
            phantom_id = UNSET
        else:
            phantom_id = self.phantom_id

        rays_per_cell: int | None | Unset
        if isinstance(self.rays_per_cell, Unset):
            rays_per_cell = UNSET
        else:
            rays_per_cell = self.rays_per_cell

        rotation: None | str | Unset
        if isinstance(self.rotation, Unset):
            rotation = UNSET
        elif isinstance(self.rotation, Rotation):
            rotation = self.rotation.value
        else:
            rotation = self.rotation

        rows: None | str | Unset
        if isinstance(self.rows, Unset):
            rows = UNSET
        else:
            rows = self.rows

        seed = self.seed

        size_tolerance_percent: float | None | Unset
        if isinstance(self.size_tolerance_percent, Unset):
            size_tolerance_percent = UNSET
        else:
            size_tolerance_percent = self.size_tolerance_percent

        true_axis: None | str | Unset
        if isinstance(self.true_axis, Unset):
            true_axis = UNSET
        elif isinstance(self.true_axis, Axis):
            true_axis = self.true_axis.value
        else:
            true_axis = self.true_axis

        views: int | None | Unset
        if isinstance(self.views, Unset):
            views = UNSET
        else:
            views = self.views

        without: list[str] | Unset = UNSET
        if not isinstance(self.without, Unset):
            without = []
            for without_item_data in self.without:
                without_item = without_item_data.value
                without.append(without_item)

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "scan_id": scan_id,
            }
        )
        if activate is not UNSET:
            field_dict["activate"] = activate
        if fresh is not UNSET:
            field_dict["fresh"] = fresh
        if handedness is not UNSET:
            field_dict["handedness"] = handedness
        if log_rows is not UNSET:
            field_dict["log_rows"] = log_rows
        if method is not UNSET:
            field_dict["method"] = method
        if paper is not UNSET:
            field_dict["paper"] = paper
        if phantom_id is not UNSET:
            field_dict["phantom_id"] = phantom_id
        if rays_per_cell is not UNSET:
            field_dict["rays_per_cell"] = rays_per_cell
        if rotation is not UNSET:
            field_dict["rotation"] = rotation
        if rows is not UNSET:
            field_dict["rows"] = rows
        if seed is not UNSET:
            field_dict["seed"] = seed
        if size_tolerance_percent is not UNSET:
            field_dict["size_tolerance_percent"] = size_tolerance_percent
        if true_axis is not UNSET:
            field_dict["true_axis"] = true_axis
        if views is not UNSET:
            field_dict["views"] = views
        if without is not UNSET:
            field_dict["without"] = without

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.paper_options import PaperOptions  # noqa: PLC0415

        d = dict(src_dict)
        scan_id = d.pop("scan_id")

        activate = d.pop("activate", UNSET)

        fresh = d.pop("fresh", UNSET)

        def _parse_handedness(data: object) -> Handedness | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                handedness_type_0 = Handedness(data)

                return handedness_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Handedness | None | Unset, data)

        handedness = _parse_handedness(d.pop("handedness", UNSET))

        def _parse_log_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        log_rows = _parse_log_rows(d.pop("log_rows", UNSET))

        _method = d.pop("method", UNSET)
        method: CalibrationMethod | Unset
        if isinstance(_method, Unset):
            method = UNSET
        else:
            method = CalibrationMethod(_method)

        _paper = d.pop("paper", UNSET)
        paper: PaperOptions | Unset
        if isinstance(_paper, Unset):
            paper = UNSET
        else:
            paper = PaperOptions.from_dict(_paper)

        def _parse_phantom_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        phantom_id = _parse_phantom_id(d.pop("phantom_id", UNSET))

        def _parse_rays_per_cell(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        rays_per_cell = _parse_rays_per_cell(d.pop("rays_per_cell", UNSET))

        def _parse_rotation(data: object) -> None | Rotation | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                rotation_type_0 = Rotation(data)

                return rotation_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Rotation | Unset, data)

        rotation = _parse_rotation(d.pop("rotation", UNSET))

        def _parse_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        rows = _parse_rows(d.pop("rows", UNSET))

        seed = d.pop("seed", UNSET)

        def _parse_size_tolerance_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        size_tolerance_percent = _parse_size_tolerance_percent(d.pop("size_tolerance_percent", UNSET))

        def _parse_true_axis(data: object) -> Axis | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                true_axis_type_0 = Axis(data)

                return true_axis_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Axis | None | Unset, data)

        true_axis = _parse_true_axis(d.pop("true_axis", UNSET))

        def _parse_views(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        views = _parse_views(d.pop("views", UNSET))

        _without = d.pop("without", UNSET)
        without: list[Adjustment] | Unset = UNSET
        if _without is not UNSET:
            without = []
            for without_item_data in _without:
                without_item = Adjustment(without_item_data)

                without.append(without_item)

        calibration_ask = cls(
            scan_id=scan_id,
            activate=activate,
            fresh=fresh,
            handedness=handedness,
            log_rows=log_rows,
            method=method,
            paper=paper,
            phantom_id=phantom_id,
            rays_per_cell=rays_per_cell,
            rotation=rotation,
            rows=rows,
            seed=seed,
            size_tolerance_percent=size_tolerance_percent,
            true_axis=true_axis,
            views=views,
            without=without,
        )

        return calibration_ask
