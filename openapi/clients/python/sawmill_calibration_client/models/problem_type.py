from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.failure_kind import FailureKind
from ..types import UNSET, Unset

T = TypeVar("T", bound="ProblemType")


@_attrs_define
class ProblemType:
    """A kind of problem, or of a job's failure."""

    code: str
    """ Stable, for programs. """
    title: str
    """ What it means, in a few words. """
    type_: str
    """ Where this page is, as problems name it. """
    what_to_do: str
    """ What to do. """
    when: str
    """ When it comes. """
    failure: FailureKind | None | Unset = UNSET
    """ Whose trouble it is where a job fails with it; null: none does. """
    status: int | None | Unset = UNSET
    """ The HTTP status of an answer with it; null: only jobs fail with it. """

    def to_dict(self) -> dict[str, Any]:
        code = self.code

        title = self.title

        type_ = self.type_

        what_to_do = self.what_to_do

        when = self.when

        failure: None | str | Unset
        if isinstance(self.failure, Unset):
            failure = UNSET
        elif isinstance(self.failure, FailureKind):
            failure = self.failure.value
        else:
            failure = self.failure

        status: int | None | Unset
        if isinstance(self.status, Unset):
            status = UNSET
        else:
            status = self.status

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "code": code,
                "title": title,
                "type": type_,
                "what_to_do": what_to_do,
                "when": when,
            }
        )
        if failure is not UNSET:
            field_dict["failure"] = failure
        if status is not UNSET:
            field_dict["status"] = status

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        code = d.pop("code")

        title = d.pop("title")

        type_ = d.pop("type")

        what_to_do = d.pop("what_to_do")

        when = d.pop("when")

        def _parse_failure(data: object) -> FailureKind | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                failure_type_0 = FailureKind(data)

                return failure_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(FailureKind | None | Unset, data)

        failure = _parse_failure(d.pop("failure", UNSET))

        def _parse_status(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        status = _parse_status(d.pop("status", UNSET))

        problem_type = cls(
            code=code,
            title=title,
            type_=type_,
            what_to_do=what_to_do,
            when=when,
            failure=failure,
            status=status,
        )

        return problem_type
