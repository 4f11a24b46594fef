# SPDX-License-Identifier: Apache-2.0
"""Hypothesis under pytest: reproducible by default, settable from outside.

`--hypothesis-seed=N` chooses other random examples (default 0, so that every run tests the same
ones). `HYPOTHESIS_PROFILE=thorough` tries ten times as many unless a test fixes their number. A
test that needs an extra is marked with it (`needs.py`) and skipped without it. `--no-skips` makes a
skipped test fail; with all extras installed, no test is skipped. `--skipped-before` plays the tests
that the last run skipped. A failure ends with the command that repeats it. A test that leaves
something behind fails, too (`leftovers.py`).
"""

import os
import shlex
import tempfile
from collections.abc import Iterator

import hypothesis
import pytest
from hypothesis.internal.conjecture import providers

from .leftovers import Held, leftovers
from .needs import missing

DEFAULT_SEED = "0"
# in pytest's cache: the tests that the last run skipped, for what they need
SKIPPED = "coincid/skipped"
# Here compiling takes longer than running. In the environment, so that commands that tests start do
# it, too.
os.environ.setdefault("COINCID_OPTIMISE", "-O1")

# No deadline, because a first example may compile. The blob repeats a failure without the database
# of examples.
hypothesis.settings.register_profile("coincid", deadline=None, print_blob=True)
hypothesis.settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=1000)

# Hypothesis mixes constants of the modules that are loaded into its examples. A test would draw
# others after other tests, and the command that repeats a failure would not repeat it.
providers._get_local_constants = providers.Constants


@pytest.hookimpl(tryfirst=True)  # before hypothesis's own plugin reads its options
def pytest_configure(config: pytest.Config) -> None:
    config.option.hypothesis_seed = config.option.hypothesis_seed or DEFAULT_SEED
    if config.option.hypothesis_profile is None:
        config.option.hypothesis_profile = os.environ.get("HYPOTHESIS_PROFILE", "coincid")
    config.addinivalue_line("markers", "needs(name): the test needs an extra of tests/needs.py")
    config.addinivalue_line(
        "markers", "leaves(reason): the test leaves something behind on purpose"
    )
    # not in a worker of xdist, which sends its reports to this process
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Skipped(config), "coincid-skipped")


def pytest_report_header(config: pytest.Config) -> str:
    return f"hypothesis: --hypothesis-seed={config.option.hypothesis_seed}"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="a test that is skipped fails")
    parser.addoption(
        "--skipped-before",
        action="store_true",
        help="only tests that the last run skipped for their needs",
    )


class _Skipped:
    """Collects the names of the tests that are skipped because something that they need is
    missing.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.names: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and report.when == "setup" and "needs " in str(report.longrepr):
            self.names.append(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        # `judge.py` and `planted.py` run without a cache, so that they leave the names alone.
        has_cache = self.config.pluginmanager.hasplugin("cacheprovider")
        if has_cache and not self.config.option.skipped_before:
            self.config.cache.set(SKIPPED, sorted(self.names))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.option.skipped_before:
        return
    wanted = set(config.cache.get(SKIPPED, []))
    others = [item for item in items if item.nodeid not in wanted]
    items[:] = [item for item in items if item.nodeid in wanted]
    config.hook.pytest_deselected(items=others)


@pytest.hookimpl(tryfirst=True)  # before fixtures that need the same
def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("needs"):
        for name in mark.args:
            if why := missing(name):
                pytest.skip(why)


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


@pytest.fixture(scope="session", autouse=True)
def own_temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Give this process, and those that it starts, a folder of its own for temporary files."""
    folder = str(tmp_path_factory.mktemp("temporary"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield


@pytest.fixture(autouse=True)
def leaves_nothing_behind(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves something behind."""
    before = Held.now()
    yield
    left = [] if request.node.get_closest_marker("leaves") else leftovers(before)
    assert not left, f"left behind: {', '.join(left)}"
