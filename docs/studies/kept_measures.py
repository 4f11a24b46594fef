# SPDX-License-Identifier: Apache-2.0
"""Measures for a page. Finished setups are kept in the build folder, so a run that was interrupted
continues.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from coincid.lab.campaign import FinishedFiles, Processes, campaign, read_measures
from coincid.lab.setup import Setup
from coincid.model.shared.folders import build_root
from coincid.tools.pages import counted


def kept_measures(
    page: str, setups: Mapping[str, Setup], names: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Return the measures of each setup by its key. page: folder in which they are kept."""
    finished = FinishedFiles(build_root() / "pages" / page, names)
    finished.folder.mkdir(parents=True, exist_ok=True)
    with Processes(progress=counted) as run:
        return campaign(setups, partial(read_measures, names=names), run, finished=finished)
