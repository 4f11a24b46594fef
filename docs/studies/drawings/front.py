# SPDX-License-Identifier: Apache-2.0
"""Makes the picture on top of README and its caption: the scene of `make sim`, with its settings.

The golden model plays the frames here; `make sim` plays them on the RTL and checks that every word
is the same.
"""

import io
import shutil
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console

from coincid.lab.setup import Setup, scene_of
from coincid.model.contract.config import load_config
from coincid.model.scenes.catalogue import usual_klux
from coincid.model.shared import markdown
from coincid.study.simulate import simulate_to_folder, with_link
from coincid.tools.pages import picture, put

PAGE, REGION, PICTURE = "README.md", "scene", "docs/images/depth.png"
SCENE = "sun-and-shade"
ALT = "Truth; depth with coincidence off, with one threshold, and with the controller; the thresholds that it chose"


def standard_setup() -> Setup:
    """Return the setup of `make sim` without options, on the golden model."""
    config = with_link(load_config(None))
    return Setup(config=config, scene=scene_of(config, SCENE), klux=usual_klux(SCENE))


def caption(report: dict[str, Any]) -> str:
    """Return the caption for the report of a simulation (report.json)."""
    frame = report["configuration"]["frame"]
    schemes = "off", "fixed", "auto"
    wrong = [f"{100 * report[f'wrong_share_{name}']:.1f} %" for name in schemes]
    peaks = [f"{100 * report[f'wrong_share_{name}_peak']:.0f} %" for name in schemes]
    return markdown.paragraph(
        f"*A dark gateway in the shade beside a facade in the sun: {report['klux']:g} klux, "
        f"{frame['pulses']} laser pulses, a link of {frame['link_gbps']:g} Gbit/s, and the depth "
        f"of each pixel. With coincidence off, sunlight fills the link and {wrong[0]} of the pixels "
        f"are wrong. The best threshold for the whole array, which only the truth can tell, leaves "
        f"{wrong[1]} and takes {100 * report['load_fixed']:.0f} % of the link. A controller on the "
        f"chip gives every subgroup its own threshold without the truth, leaves {wrong[2]}, and "
        f"takes {100 * report['load_auto']:.0f} % of the link. With the simple estimator of the "
        f"paper, these shares of wrong pixels are {peaks[0]}, {peaks[1]} and {peaks[2]}.*"
    )


def make() -> None:
    """Write the picture and its caption into README."""
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        report = simulate_to_folder(
            standard_setup(), out=Path(folder), console=Console(file=io.StringIO())
        )
        shutil.copyfile(Path(folder) / "depth.png", picture(PICTURE))
    put(PAGE, REGION, f"![{ALT}]({PICTURE})\n\n{caption(report)}")


if __name__ == "__main__":
    make()
