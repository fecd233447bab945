"""schemathesis finds nothing: what the OpenAPI document allows is taken, and what it forbids is refused."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import schemathesis
from schemathesis.config import ProjectConfig, SchemathesisConfig
from schemathesis.engine import Status, events, from_schema

from sawmill_service.settings import ServiceSettings

FUZZED = 50  # requests an operation, by night
# Phases: test_openapi.py sends the document's own examples, and the edges hold more than one random request does.
BY_NIGHT = ("examples", "fuzzing", "stateful")
# What one value says of another, or of what is stored: JSON schemas of single parameters and fields cannot tell it,
# so a request that they allow may be refused with these sentences. Of any other refusal it is a failure.
BEYOND_SCHEMAS = re.compile(
    r"^rows is \S+, but scan "
    r"|(rows|slices) must be A:B with 0 <= A < B"
    r"|give count or slices, not both"
    r"|window_low must be below window_high"
    r"|standard_uncertainty_mm \S+ of measured_mm \S+ must be less than 10% of it"
    r"|give a length within 10% of the drawing"
    r"|log_radius_mm \S+ must be less than constants.source_to_cor_mm"
    r"|the first cells of detector_modules must increase"
    r"|where the detector is half a circle"
    r"|detector_waves_mm must be numbers of mm, smaller than the detector"
    r"|holds values, in grey; for color_map=\S+ ask for bits=8"
    r"|is a polygon that "
    r"|is a hole from x = \S+ to \S+ mm: the wood is from "
    r"|densities times their areas add up to \S+ mm\u00b2: wood must outweigh holes"
    r"|inspection_ids has \d+ files for \d+ pairs"
    r"|source_to_detector_mm \S+ must be larger than source_distance_mm"
    r"|averaged_rows goes with line-integrals, not counts"
    r"|align_rows \S+ moves rows, which averaged_rows says are averaged"
    r"|expires_at must lie ahead"
    r"|a range must be \[low, high\] with low < high"
    r"|must be names of events as /v1/events has them"
    r"|^query\.fields\.\w+ is not a known field"  # of the items of a list
    # schemathesis sends headers without a question mark at their beginning.
    r"|Upload-Complete must be \?1 or \?0, not '[01]'"
)
# The largest file and body, watched folders, and where webhooks may lead, are settings. Whether a part is the last one
# depends on the length that its upload was declared with, and whether a body may be empty on whether an earlier file is
# named. Times and zones of schedules are words that no schema describes; nor does one describe what a request says of
# an earlier one, whose Idempotency-Key it has, or of what was read, whose ETag is its If-Match.
BEYOND_SCHEMAS_CODES = {
    *("body-too-large", "destination-not-allowed", "empty-body", "folder-refused", "idempotency-key-reused"),
    *("inconsistent-length", "invalid-cron", "invalid-zone", "precondition-failed", "row-out-of-range", "rows-outside"),
    *("two-files", "upload-too-large", "views-too-many"),
}


@pytest.fixture
def settings() -> ServiceSettings:
    sizes = {"max_upload_bytes": 2**21, "max_picture_bytes": 50_000, "max_json_bytes": 20_000}
    return ServiceSettings(**sizes, event_poll_s=0.01, change_rate_limit="6000/minute")


@pytest.fixture
def _settled(monkeypatch):
    """schemathesis merges its settings anew for each request, and looks for proxies: a fifth of its time."""
    monkeypatch.setenv("no_proxy", "*")
    for name in ("phases_for", "generation_for", "checks_config_for"):
        monkeypatch.setattr(ProjectConfig, name, merged_once(getattr(ProjectConfig, name)))


def merged_once(merge):
    made = {}

    def merged(config, *, operation=None, phase=None):
        key = (operation.label if operation else None, phase)
        if key not in made:
            made[key] = merge(config, operation=operation, **({} if phase is None else {"phase": phase}))
        return made[key]

    return merged


@pytest.mark.slow
@pytest.mark.usefixtures("_settled")
@pytest.mark.parametrize(
    "long",
    [False, pytest.param(True, marks=[pytest.mark.nightly, pytest.mark.timeout(7200)])],
    ids=["edges", "everything"],
)
def test_schemathesis_finds_nothing(seeded, long):
    # Streams end at once.
    seeded.app.state.stopping.begin()
    schema = schemathesis.openapi.from_dict(json.loads(seeded.app.openapi_json), config=configuration(long=long))
    schema.app = seeded.app
    found, cases = set(), 0
    for event in from_schema(schema).execute():
        if isinstance(event, events.NonFatalError | events.FatalError):
            found.add(repr(event))
        if isinstance(event, events.ScenarioFinished):
            cases += len(event.recorder.cases)
            found.update(failures(event.recorder))
    assert found == set(), "\n".join(sorted(found))
    assert cases > 500


def configuration(*, long):
    """By day the edges of what one request of each shape may hold; by night all phases of all operations."""
    document = tomllib.loads((Path(__file__).parent / "schemathesis.toml").read_text())
    if long:
        del document["operations"]
        document["generation"]["max-examples"] = FUZZED
        for name in BY_NIGHT:
            document["phases"][name]["enabled"] = True
    return SchemathesisConfig.from_dict(document)


def failures(recorder):
    for case_id, checks in recorder.checks.items():
        sent = recorder.interactions[case_id]
        if re.search(r"/None(/|$)", sent.request.uri):
            continue  # a link whose value is null, which schemathesis follows all the same
        for check in checks:
            if check.status is not Status.SUCCESS and not is_beyond_schemas(check, sent.response):
                yield (
                    f"{recorder.label}: {check.name}: {check.failure_info and check.failure_info.failure.message}: "
                    f"{sent.request.uri[:300]} {sent.request.body!r:.300} -> {sent.response.content[:300]}"
                )


def is_beyond_schemas(check, response):
    if check.name == "negative_data_rejection":
        # A header that nobody knows is nobody's concern (RFC 9110, section 5.1).
        return "in header - object with unexpected properties" in check.failure_info.failure.message
    if check.name != "positive_data_acceptance" or response.status_code not in {400, 412, 413, 422}:
        return False
    problem = response.json()
    return problem["code"] in BEYOND_SCHEMAS_CODES or BEYOND_SCHEMAS.search(problem["detail"]) is not None
