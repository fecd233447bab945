import pytest
from pydantic import ValidationError

from worker.execution.environment import environment_with
from worker.execution.settings import ExecutionSettings


def test_settings_survive_the_way_through_an_environment(monkeypatch):
    sent = ExecutionSettings(lease_s=7, heartbeat_s=1.5, workers=3, broker_url=None, log_format="json")
    monkeypatch.setenv("SAWMILL_BROKER_URL", "redis://elsewhere")
    environment = environment_with(sent)
    for name in [name for name in environment if name.startswith("SAWMILL_")] + ["SAWMILL_BROKER_URL"]:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert ExecutionSettings() == sent


def test_a_lease_shorter_than_two_heartbeats_is_refused():
    with pytest.raises(ValidationError, match=r"lease_s must be at least twice heartbeat_s \(10.0\), not 15.0"):
        ExecutionSettings(lease_s=15, heartbeat_s=10)
