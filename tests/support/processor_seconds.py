"""Plugin of pytest that prints at the end how many processor seconds each folder of tests has taken.

The seconds of a test include those of its processes that ended in it. What belongs to no test (imports, collection,
fixtures of a whole run) is the row "between tests".
"""

import os
from collections import defaultdict
from pathlib import PurePosixPath
from typing import Any

import pytest


def processor_seconds() -> float:
    """Read the processor seconds of this process and of its ended children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class ProcessorSeconds:
    """Measure each phase of each test, in the process that runs it, and add them up where the run is reported."""

    def __init__(self) -> None:
        self._before = processor_seconds()
        self._by_folder: dict[str, float] = defaultdict(float)
        self._of_workers = 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        self._before = processor_seconds()

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_runtest_makereport(self) -> Any:
        report = yield
        now = processor_seconds()
        report.processor_s, self._before = now - self._before, now
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        folder = PurePosixPath(report.nodeid.partition("::")[0]).parent
        self._by_folder[str(folder)] += report.processor_s

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._of_workers += getattr(node, "workeroutput", {}).get("processor_s", 0.0)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["processor_s"] = processor_seconds()

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        of_tests = sum(self._by_folder.values())
        own = os.times()
        total = own.user + own.system + self._of_workers if self._of_workers else processor_seconds()
        rows = {**self._by_folder, "between tests": total - of_tests}
        terminalreporter.section("processor seconds by folder")
        for name, seconds in sorted(rows.items(), key=lambda row: -row[1]):
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
        terminalreporter.write_line(f"{total:8.1f}  in all")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(ProcessorSeconds(), "processor-seconds-by-folder")
