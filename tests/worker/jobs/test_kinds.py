"""Each kind of job has its module."""

from importlib import import_module
from inspect import signature

import pytest

from sawmill_platform.attempts.work import Needs
from sawmill_platform.contracts.jobs import JobKind


@pytest.mark.parametrize("kind", JobKind.all())
def test_a_kind_s_module_has_its_function_and_its_needs(kind):
    module = import_module(f"sawmill_worker.jobs.{kind.replace('-', '_')}")
    assert list(signature(module.run).parameters) == ["attempt"]
    assert signature(module.needs).return_annotation is Needs
