"""A phantom's measured sides: what they say of its size, and what an answer says of them."""

from datetime import date

import pytest
from pydantic import ValidationError

from sawmill_calibration.calibration.calibrate import measurement_reasons
from sawmill_contracts.phantoms import PhantomAsk, PhantomDrawing

BOARD = {"kind": "polygon", "vertices_mm": [(-100.0, -150.0), (100.0, -150.0), (100.0, 150.0), (-100.0, 150.0)]}
ACROSS = {"what": "x", "measured_mm": 200.0, "standard_uncertainty_mm": 0.2, "moisture_percent": 12.0}
ALONG = {"what": "y", "measured_mm": 300.0, "standard_uncertainty_mm": 0.06, "instrument": "caliper 12"}


def drawing(*measurements, **stated):
    return PhantomAsk(name="our board", shapes=[BOARD], measurements=list(measurements), **stated)


def reasons(*measurements, today="2021-06-01"):
    return list(measurement_reasons(drawing(*measurements), date.fromisoformat(today)))


def test_measured_sides_give_the_size_tolerance_where_none_is_stated():
    # 0.1 % and 0.02 %: the root of the mean of their squares.
    assert drawing(ACROSS, ALONG).size_tolerance == pytest.approx((0.5 * (0.001**2 + 0.0002**2)) ** 0.5)
    assert drawing(ACROSS, size_tolerance=0.003).size_tolerance == 0.003
    assert drawing().size_tolerance == 0.0015


def test_what_was_measured_is_kept_as_it_is_stored():
    known = drawing(ACROSS | {"measured_on": "2021-01-31", "expires_on": "2022-01-31", "nominal_mm": 200.0}, ALONG)
    assert PhantomDrawing.model_validate(known.model_dump(mode="json")).model_dump() == known.model_dump()


def test_a_measurement_that_is_none_is_refused_with_its_value():
    with pytest.raises(ValidationError, match="standard_uncertainty_mm 25 of measured_mm 200 must be less than 10%"):
        drawing(ACROSS | {"standard_uncertainty_mm": 25.0})


def test_a_measurement_that_has_expired_is_a_reason_from_the_day_after():
    dated = ACROSS | {"measured_on": "2020-05-31", "expires_on": "2021-05-31"}
    assert reasons(dated, today="2021-05-31") == []
    (found,) = reasons(dated)
    assert found.startswith("The phantom's measurement of x expired on 2021-05-31. Measure it again. It was 200.00 mm")


def test_a_drawing_that_is_not_as_measured_is_a_reason():
    # Three standard uncertainties of 0.06 mm.
    assert reasons(ALONG | {"measured_mm": 300.17}) == []
    (found,) = reasons(ALONG | {"measured_mm": 300.19})
    assert "drawn 300.00 mm along y, and was measured as 300.19 mm" in found
    # A length that is no extent of the drawing is not compared with one.
    assert reasons(ALONG | {"what": "the notch", "measured_mm": 40.0}) == []
