"""Kernels that know less of Landlock, or nothing."""

import os

import pytest
from structlog.testing import capture_logs

from sawmill_platform.confinement import confinement, landlock
from sawmill_platform.workers.settings import ExecutionSettings


def test_rights_that_a_kernel_does_not_know_are_not_asked_for():
    # <linux/landlock.h>: REFER came with version 2, TRUNCATE with 3, TCP with 4, IOCTL_DEV with 5, the scopes with 6.
    known = [landlock._bits(landlock._FILE_RIGHTS, version).bit_length() for version in range(1, 8)]
    assert known == [13, 14, 15, 15, 16, 16, 16]
    assert [landlock._bits(landlock._TCP_RIGHTS, version) for version in (3, 4, 7)] == [0, 3, 3]
    assert [landlock._bits(landlock._SCOPES, version) for version in (5, 6, 7)] == [0, 3, 3]


@pytest.mark.parametrize(
    ("version", "wanted", "user", "lines"),
    [
        (0, True, 1000, ["attempts-not-confined"]),
        (3, True, 1000, ["attempts-confined-in-part"]),
        (6, True, 1000, []),
        (6, True, 0, ["run-as-root"]),
        (7, False, 1000, ["attempts-not-confined"]),
    ],
)
def test_what_the_kernel_lacks_and_root_are_said_once_at_the_start(monkeypatch, version, wanted, user, lines):
    monkeypatch.setattr(landlock, "version", lambda: version)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    with capture_logs() as log:
        confinement.say_if_unconfined(ExecutionSettings(confine_attempts=wanted))
    assert [line["event"] for line in log] == lines


def test_a_kernel_without_landlock_lets_jobs_run(monkeypatch, tmp_path):
    monkeypatch.setattr(landlock, "version", lambda: 0)
    monkeypatch.setattr(landlock, "confine", lambda *_, **__: pytest.fail("there is no Landlock to ask"))
    monkeypatch.setattr(confinement, "refuse_calls", lambda: False)
    monkeypatch.setattr(confinement.capabilities, "drop_all", lambda: None)  # this process needs them
    confinement.confine_to(confinement.AttemptInput(kept=tmp_path), tmp_path)
