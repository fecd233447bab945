from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.agreement import Agreement
from ..models.moved_body import MovedBody
from ..models.witness_taken import WitnessTaken

if TYPE_CHECKING:
    from ..models.column_and_tilt import ColumnAndTilt


T = TypeVar("T", bound="SecondWitness")


@_attrs_define
class SecondWitness:
    """The log beside the phantom: by opposite rays or pairs of views its rows give u_c and the tilt too."""

    agreement: Agreement
    """ Whether the phantom and the log beside it give the same u_c and tilt: within 95 %, within 99.9 %, or not.
    """
    chi_squared: float
    """ Chi squared of the difference, with 2 degrees of freedom, no unit. """
    difference: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    difference_standard_deviation: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    log: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    log_jump_mm: float | None
    """ The jump of the log that its opposite rays show, in noise or beyond it. Null: views in steps of more than 3
    degrees do not show it. In mm. """
    log_jump_view: int | None
    """ The first view after it, counted from 0; null with log_jump_mm. """
    log_rows: list[int]
    """ First row that shows the log and the one after the last. """
    log_rows_averaged: int
    """ The number of them that was averaged, evenly spaced. """
    log_standard_deviation: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    moved: MovedBody | None
    """ Which body moved during the scan. Null: none did, or the scan does not tell which. """
    phantom: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    phantom_standard_deviation: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    ray_change_mm: float
    """ RMS distance that the difference makes to the rays in the log's disc. In mm. """
    reason: str
    """ What the agreement means, in one sentence. """
    reported: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    reported_standard_deviation: ColumnAndTilt
    """ What the phantom's rows and the log's rows both show. """
    taken: WitnessTaken
    """ Whose u_c and tilt are reported. """

    def to_dict(self) -> dict[str, Any]:
        agreement = self.agreement.value

        chi_squared = self.chi_squared

        difference = self.difference.to_dict()

        difference_standard_deviation = self.difference_standard_deviation.to_dict()

        log = self.log.to_dict()

        log_jump_mm: float | None
        log_jump_mm = self.log_jump_mm

        log_jump_view: int | None
        log_jump_view = self.log_jump_view

        log_rows = []
        for log_rows_item_data in self.log_rows:
            log_rows_item: int
            log_rows_item = log_rows_item_data
            log_rows.append(log_rows_item)

        log_rows_averaged = self.log_rows_averaged

        log_standard_deviation = self.log_standard_deviation.to_dict()

        moved: None | str
        if isinstance(self.moved, MovedBody):
            moved = self.moved.value
        else:
            moved = self.moved

        phantom = self.phantom.to_dict()

        phantom_standard_deviation = self.phantom_standard_deviation.to_dict()

        ray_change_mm = self.ray_change_mm

        reason = self.reason

        reported = self.reported.to_dict()

        reported_standard_deviation = self.reported_standard_deviation.to_dict()

        taken = self.taken.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "agreement": agreement,
                "chi_squared": chi_squared,
                "difference": difference,
                "difference_standard_deviation": difference_standard_deviation,
                "log": log,
                "log_jump_mm": log_jump_mm,
                "log_jump_view": log_jump_view,
                "log_rows": log_rows,
                "log_rows_averaged": log_rows_averaged,
                "log_standard_deviation": log_standard_deviation,
                "moved": moved,
                "phantom": phantom,
                "phantom_standard_deviation": phantom_standard_deviation,
                "ray_change_mm": ray_change_mm,
                "reason": reason,
                "reported": reported,
                "reported_standard_deviation": reported_standard_deviation,
                "taken": taken,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.column_and_tilt import ColumnAndTilt  # noqa: PLC0415

        d = dict(src_dict)
        agreement = Agreement(d.pop("agreement"))

        chi_squared = d.pop("chi_squared")

        difference = ColumnAndTilt.from_dict(d.pop("difference"))

        difference_standard_deviation = ColumnAndTilt.from_dict(d.pop("difference_standard_deviation"))

        log = ColumnAndTilt.from_dict(d.pop("log"))

        def _parse_log_jump_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        log_jump_mm = _parse_log_jump_mm(d.pop("log_jump_mm"))

        def _parse_log_jump_view(data: object) -> int | None:
            if data is None:
                return data
            return cast(int | None, data)

        log_jump_view = _parse_log_jump_view(d.pop("log_jump_view"))

        log_rows = []
        _log_rows = d.pop("log_rows")
        for log_rows_item_data in _log_rows:

            def _parse_log_rows_item(data: object) -> int:
                return cast(int, data)

            log_rows_item = _parse_log_rows_item(log_rows_item_data)

            log_rows.append(log_rows_item)

        log_rows_averaged = d.pop("log_rows_averaged")

        log_standard_deviation = ColumnAndTilt.from_dict(d.pop("log_standard_deviation"))

        def _parse_moved(data: object) -> MovedBody | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                moved_type_0 = MovedBody(data)

                return moved_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(MovedBody | None, data)

        moved = _parse_moved(d.pop("moved"))

        phantom = ColumnAndTilt.from_dict(d.pop("phantom"))

        phantom_standard_deviation = ColumnAndTilt.from_dict(d.pop("phantom_standard_deviation"))

        ray_change_mm = d.pop("ray_change_mm")

        reason = d.pop("reason")

        reported = ColumnAndTilt.from_dict(d.pop("reported"))

        reported_standard_deviation = ColumnAndTilt.from_dict(d.pop("reported_standard_deviation"))

        taken = WitnessTaken(d.pop("taken"))

        second_witness = cls(
            agreement=agreement,
            chi_squared=chi_squared,
            difference=difference,
            difference_standard_deviation=difference_standard_deviation,
            log=log,
            log_jump_mm=log_jump_mm,
            log_jump_view=log_jump_view,
            log_rows=log_rows,
            log_rows_averaged=log_rows_averaged,
            log_standard_deviation=log_standard_deviation,
            moved=moved,
            phantom=phantom,
            phantom_standard_deviation=phantom_standard_deviation,
            ray_change_mm=ray_change_mm,
            reason=reason,
            reported=reported,
            reported_standard_deviation=reported_standard_deviation,
            taken=taken,
        )

        return second_witness
