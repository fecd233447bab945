from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.handedness import Handedness
from ..models.rotation import Rotation
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.alarm_limits import AlarmLimits
    from ..models.scanner_constants import ScannerConstants
    from ..models.theta_bounds import ThetaBounds
    from ..models.tolerances import Tolerances


T = TypeVar("T", bound="StoredScanner")


@_attrs_define
class StoredScanner:
    """A scanner as it is stored."""

    constants: ScannerConstants
    """ What is known of a scanner without calibrating it. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    id: str
    """ The resource's id, which the service gives. """
    name: str
    """ What people call it. """
    active_calibration_id: None | str | Unset = UNSET
    """ The calibration that reconstructions use unless another is given. """
    alarms: AlarmLimits | Unset = UNSET
    """ After how long something that has not come opens an alarm. An expired phantom needs no limit. """
    bounds: None | ThetaBounds | Unset = UNSET
    """ Where theta is searched; null: wherever the phantom can be seen. """
    handedness: Handedness | None | Unset = UNSET
    """ Null: every calibration tries both. """
    log_radius_mm: float | None | Unset = UNSET
    """ Radius of the largest log: the disc around the rotation centre in which ray errors are counted. Null: that
    of the smallest which holds the phantom where it stood, at most 150 mm. """
    rotation: None | Rotation | Unset = UNSET
    """ Null: every calibration tries both. """
    tolerances: Tolerances | Unset = UNSET
    """ What the mill accepts. A calibration beyond one of them is not a pass. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.theta_bounds import ThetaBounds  # noqa: PLC0415

        constants = self.constants.to_dict()

        created_at = self.created_at.isoformat()

        id = self.id

        name = self.name

        active_calibration_id: None | str | Unset
        if isinstance(self.active_calibration_id, Unset):
            active_calibration_id = UNSET
        else:
            active_calibration_id = self.active_calibration_id

        alarms: dict[str, Any] | Unset = UNSET
        if not isinstance(self.alarms, Unset):
            alarms = self.alarms.to_dict()

        bounds: dict[str, Any] | None | Unset
        if isinstance(self.bounds, Unset):
            bounds = UNSET
        elif isinstance(self.bounds, ThetaBounds):
            bounds = self.bounds.to_dict()
        else:
            bounds = self.bounds

        handedness: None | str | Unset
        if isinstance(self.handedness, Unset):
            handedness = UNSET
        elif isinstance(self.handedness, Handedness):
            handedness = self.handedness.value
        else:
            handedness = self.handedness

        log_radius_mm: float | None | Unset
        if isinstance(self.log_radius_mm, Unset):
            log_radius_mm = UNSET
        else:
            log_radius_mm = self.log_radius_mm

        rotation: None | str | Unset
        if isinstance(self.rotation, Unset):
            rotation = UNSET
        elif isinstance(self.rotation, Rotation):
            rotation = self.rotation.value
        else:
            rotation = self.rotation

        tolerances: dict[str, Any] | Unset = UNSET
        if not isinstance(self.tolerances, Unset):
            tolerances = self.tolerances.to_dict()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "constants": constants,
                "created_at": created_at,
                "id": id,
                "name": name,
            }
        )
        if active_calibration_id is not UNSET:
            field_dict["active_calibration_id"] = active_calibration_id
        if alarms is not UNSET:
            field_dict["alarms"] = alarms
        if bounds is not UNSET:
            field_dict["bounds"] = bounds
        if handedness is not UNSET:
            field_dict["handedness"] = handedness
        if log_radius_mm is not UNSET:
            field_dict["log_radius_mm"] = log_radius_mm
        if rotation is not UNSET:
            field_dict["rotation"] = rotation
        if tolerances is not UNSET:
            field_dict["tolerances"] = tolerances

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.alarm_limits import AlarmLimits  # noqa: PLC0415
        from ..models.scanner_constants import ScannerConstants  # noqa: PLC0415
        from ..models.theta_bounds import ThetaBounds  # noqa: PLC0415
        from ..models.tolerances import Tolerances  # noqa: PLC0415

        d = dict(src_dict)
        constants = ScannerConstants.from_dict(d.pop("constants"))

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        id = d.pop("id")

        name = d.pop("name")

        def _parse_active_calibration_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        active_calibration_id = _parse_active_calibration_id(d.pop("active_calibration_id", UNSET))

        _alarms = d.pop("alarms", UNSET)
        alarms: AlarmLimits | Unset
        if isinstance(_alarms, Unset):
            alarms = UNSET
        else:
            alarms = AlarmLimits.from_dict(_alarms)

        def _parse_bounds(data: object) -> None | ThetaBounds | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                bounds_type_0 = ThetaBounds.from_dict(data)

                return bounds_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | ThetaBounds | Unset, data)

        bounds = _parse_bounds(d.pop("bounds", UNSET))

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

        def _parse_log_radius_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        log_radius_mm = _parse_log_radius_mm(d.pop("log_radius_mm", UNSET))

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

        _tolerances = d.pop("tolerances", UNSET)
        tolerances: Tolerances | Unset
        if isinstance(_tolerances, Unset):
            tolerances = UNSET
        else:
            tolerances = Tolerances.from_dict(_tolerances)

        stored_scanner = cls(
            constants=constants,
            created_at=created_at,
            id=id,
            name=name,
            active_calibration_id=active_calibration_id,
            alarms=alarms,
            bounds=bounds,
            handedness=handedness,
            log_radius_mm=log_radius_mm,
            rotation=rotation,
            tolerances=tolerances,
        )

        return stored_scanner
