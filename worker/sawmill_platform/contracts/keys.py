"""Keys: who may do what. A secret is shown once, when it is made; what is stored cannot be turned back into it."""

from enum import StrEnum

from pydantic import ConfigDict, Field, model_validator

from sawmill_platform.contracts.base import Contract, Name, Stamped, Time
from sawmill_platform.contracts.conditions import Schema, one_of, require
from sawmill_platform.contracts.given import Given, GivenTime


class Scope(StrEnum):
    """What a key may do; each scope may do what those before it may."""

    READ = "read"
    """Look at everything, but for keys and the audit."""
    SUBMIT = "submit"
    """Upload, ask for work, and cancel it."""
    ACTIVATE = "activate"
    """Decide what a scanner uses: activate, roll back, describe scanners, schedule."""
    ADMIN = "admin"
    """Delete, make keys, read the audit."""

    def covers(self, needed: "Scope") -> bool:
        """Whether a key of this scope may do what needs another one."""
        order = list(Scope)
        return order.index(self) >= order.index(needed)


def _state_display(schema: Schema) -> None:
    require(schema, "display", one_of("display", [False]), one_of("scope", [Scope.READ]))


class KeyAsk(Given):
    """A key that is to be made."""

    model_config = ConfigDict(json_schema_extra=_state_display)

    name: Name = Field(description="Whose it is: a person or a program.", examples=["scanner software of line 2"])
    scope: Scope = Field(
        description="`read`, `submit`, `activate` or `admin`; each may do what those before it may.", examples=["read"]
    )
    expires_at: GivenTime | None = Field(
        None, description="From then on it opens nothing; null: never.", examples=["2030-01-01T00:00:00Z"]
    )
    display: bool = Field(
        default=False,
        description="For a display on the wall: a page that it has opened stays open as long as the key is good. "
        "Of scope `read` alone.",
        examples=[False],
    )

    @model_validator(mode="after")
    def _displays_only_read(self) -> "KeyAsk":
        if self.display and self.scope is not Scope.READ:
            msg = f"a display's key must have the scope read, not {self.scope}"
            raise ValueError(msg)
        return self


class Key(Stamped):
    """A key as it is listed, without its secret."""

    name: Name = Field(description="Whose it is: a person or a program.", examples=["scanner software of line 2"])
    scope: Scope = Field(description="What it may do.", examples=["submit"])
    display: bool = Field(description="For a display on the wall.", examples=[False])
    expires_at: Time | None = Field(
        description="From then on it opens nothing; null: never.", examples=["2030-01-01T00:00:00Z"]
    )
    revoked_at: Time | None = Field(
        description="From then on it opens nothing; null: it is not revoked.", examples=["2026-03-02T05:30:00Z"]
    )
    last_used_at: Time | None = Field(
        description="When it was last used, to a minute; null: never.", examples=["2026-03-02T05:30:00Z"]
    )
    rotated_at: Time | None = Field(
        description="When its secret was last replaced; null: never.", examples=["2026-03-02T05:30:00Z"]
    )
    created_by: Name = Field(description="The name of the key that made it.", examples=["admin"])


class NewKey(Key):
    """A key with its secret, which is shown here and never again."""

    secret: str = Field(
        repr=False,
        description="To be sent as `Authorization: Bearer SECRET`.",
        examples=["sawmill_0f8b4c6d0d8a4b0e_u7Xq2mV9"],
    )


class KeyRotation(Given):
    """How a key's secret is replaced."""

    grace_s: int = Field(
        0,
        ge=0,
        le=30 * 86400,
        description="Seconds for which the old secret still opens, so that programs can be given the new one.",
        examples=[3600],
    )


class Keys(Contract):
    """All keys."""

    keys: list[Key] = Field(description="The newest first; revoked and expired ones stay listed.")
