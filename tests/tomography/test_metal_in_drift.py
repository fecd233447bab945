"""Drift checks of logs with nails in every row: the rays through the nail are left out, and metal is named."""

import numpy as np
import pytest
from nailed_logs import SCANNER, Nail, NailedLog, views_all_round

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_vocabulary import Rotation

pytestmark = pytest.mark.usefixtures("one_thread")

ROWS = 60


def checked(log, fan, seed):
    """A drift check of the mean of the rows."""
    mean = log.scan(fan, seed, ROWS).mean(axis=1, dtype=np.float64)
    return detector_fit(SCANNER, mean, fan.angles_rad, fan.frame, Rotation.AS_GIVEN)


@pytest.mark.parametrize("views", [12, 20])
@pytest.mark.parametrize(("nail", "worst_mm"), [(Nail(3.6, 28.0, 20.0), 0.4), (Nail(5.0, 0.0, 30.0), 0.1)])
def test_a_nail_in_every_row_is_left_out_and_named(views, nail, worst_mm):
    """They were refused as logs that moved."""
    fan = views_all_round(views)
    for seed in range(3):
        fit = checked(NailedLog.random(seed, nail), fan, seed)
        assert abs(fit.cor_column_mm - fan.frame.cor_column_mm) < 3.0 * fit.deviation[0] < worst_mm
        assert any(remark.startswith("metal in the log: ") for remark in fit.adjustments)
        # The edge of a narrow shadow is no faulty cell.
        assert not any("detector cells" in remark for remark in fit.adjustments)


def test_a_log_full_of_metal_is_refused_by_that_name():
    fan = views_all_round(20)
    with pytest.raises(DriftError, match=r"metal in the log covers \d\d% of the samples, and 20% may") as refusal:
        checked(NailedLog.random(1, *[Nail(6.0, 30.0, 30.0)] * 20), fan, 1)
    assert refusal.value.code == "metal-in-log"
