"""Keys and their scopes. A key's secret is shown once, when it is made; the database does not contain it."""

from enum import StrEnum

from pydantic import ConfigDict, Field, model_validator

from sawmill_platform.contracts.base import Name, Stamped, Time
from sawmill_platform.contracts.given import Given, GivenTime
from sawmill_platform.contracts.kind_declarations import Schema, one_of, require


class Scope(StrEnum):
    """Scope of a key; each scope includes the scopes before it."""

    READ = "read"
    """Read everything, except keys and the audit."""
    SUBMIT = "submit"
    """Upload, request work, and cancel it."""
    ACTIVATE = "activate"
    """Decide what a group uses: activate, roll back, describe groups, schedule."""
    ADMIN = "admin"
    """Delete, make keys, read the audit."""

    def covers(self, needed: "Scope") -> bool:
        """Return whether a key of this scope may do what needs another one."""
        order = list(Scope)
        return order.index(self) >= order.index(needed)


def _state_display(schema: Schema) -> None:
    require(schema, "display", one_of("display", [False]), one_of("scope", [Scope.READ]))


class KeyRequest(Given):
    """A key to be made."""

    model_config = ConfigDict(json_schema_extra=_state_display)

    name: Name = Field(description="Owner of the key: a person or a program.", examples=["software of line 2"])
    scope: Scope = Field(
        description="`read`, `submit`, `activate` or `admin`; each scope includes the scopes before it.",
        examples=["read"],
    )
    expires_at: GivenTime | None = Field(
        None, description="Time from which the key is refused; null: never.", examples=["2030-01-01T00:00:00Z"]
    )
    display: bool = Field(
        default=False,
        description="Whether the key is for a display on the wall: a page that the key has opened stays "
        "open as long as the key is valid. Needs scope `read`.",
    )

    @model_validator(mode="after")
    def _displays_only_read(self) -> "KeyRequest":
        if self.display and self.scope is not Scope.READ:
            raise ValueError(f"a display's key must have the scope read, not {self.scope}")
        return self


class Key(Stamped):
    """A key as it is listed, without its secret."""

    name: Name = Field(description="Owner of the key: a person or a program.", examples=["software of line 2"])
    scope: Scope = Field(description="Scope of the key.", examples=["submit"])
    display: bool = Field(description="Whether the key is for a display on the wall.", examples=[False])
    expires_at: Time | None = Field(
        description="Time from which the key is refused; null: never.", examples=["2030-01-01T00:00:00Z"]
    )
    revoked_at: Time | None = Field(description="Time since which the key is refused; null: it is not revoked.")
    last_used_at: Time | None = Field(description="Time of the last use, to a minute; null: never.")
    rotated_at: Time | None = Field(description="Time when the secret was last replaced; null: never.")
    created_by: Name = Field(description="Name of the key that made this key.", examples=["admin"])


class NewKey(Key):
    """A key with its secret, which is shown here and never again."""

    secret: str = Field(
        repr=False,
        description="Secret, to be sent as `Authorization: Bearer SECRET`.",
        examples=["sawmill_0f8b4c6d0d8a4b0e_u7Xq2mV9"],
    )


class KeyRotation(Given):
    """Replacement of a key's secret."""

    grace_s: int = Field(
        0,
        ge=0,
        le=30 * 86400,
        description="Seconds for which the old secret is still accepted, so that programs can be given the new one.",
        examples=[3600],
    )
