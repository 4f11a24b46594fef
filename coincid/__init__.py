"""Coincid: an open, cycle-accurate model of a SPAD direct time-of-flight sensor.

Sub-packages, each importing only those before it: `coincid.model` (golden model and light, no HDL), `coincid.hdl`
(RTL in Amaranth), `coincid.tb` (simulators, cocotb, scoreboards). The command line is `coincid.cli`.
"""

from importlib.metadata import version

__version__ = version("coincid")
