"""Declarations of all kinds of jobs of a mill, which a process that does or shows jobs gives to the platform."""

from typing import Any

from sawmill_contracts import (
    calibrations,
    drifts,
    fixed_pairs,
    inspections,
    pair_logs,
    phantoms,
    plans,
    reconstructions,
    scans,
)
from sawmill_contracts.kinds import AskedKind
from sawmill_platform.contracts.kind_declarations import KindDeclaration, declare

KINDS: tuple[KindDeclaration, ...] = (
    scans.DECLARATION,
    phantoms.DECLARATION,
    calibrations.DECLARATION,
    reconstructions.DECLARATION,
    plans.DECLARATION,
    drifts.DECLARATION,
    inspections.DECLARATION,
    fixed_pairs.DECLARATION,
    pair_logs.DECLARATION,
)
declare(KINDS)


def asked_kinds() -> list[AskedKind[Any, Any]]:
    """Return the declarations of the kinds that somebody asks for."""
    return [declaration for declaration in KINDS if isinstance(declaration, AskedKind)]
