# SPDX-License-Identifier: Apache-2.0
"""IP-XACT (IEEE 1685-2014) of a top module: bus interfaces and ports around the memory map that
PeakRDL makes.
"""

from collections.abc import Iterable, Mapping
from textwrap import indent

from ..hdl.axi import LITE, STREAM
from ..hdl.front_end_views import View
from ..model.contract.parameters import TOP, Sensor
from .ports import PortRow, port_rows

INDENT = "  "
MEMORY_MAP = "coincid_mmap"
BEFORE_MAPS = "  <ipxact:memoryMaps>\n"
AFTER_MAPS = "  </ipxact:memoryMaps>\n"
BUS, CLOCK, RESET = "s_axi", "clk", "rst"
# Vendor, library, name and version of the types of interfaces, as Vivado and Kactus know them.
AXI_LITE = ("amba.com", "AMBA4", "AXI4-Lite", "r0p0_0")
AXI_STREAM = ("amba.com", "AMBA4", "AXI4Stream", "r0p0_1")
CLOCK_TYPE = ("xilinx.com", "signal", "clock", "1.0")
RESET_TYPE = ("xilinx.com", "signal", "reset", "1.0")


def with_interfaces(registers: str, sensor: Sensor, view: View) -> str:
    """Return the IP-XACT of a sensor's registers with its bus interfaces and ports.

    registers: of `register_files`.
    """
    before, found, maps = registers.partition(BEFORE_MAPS)
    maps, ended, after = maps.partition(AFTER_MAPS)
    assert found and ended, "PeakRDL has written no memory map"
    interfaces = "".join(_interfaces(sensor))
    ports = "".join(_port(row) for row in port_rows(sensor, TOP, view))
    ahead = indent(_element("busInterfaces", interfaces), INDENT)
    model = indent(_model(ports), INDENT)
    return before + ahead + found + maps + ended + model + after


def _interfaces(sensor: Sensor) -> Iterable[str]:
    streams = [sensor.stream_name(k) for k in range(sensor.streams)]
    slave = _element("slave", f'<ipxact:memoryMapRef memoryMapRef="{MEMORY_MAP}"/>\n')
    lite_ports = {wire.upper(): f"{BUS}_{wire}" for wire in LITE.members}
    yield _interface(BUS, AXI_LITE, "AXI4-Lite_rtl", "r0p0_0", slave, lite_ports)
    for name in streams:
        wires = {wire.upper(): f"{name}_{wire}" for wire in STREAM.members}
        yield _interface(name, AXI_STREAM, "AXI4Stream_rtl", "r0p0_1", _empty("master"), wires)
    buses = ":".join([BUS, *streams])
    clock = {"ASSOCIATED_BUSIF": buses, "ASSOCIATED_RESET": RESET}
    slave = _empty("slave")
    yield _interface(CLOCK, CLOCK_TYPE, "clock_rtl", "1.0", slave, {"CLK": CLOCK}, clock)
    reset = {"POLARITY": "ACTIVE_HIGH"}
    yield _interface(RESET, RESET_TYPE, "reset_rtl", "1.0", slave, {"RST": RESET}, reset)


def _interface(
    name: str,
    kind: tuple[str, str, str, str],
    abstraction: str,
    abstraction_version: str,
    mode: str,
    wires: Mapping[str, str],
    parameters: Mapping[str, str] | None = None,
) -> str:
    """Return a bus interface. wires: logical name -> port of the module."""
    port_maps = "".join(
        _element(
            "portMap",
            _element("logicalPort", _text("name", logical))
            + _element("physicalPort", _text("name", port)),
        )
        for logical, port in wires.items()
    )
    of_type = (*kind[:2], abstraction, abstraction_version)
    described = _reference("abstractionRef", of_type) + _element("portMaps", port_maps)
    told = ""
    for key, value in (parameters or {}).items():
        told += _element("parameter", _text("name", key) + _text("value", f'"{value}"'))
    return _element(
        "busInterface",
        _text("name", name)
        + _reference("busType", kind)
        + _element("abstractionTypes", _element("abstractionType", described))
        + mode
        + (_element("parameters", told) if told else ""),
    )


def _model(ports: str) -> str:
    """Return the top module in Verilog with its ports."""
    reference = _text("componentInstantiationRef", "verilog")
    view = _element("view", _text("name", "rtl") + reference)
    module = _text("name", "verilog") + _text("language", "Verilog") + _text("moduleName", TOP)
    return _element(
        "model",
        _element("views", view)
        + _element("instantiations", _element("componentInstantiation", module))
        + _element("ports", ports),
    )


def _port(row: PortRow) -> str:
    bounds = _text("left", str(row.width - 1)) + _text("right", "0")
    vectors = _element("vectors", _element("vector", bounds)) if row.width > 1 else ""
    wire = _element("wire", _text("direction", row.direction) + vectors)
    return _element("port", _text("name", row.name) + wire)


def _reference(name: str, of: tuple[str, str, str, str]) -> str:
    vendor, library, kind, version = of
    return (
        f'<ipxact:{name} vendor="{vendor}" library="{library}" name="{kind}"'
        f' version="{version}"/>\n'
    )


def _text(name: str, text: str) -> str:
    return f"<ipxact:{name}>{text}</ipxact:{name}>\n"


def _empty(name: str) -> str:
    return f"<ipxact:{name}/>\n"


def _element(name: str, content: str) -> str:
    return f"<ipxact:{name}>\n{indent(content, INDENT)}</ipxact:{name}>\n"
