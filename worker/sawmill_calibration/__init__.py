"""The library: what jobs, commands and Python users do with a scan. docs/look-up/python.md shows the public names.

Each name is imported when it is first used, so that importing the package takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sawmill_calibration.answers import (
        Calibration,
        Drift,
        Reconstruction,
        calibrate,
        drift,
        read_calibration,
        reconstruct,
    )
    from sawmill_calibration.calibration.fixed_pairs import calibrate_fixed_pairs
    from sawmill_calibration.drift_checks.pair_logs import locate_marks
    from sawmill_calibration.failures import InputError
    from sawmill_calibration.scans.scan import Scan, read_scan
    from sawmill_calibration.simulation import simulate_log_scan, simulate_phantom_scan
    from sawmill_calibration.view_vectors import read_views
    from sawmill_contracts.fixed_pairs import BoardPose, CalibratedPair, FixedPairsResult
    from sawmill_contracts.pair_logs import LogOnPairs
    from sawmill_tomography.geometry.geometry import FanBeamGeometry, FanViews
    from sawmill_tomography.phantoms.phantom import Phantom
    from sawmill_vocabulary import Disc, FixedPair, PairedScanner, Polygon, Scanner, Theta
    from sawmill_vocabulary.pairs import LocatedMark, PairAgreement

    __version__: str

__all__ = [
    "BoardPose",
    "CalibratedPair",
    "Calibration",
    "Disc",
    "Drift",
    "FanBeamGeometry",
    "FanViews",
    "FixedPair",
    "FixedPairsResult",
    "InputError",
    "LocatedMark",
    "LogOnPairs",
    "PairAgreement",
    "PairedScanner",
    "Phantom",
    "Polygon",
    "Reconstruction",
    "Scan",
    "Scanner",
    "Theta",
    "calibrate",
    "calibrate_fixed_pairs",
    "drift",
    "locate_marks",
    "read_calibration",
    "read_scan",
    "read_views",
    "reconstruct",
    "simulate_log_scan",
    "simulate_phantom_scan",
]

# No module here has a public name: its import would hide that name.
_MODULES = {
    "sawmill_calibration.answers": (
        *("Calibration", "Drift", "Reconstruction"),
        *("calibrate", "drift", "read_calibration", "reconstruct"),
    ),
    "sawmill_calibration.calibration.fixed_pairs": ("calibrate_fixed_pairs",),
    "sawmill_calibration.drift_checks.pair_logs": ("locate_marks",),
    "sawmill_calibration.failures": ("InputError",),
    "sawmill_calibration.scans.scan": ("Scan", "read_scan"),
    "sawmill_calibration.simulation": ("simulate_log_scan", "simulate_phantom_scan"),
    "sawmill_contracts.fixed_pairs": ("BoardPose", "CalibratedPair", "FixedPairsResult"),
    "sawmill_contracts.pair_logs": ("LogOnPairs",),
    "sawmill_vocabulary.pairs": ("LocatedMark", "PairAgreement"),
    "sawmill_tomography.geometry.geometry": ("FanBeamGeometry", "FanViews"),
    "sawmill_calibration.view_vectors": ("read_views",),
    "sawmill_tomography.phantoms.phantom": ("Phantom",),
    "sawmill_vocabulary": ("Disc", "FixedPair", "PairedScanner", "Polygon", "Scanner", "Theta"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # so that a type checker sees a wrong name

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used."""
        if name == "__version__":
            return import_module("sawmill_vocabulary.version").VERSION
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
