# SPDX-License-Identifier: Apache-2.0
"""The command line, in this process."""

import shlex

from click.testing import Result
from typer.testing import CliRunner

from coincid.cli import app


def command(words: str, *more: object) -> Result:
    """Return the result of `coincid`. words: as one types them; more: further words, whatever is in
    them.
    """
    return CliRunner().invoke(app, [*shlex.split(words), *map(str, more)])


def assert_refused(result: Result, *words: str) -> None:
    """Check for exit code 2 and one line that contains all `words`."""
    assert result.exit_code == 2, (result.output, result.exception)
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr
