# SPDX-License-Identifier: Apache-2.0
"""Which sensor has which top and which view of the front end."""

import pytest
from attrs import evolve

from coincid.hdl.deserialiser import PHASES_MAX
from coincid.hdl.front_end_views import POLYPHASE, VIEWS, Asynchronous, Polyphase, view_at
from coincid.hdl.sensor import FPGA_TOP, SensorTop, has_fpga_top
from coincid.hdl.subgroup import Subgroup
from coincid.hdl.subgroup_pair import SensorModule
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.shared.errors import InputError

SENSOR = Sensor(rows=8, cols=16, phases=8)


def own(base=Polyphase, **attributes):
    return type("Own", (base,), {"name": "own"} | attributes)()


@pytest.mark.parametrize("place", [SensorTop, Subgroup])
def test_a_view_without_quarters_has_no_counts(place):
    """It says so wherever it is placed; a sensor without counts has every view."""
    counting = evolve(SENSOR, counts=1)
    blind = own(has_quarters=False)
    for view in (VIEWS["async"], blind):
        place(SENSOR, view=view)
        told = f"sensor.counts = 1: must be 0 in the view {view.name}, which knows no quarters"
        with pytest.raises(InputError, match=told):
            place(counting, view=view)
    place(counting, view=own())
    place(counting)


@pytest.mark.parametrize(
    ("view", "told"),
    [
        ("other", "view = 'other': must be one of polyphase, async"),
        (3, "view = 3: must be one of polyphase, async, or a View"),
        (Polyphase, "view = .*: must be one of polyphase, async, or a View"),
        (own(name="async"), "view = 'async': must be another name: it is that of a built-in view"),
        (own(Asynchronous, name="polyphase"), "view = 'polyphase': must be another name"),
        (own(name="a/b"), "view = 'a/b': must be a name of letters"),
        (own(version=""), "view: Own.version = '', must be a text"),
    ],
)
def test_what_is_no_view_is_refused(view, told):
    with pytest.raises(InputError, match=told):
        view_at(view, 500)


@pytest.mark.parametrize("clock_mhz", [125.0, 500.0])
def test_a_view_has_the_clock_at_which_it_is_asked_for(clock_mhz):
    assert view_at("async", clock_mhz).circuit.clock_mhz == clock_mhz
    assert view_at(own(Asynchronous), clock_mhz).circuit.clock_mhz == clock_mhz
    assert view_at("polyphase", clock_mhz) is POLYPHASE and POLYPHASE.circuit is None
    assert VIEWS["async"] == Asynchronous()


def test_only_the_polyphase_view_is_used_where_none_is_named():
    assert POLYPHASE.is_default and Polyphase().is_default
    assert not VIEWS["async"].is_default and not own().is_default


@pytest.mark.parametrize("phases", [4, 8, 16, 32])
def test_a_sensor_of_few_phases_has_a_top_for_an_fpga(phases):
    """Four outputs of a PLL, with both edges, sample its lines."""
    sensor = evolve(SENSOR, phases=phases, offset_phases=4)
    assert has_fpga_top(sensor) == (phases <= PHASES_MAX == 8)


@pytest.mark.parametrize("view", VIEWS.values(), ids=list(VIEWS))
def test_a_top_has_a_port_of_light_for_each_subgroup(view):
    """Words of ticks, or lines; their levels and the clocks that sample them for an FPGA."""
    subgroups, pixels = SENSOR.subgroups, SENSOR.pixels
    top = SensorTop(SENSOR, view)
    widths = {port.name: port.width for port in top.ports()}
    bits = pixels * SENSOR.phases if view.by_words else pixels
    assert view.spad_bits(SENSOR) == bits and top.unit_name == TOP
    light = {name: width for name, width in widths.items() if name.startswith(("spad", "line"))}
    spads = {f"spad_{s}": bits for s in range(subgroups)}
    assert light == spads | {"spad_gate": subgroups}
    fpga = SensorTop(SENSOR, levels=True)
    of_levels = {port.name: port.width for port in fpga.ports()}
    lines = {f"line_{s}": pixels for s in range(subgroups)}
    own = lines | {"phase_clocks": SENSOR.phases // 2 - 1}
    rest = {name: width for name, width in widths.items() if name not in spads}
    assert of_levels == rest | own and fpga.unit_name == FPGA_TOP
    of_module = {port.name: port for port in SensorModule(SENSOR, view=view).ports()}
    assert of_module["words_1"].width == bits and of_module["words_1"].is_input
    assert not of_module["beat_1"].is_input
