"""Plugin of pytest that prints the processor seconds of each folder's tests, their ended processes included."""

import os
import sys
import tomllib
from collections import defaultdict
from pathlib import PurePosixPath
from statistics import median
from typing import Any

import pytest
from measurement import reference_s

WHOLE = "not nightly"  # the selection of `make test`
# Processor seconds between two measurements of the reference computation, which needs a second of them.
BETWEEN_S = 180.0


def processor_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class ProcessorSeconds:
    """Measure each phase of each test, in the process that runs it, and add them up where the run is reported."""

    def __init__(self) -> None:
        self._before = processor_seconds()
        self._by_folder: dict[str, float] = defaultdict(float)
        self._of_workers = 0.0
        # Of the reference computation among the tests: where two processes share a core, both are slower.
        self._units: list[float] = []
        self._measured = self._before
        self._too_long = ""

    def pytest_sessionstart(self, session: pytest.Session) -> None:
        self._session = session

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        if processor_seconds() - self._measured > BETWEEN_S:
            self._units.append(reference_s())
            self._measured = processor_seconds()
        self._before = processor_seconds()

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_runtest_makereport(self) -> Any:
        report = yield
        now = processor_seconds()
        report.processor_s, self._before = now - self._before, now
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._by_folder[str(PurePosixPath(report.nodeid.partition("::")[0]).parent)] += report.processor_s

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        output = getattr(node, "workeroutput", {})
        self._of_workers += output.get("processor_s", 0.0)
        self._units += output.get("reference_s", [])

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput.update(processor_s=processor_seconds(), reference_s=self._units)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        of_tests = sum(self._by_folder.values())
        own = os.times()
        total = own.user + own.system + self._of_workers if self._of_workers else processor_seconds()
        rows = {**self._by_folder, "between tests": total - of_tests}
        terminalreporter.section("processor seconds by folder")
        for name, seconds in sorted(rows.items(), key=lambda row: -row[1]):
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
        terminalreporter.write_line(f"{total:8.1f}  in all")
        # Whether no file, word or other marker was asked for.
        asked = terminalreporter.config.option.keyword or terminalreporter.config.option.markexpr != WHOLE
        if terminalreporter.config.args_source is pytest.Config.ArgsSource.TESTPATHS and not asked:
            self.compare(terminalreporter, total)

    def compare(self, terminalreporter: Any, total_s: float) -> None:
        """Print the sum in units of the reference computation; above the limit the run fails."""
        unit_s = median(self._units or [reference_s()])
        # The limit of the whole suite is in units of the reference computation.
        settings = tomllib.loads((terminalreporter.config.rootpath / "pyproject.toml").read_text())
        units, limit = total_s / unit_s, float(settings["tool"]["sawmill"]["budget"]["suite_reference_units"])
        compared = f"times the reference computation of {unit_s:.3f} s; limit {limit:.0f}"
        terminalreporter.write_line(f"{units:8.0f}  {compared}")
        if units > limit:
            self._too_long = f"The suite takes too long, {units:.0f} {compared}: pyproject.toml, tool.sawmill.budget"
            self._session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_unconfigure(self) -> None:
        # After the line that counts the tests, all of which may have passed.
        if self._too_long:
            sys.stderr.write(self._too_long + "\n")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(ProcessorSeconds(), "processor-seconds-by-folder")
