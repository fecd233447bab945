"""The base of the values that contracts take as fields."""

from typing import ClassVar


class AsContract:
    """A dataclass that pydantic reads as it reads a contract, with the bounds in the metadata of its fields.

    Unknown fields and numbers that are not finite are refused, and an instance is checked again.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid", "allow_inf_nan": False, "revalidate_instances": "always"}
