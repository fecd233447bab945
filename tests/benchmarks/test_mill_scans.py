"""Scans of a mill: how they are drawn, and that none passes wrongly."""

import dataclasses

import mill_scans
import numpy as np
import pytest
from mill_scans import EFFECTS, StudyScan
from scanners import SCANNER

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_vocabulary.physics import Physics

# No seed that the calibration was tuned with.
SEED = 2026
FEW_VIEWS, LOG_RADIUS_MM = 90, 150.0

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.nightly
@pytest.mark.parametrize("place", range(4), ids=["clean", "one effect", "another", "two effects"])
def test_no_scan_of_a_mill_passes_wrongly(place):
    """Four of each kind with up to 90 views, of which a scan takes half a second."""
    numbers = [n for n in range(place, 120, 4) if StudyScan.of(n, SEED).setting.angles_rad.size <= FEW_VIEWS][:4]
    for number in numbers:
        scan = StudyScan.of(number, SEED)
        found = calibrate(scan.task(), seed=number)
        off = ray_error(SCANNER, scan.setting.frame, found.frame, radius_mm=LOG_RADIUS_MM, other_scanner=found.scanner)
        assert found.judgement.verdict != "pass" or off.rms_mm <= 0.1, number


def test_of_four_scans_one_is_clean_two_have_one_effect_and_one_has_two():
    scans = [StudyScan.of(number, SEED) for number in range(56)]
    assert [scan.kind for scan in scans[:4]] == ["clean", "single", "single", "pair"]
    assert [len(scan.sizes) for scan in scans[:4]] == [0, 1, 1, 2]
    assert [next(iter(scan.sizes)) for scan in scans if scan.kind == "single"][: len(EFFECTS)] == list(EFFECTS)


def test_a_clean_scan_has_nothing_but_unequal_cells_and_a_size():
    physics = StudyScan.of(0, SEED).physics
    size = physics.wood.size_percent
    expected = Physics(
        detector=dataclasses.replace(Physics().detector, gain_spread=mill_scans.GAIN_SPREAD),
        wood=dataclasses.replace(Physics().wood, size_percent=size),
    )
    assert physics == expected
    assert 0.0 < abs(size) < 1.0


@pytest.mark.parametrize("name", EFFECTS)
def test_every_size_of_an_effect_can_be_simulated(name):
    """Within the bounds of the physics, at both ends of its range."""
    rng = np.random.default_rng(1)
    groups = {group.name: group for group in dataclasses.fields(Physics)}
    for size in (EFFECTS[name].low, EFFECTS[name].high):
        for group, values in EFFECTS[name].fields(size, rng).items():
            known = {field.name: field.metadata for field in dataclasses.fields(groups[group].default)}
            for field, value in values.items():
                bounds = known[field]
                assert bounds.get("ge", bounds.get("gt", 12)) <= value <= bounds.get("le", 16)
