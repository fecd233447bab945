"""Columns and constraints of tables, as migrations write them."""

from collections.abc import Collection, Iterator
from typing import Any

import sqlalchemy as sa
from sqlalchemy.types import TypeEngine

ID = sa.String(length=64)
WORD = sa.String(length=20)
EVENT = sa.String(length=40)
NAME = sa.String(length=200)
TEXT = sa.String()
MOMENT = sa.DateTime(timezone=True)
REAL = sa.Float(precision=53)
INTEGER = sa.Integer()
BYTES = sa.BigInteger()
FLAG = sa.Boolean()
JSON = sa.JSON()


def needed(**types: TypeEngine[Any]) -> list[sa.Column[Any]]:
    return [sa.Column(name, kind, nullable=False) for name, kind in types.items()]


def perhaps(**types: TypeEngine[Any]) -> list[sa.Column[Any]]:
    return [sa.Column(name, kind, nullable=True) for name, kind in types.items()]


def counted() -> sa.Column[Any]:
    """The number of a row, which the database gives."""
    return sa.Column("number", INTEGER, autoincrement=True, nullable=False)


def single() -> sa.Column[Any]:
    """The number of a table's only row."""
    return sa.Column("number", INTEGER, autoincrement=False, nullable=False)


def keys(table: str, *primary: str, cascades: Collection[str] = (), **others: str) -> Iterator[sa.Constraint]:
    """The primary key, and for each column that refers to the id of another table's row, a foreign key."""
    for column, other in others.items():
        ondelete = "CASCADE" if column in cascades else None
        yield sa.ForeignKeyConstraint([column], [f"{other}.id"], name=f"fk_{table}_{column}", ondelete=ondelete)
    yield sa.PrimaryKeyConstraint(*primary, name=f"pk_{table}")


def unique(table: str, *columns: str) -> sa.UniqueConstraint:
    """A combination of values that no two rows have."""
    return sa.UniqueConstraint(*columns, name=f"uq_{table}_{'_'.join(columns)}")
