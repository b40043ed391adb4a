"""A pytest plugin for where all tests should run, as in CI: `-p tests.expected_skips`.

A test that is skipped for a reason not named here fails the run.
"""

import os

import pytest

# Beginnings of the reasons that the tests give.
EXPECTED = (
    "root may write everywhere",  # CI may run as root
    "counts depend on the compiler",  # they are measured anew for each version of JAX
    "OpenCV 4 has no outline font",  # both generations are supported
    "this system cannot reset the peak",  # sandboxes keep /proc/self/clear_refs to themselves
)
if os.environ.get("REMIND_NO_BROWSER"):  # `.ci/run` found none and could not install one
    EXPECTED += ("chromium or chromedriver is not installed",)


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """What a test or module said when it was skipped."""
    said = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return said.removeprefix("Skipped: ")


def unexpected_skips(config: pytest.Config) -> list[pytest.TestReport | pytest.CollectReport]:
    """Reports of this run whose reason nobody expects; none in the workers of pytest-xdist."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    return [report for report in skipped if not reason_of(report).startswith(EXPECTED)]


def pytest_sessionfinish(session: pytest.Session) -> None:
    if unexpected_skips(session.config) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = unexpected_skips(terminalreporter.config)
    if reports:
        terminalreporter.section("skipped, but expected to run")
        for report in reports:
            terminalreporter.line(f"{report.nodeid}: {reason_of(report)}")
