# SPDX-License-Identifier: Apache-2.0
"""Hypothesis under pytest: reproducible by default, settable from outside.

`--hypothesis-seed=N` chooses other random examples (default 0, so that every run tests the same ones).
`HYPOTHESIS_PROFILE=thorough` tries ten times as many unless a test fixes their number. `--no-skips` makes a skipped test
fail; with all extras installed, no test is skipped. A failure ends with the command that repeats it.
"""

import os
import shlex
from collections.abc import Iterator

import hypothesis
import pytest

DEFAULT_SEED = "0"
# Here compiling takes longer than running. In the environment, so that commands that tests start do it, too.
os.environ.setdefault("COINCID_OPTIMISE", "-O1")

# No deadline, because a first example may compile. The blob repeats a failure without the database of examples.
hypothesis.settings.register_profile("coincid", deadline=None, print_blob=True)
hypothesis.settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=1000)


@pytest.hookimpl(tryfirst=True)  # before hypothesis's own plugin reads its options
def pytest_configure(config: pytest.Config) -> None:
    config.option.hypothesis_seed = config.option.hypothesis_seed or DEFAULT_SEED
    if config.option.hypothesis_profile is None:
        config.option.hypothesis_profile = os.environ.get("HYPOTHESIS_PROFILE", "coincid")


def pytest_report_header(config: pytest.Config) -> str:
    return f"hypothesis: --hypothesis-seed={config.option.hypothesis_seed}"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="a test that is skipped fails")


def _refuse_skip(config: pytest.Config, report: pytest.TestReport | pytest.CollectReport) -> None:
    if config.option.no_skips and report.skipped and not hasattr(report, "wasxfail"):
        why = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome, report.longrepr = "failed", f"{why}: with --no-skips nothing is skipped"


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    report = yield
    _refuse_skip(collector.config, report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    report = yield
    _refuse_skip(item.config, report)
    if report.failed:
        report.sections.append(("repeat this failure with", _repeat(item)))
    return report


def _repeat(item: pytest.Item) -> str:
    """Return the command that runs `item` again with the same seeds."""
    option = item.config.option
    seeds = [f"--hypothesis-seed={option.hypothesis_seed}"]
    if isinstance(seed := getattr(option, "randomly_seed", None), int):
        seeds.append(f"--randomly-seed={seed}")
    return f".venv/bin/python -m pytest {' '.join(seeds)} {shlex.quote(item.nodeid)}"
