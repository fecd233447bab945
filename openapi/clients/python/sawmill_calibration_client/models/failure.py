from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

from ..models.failure_kind import FailureKind

T = TypeVar("T", bound="Failure")


@_attrs_define
class Failure:
    """Why a job failed, in one sentence: which value, and what would be right."""

    code: str
    """ Stable, for programs. """
    detail: str
    """ One sentence: which value, and what would be right. """
    kind: FailureKind
    """ Whose fault an ended job is: the asker's (no retry), passing (retried), or ours (alert). """

    def to_dict(self) -> dict[str, Any]:
        code = self.code

        detail = self.detail

        kind = self.kind.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "code": code,
                "detail": detail,
                "kind": kind,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        code = d.pop("code")

        detail = d.pop("detail")

        kind = FailureKind(d.pop("kind"))

        failure = cls(
            code=code,
            detail=detail,
            kind=kind,
        )

        return failure
