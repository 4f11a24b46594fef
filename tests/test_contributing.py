# SPDX-License-Identifier: Apache-2.0
"""A new setting and a new format of events are one entry each: CONTRIBUTING.md's examples, put into
a copy of the sources.
"""

import re
import subprocess
import sys
import textwrap

import pytest

from .planted import ROOT, copy_of_sources

PLACES = {  # file: line before which its example goes, in the order of the page
    "model/contract/settings.py": "    mask: np.ndarray = ",
    "model/contract/packet.py": "}\n# Of a minigroup; a frame of this format has no events.",
}
SETTING = """
from coincid.flow.contract_tables import settings_tables
from coincid.flow.register_files import register_files
from coincid.hdl.bus import settings_layout
from coincid.model.contract.config import changes_of_text, load_config, parse_config
from coincid.model.contract.registers import BY_NAME, address
from coincid.model.shared.errors import InputError
from coincid.study.explore.controls import CONTROL
from coincid.study.explore.control_values import check_settings
from coincid.study.sweep_plot import LABELS
from coincid.study.sweep_spec import read_spec

config = parse_config({"subgroup": {"blank": 7}, "override": [{"subgroups": [3], "blank": 9}]})
assert config.blank.tolist() == [7, 7, 7, 9] + [7] * 12 and "subgroup.blank" in config.given
assert {(address("blank", 2), 7), (address("blank", 3), 9)} <= set(config.register_writes())
assert load_config("fpga", changes_of_text(["blank=3"])).blank[0] == 3 and parse_config({}).blank[0] == 0
try:
    parse_config({"subgroup": {"blank": 256}})
    raise SystemExit("not refused")
except InputError as error:
    assert str(error) == "subgroup.blank = 256: must be an integer from 0 to 255"
register = BY_NAME["blank"]
assert (register.offset, register.low(config.sensor), register.high(config.sensor)) == (0x3C, 0, 255)
assert all("blank" in text.lower() for text in register_files(config.sensor).values())
assert settings_layout(config.sensor)["blank"].width == 8
assert CONTROL["blank"].span(config.sensor) == "0 to 255 cycles" and check_settings({"blank": 5}).config.blank[0] == 5
assert LABELS["subgroup.blank"] == ("", "cycles")
assert "| `blank` | 0 | 0 to 255 | cycles | Cycles at the beginning" in settings_tables()["settings of subgroup"]
open("spec.toml", "w").write("[[axis]]\\nsubgroup.blank = [0, 4]")
assert [point.values for point in read_spec("spec.toml").points] == [{"subgroup.blank": 0}, {"subgroup.blank": 4}]
"""
FORMAT = """
import ctypes
import numpy as np
from coincid.flow.contract_tables import header_table
from coincid.flow.ports import stream_words
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden, golden_result
from coincid.tb.sliced import SlicedSensor
from tests.random_cases import built_sensor
from tests.flow.test_c_driver import Info, bus_of, compiled_driver, packets

small = dict(rows=4, cols=8, subgroup=[4, 4], phases=4, window_max=16, records=0, controller=0)
sensor = built_sensor(small)
rng, info = np.random.default_rng(1), Info()
frame = {"period": 60, "pulses": 5, "format": "times"}
config = parse_config({"sensor": small, "frame": frame, "subgroup": {"threshold": 1, "blank": 3}})
edges = Edges(*(rng.integers(0, high, 150) for high in (config.pulses, sensor.array_pixels, config.period_ticks)))
library = compiled_driver(sensor)
with SlicedSensor(sensor) as rtl:
    assert library.coincid_probe(ctypes.byref(bus_of(rtl)), ctypes.byref(info)) == 0
    rtl.frame(config, edges)
    (beats,) = rtl.driver.receive()
    assert rtl.driver["blank", 1] == 3
assert np.array_equal(beats, Golden(sensor).frame(config, edges).beats[0])
shown, full = decode_frame(beats, sensor, 2), decode_frame(
    Golden(sensor).frame(config.with_frame(format="full"), edges).beats[0], sensor, 2)
assert len(shown.events) > 20 and np.all(shown.events[:, 0] == 1)
assert np.array_equal(shown.events[:, 1:], full.events[:, 1:]) and np.array_equal(shown.offsets, full.offsets)
assert golden_result(config, edges).keys() & {"hits", "mg_offset"} == {"mg_offset"}
events = [packet for packet in packets(library, info, beats) if packet.kind == 1]
assert [packet.stamp for packet in events] == full.events[:, 6].tolist() and not any(packet.map for packet in events)
for packet, offsets in zip(events, full.offsets):
    assert [library.coincid_offset(ctypes.byref(packet), g) for g in range(sensor.minigroups)] == offsets.tolist()
assert "| 1 | event, format times | 2 | the offsets |" in stream_words(sensor)
assert "1 times (with offsets)" in header_table()
"""


@pytest.fixture(scope="module")
def extended(tmp_path_factory):
    """Return a function that runs Python in a copy of the sources with the examples."""
    folder, page = (
        tmp_path_factory.mktemp("extended"),
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
    )
    environment = copy_of_sources(folder) | {"NUMBA_DISABLE_JIT": "1"}
    examples = map(
        textwrap.dedent, re.findall(r"^ *```python\n(.*?)^ *```", page, re.DOTALL | re.MULTILINE)
    )
    for example, (file, before) in zip(examples, PLACES.items(), strict=True):
        text = (folder / file).read_text(encoding="utf-8")
        assert text.count(before) == 1
        (folder / file).write_text(
            text.replace(before, textwrap.indent(example, "    ") + before), encoding="utf-8"
        )

    def run(*arguments):
        command = [sys.executable, *arguments]
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, encoding="utf-8"
        )
        assert done.returncode == 0, done.stdout + done.stderr

    return run


def test_a_setting_is_one_entry(extended):
    extended("-c", SETTING)


@pytest.mark.long
def test_a_format_is_one_entry(extended):
    extended("-c", FORMAT)
    extended("-m", "coincid", "formal", "readout", "packetizer")
