"""Hypothesis under pytest: reproducible by default, settable from outside.

`--hypothesis-seed=N` chooses other random examples (default 0, so that every run tests the same);
`HYPOTHESIS_PROFILE=thorough` tries ten times as many where a test does not fix their number.
"""

import os

import hypothesis
import pytest

DEFAULT_SEED = "0"

# No deadline: a first example may compile. The blob repeats a failure without the database of examples.
hypothesis.settings.register_profile("coincid", deadline=None, print_blob=True)
hypothesis.settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=1000)


@pytest.hookimpl(tryfirst=True)  # before hypothesis's own plugin reads its options
def pytest_configure(config: pytest.Config) -> None:
    config.option.hypothesis_seed = config.option.hypothesis_seed or DEFAULT_SEED
    if config.option.hypothesis_profile is None:
        config.option.hypothesis_profile = os.environ.get("HYPOTHESIS_PROFILE", "coincid")


def pytest_report_header(config: pytest.Config) -> str:
    return f"hypothesis: --hypothesis-seed={config.option.hypothesis_seed}"
