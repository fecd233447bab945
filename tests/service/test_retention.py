"""Rules of retention over HTTP and on their page: shown first, confirmed by number, for administrators alone."""

import re
from datetime import UTC, datetime, timedelta

import pytest
from documented import check_documented
from page_text import text_of

from sawmill_contracts.retention import RetentionKind
from sawmill_platform.contracts.keys import Scope
from sawmill_service.retention import KINDS


@pytest.fixture
def in_forty_days(store):
    store.database.now = lambda: datetime.now(UTC) + timedelta(days=40)


@pytest.mark.usefixtures("in_forty_days")
def test_rules_are_tried_confirmed_and_carried_out(seeded, store):
    refused = seeded.put("/v1/retention", json={"drifts_days": 30})
    check_documented(refused)
    assert (refused.status_code, refused.json()["code"]) == (409, "retention-unconfirmed")
    shown = seeded.get("/v1/retention/preview?drifts_days=30&calibrations_days=30").json()
    by_kind = {kind["kind"]: kind for kind in shown["kinds"]}
    assert (by_kind["drifts"]["number"], by_kind["calibrations"]["number"]) == (1, 0)
    assert by_kind["calibrations"]["stays"] == 1
    put = seeded.put("/v1/retention", json={**shown["rules"], "remove_at_most": shown["number"]})
    check_documented(put)
    assert (put.json()["rules"]["drifts_days"], put.json()["changed_by"]) == (30, "somebody at this machine")
    assert seeded.get("/v1/retention/preview").json()["rules"] == shown["rules"], "those in force"
    assert store.retention_keeper().remove_some().kind == "drifts"
    assert seeded.get("/v1/drifts/example").status_code == 404
    [removed] = [each for each in seeded.get("/v1/retention").json()["removed"] if each["number"]]
    assert (removed["kind"], removed["number"]) == ("drifts", 1)
    assert 'sawmill_retention_removed_total{kind="drifts"} 1.0' in seeded.get("/metrics").text


def test_a_wrong_rule_is_refused_with_its_value(seeded):
    for given in ({"log_scans_days": 0}, {"log_scans_bytes": 10**9}, {"log_scans_days": 36_501}):
        assert seeded.put("/v1/retention", json=given).status_code == 422
    assert seeded.get("/v1/retention/preview?log_scans_days=soon").status_code == 422


def test_rules_are_an_administrators(client):
    client.bring(Scope.ACTIVATE, name="line 2")
    assert (client.get("/v1/retention").status_code, client.get("/v1/retention/preview").status_code) == (200, 403)
    assert (client.put("/v1/retention", json={}).status_code, client.get("/retention").status_code) == (403, 403)
    assert "How long things are kept" not in client.get("/system").text


@pytest.mark.usefixtures("in_forty_days")
def test_the_page_shows_first_and_changes_what_was_confirmed_alone(seeded, store):
    seeded.headers["Accept-Language"] = "fi"
    wrong = seeded.post("/retention", data={"log_scans_days": "1.5"})
    assert wrong.status_code == 422
    assert "täytyy olla kokonainen määrä päiviä" in text_of(wrong.text)
    page = seeded.post("/retention", data={"drifts_days": "30", "reconstructions_days": "1 000"})
    assert "Siirtymän tarkistukset 1 :" in text_of(page.text)
    assert store.retention.get().changed_at is None
    assert "Poistetaanko 1 kohde?" in text_of(page.text)
    number = re.search(r'name="remove_at_most" value="([^"]+)"', page.text)[1]
    for fewer in ("0", "all"):
        refused = seeded.post("/retention/confirmed", data={"drifts_days": "30", "remove_at_most": fewer})
        assert refused.status_code == 409
        assert "Säännöt poistaisivat nyt enemmän kuin vahvistettiin" in text_of(refused.text)
        assert f'name="remove_at_most" value="{number}"' in refused.text
    typed = {"drifts_days": "30", "reconstructions_days": "1 000", "remove_at_most": number}
    assert seeded.post("/retention/confirmed", data=typed).status_code == 303
    assert store.retention.get().rules.reconstructions_days == 1000
    assert 'value="1000"' in seeded.get("/retention").text


def test_every_kind_has_words():
    assert set(KINDS) == set(RetentionKind)
