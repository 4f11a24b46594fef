# SPDX-License-Identifier: Apache-2.0
"""What one host does with all lanes to tell mutants from the RTL.

It plays frames, accesses, resets, upsets and wide numbers; a `Part` is one frame and what goes with
it. The golden model says what the frames are. Of everything else, the lane without mutation is the
reference, so it only shows whether such stimuli reach a mutant; the benches of the regression
(`benches`) have the same kinds of stimuli, and expectations of their own.

`session` returns all parts. What follows it are the kinds of parts in their order, then their
helpers. All of it is drawn from one generator, so every host is repeated by its seed.
"""

import itertools
import random
import re
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
from amaranth.hdl import Shape
from attrs import frozen

from coincid.hdl.bus import Operation
from coincid.model.contract import registers
from coincid.model.contract.config import Config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import DATA_BITS, MODE, WRITABLE
from coincid.model.contract.registers import Access as Use
from coincid.model.contract.settings import AUTO_BOUNDS
from coincid.slices.emit import Emission
from coincid.slices.netlist import ONE
from coincid.tb.frame_record import FrameJob

from . import random_cases
from .lanes import FLIPS, GAP, RESET, WHOLE, Access, Upset

# How often each kind of part is played.
LIGHTS = 1200  # frames whose light is drawn anew
STARTS = 20  # frames with accesses during them
RESETS = 100
UPSETS = 2500  # frames with upsets
UPSET_ACCESSES = 60  # lists of accesses with upsets between them
SCRAMBLES = 5000
AHEAD = 1000
WIDE = 2500
LONG = 600
COMMANDS = 1000

FULL = (1 << DATA_BITS) - 1
SHORT = 400  # cycles of a frame that is played often
SWEEP_VALUES = 40  # random values of a register
BESIDE_MAX = 3000  # writes that reads accompany
TIES = 16  # in a frame, at most
ACCESSES_TOGETHER = 400  # of a list with upsets
UPSETS_TOGETHER = 100  # in such a list, one every so many cycles:
UPSET_EVERY = 20
UPSET_BITS = 100  # settings' bits in a part,
UPSET_CYCLES = 80  # and how long each is upset
REFUSAL_CYCLES = 30  # of a start that is refused, with reading and clearing the status, at least
WIDE_BITS = 9  # of a register whose values a short frame does not reach
COPIES = ("_plain", "_inverse", "_by_turns", "_turn")  # ends of names of a voted register's parts
CONTROL = ("registers", "sequencer", "readout", "controller")
FRONT = ("registers", "registers.behind_port")  # units of the register front

RESET_ALL = Access(0, 0, RESET, 0, 0)
STATUS = registers.address("status")
PERIOD = registers.address("period")
START = registers.control("start")
ABORT = registers.control("abort")

Part: TypeAlias = tuple[str, dict[str, Any]]  # name, and arguments of `Lanes.recipe`
Register: TypeAlias = list[int]  # the words of its bits, the lowest first


def read(address: int, hold: int = 0) -> Access:
    """Return a read; hold: cycles in which the host does not take the answer."""
    return Access(address, 0, 0, 0, hold)


def write(address: int, value: int, strobe: int = WHOLE, skew: int = 0, hold: int = 0) -> Access:
    """Return a write; skew: cycles by which the data come after the address, or before it."""
    return Access(address, value & FULL, strobe, skew, hold)


TOTALS = [read(registers.address(name)) for name in ("budget", "limit")]
# A start that settings forbid: the status tells why.
REFUSED = [write(*START), read(STATUS), write(STATUS, FULL)]


def words(sensor: Sensor) -> Iterator[tuple[int, registers.Register]]:
    """Yield address and register of every word."""
    for table, subgroups in ((registers.GLOBAL, 1), (registers.SUBGROUP, sensor.subgroups)):
        for _, register, index in registers.words(table, sensor):
            for s in range(subgroups):
                yield registers.address(register.name, s, index), register


def kept(emission: Emission) -> dict[str, Register]:
    """Return every register, by its name in the flat design."""
    flops = {flop.output for flop in emission.top.flops}
    places = emission.layout.nets
    found = {}
    for name, nets in emission.top.names.items():
        if flops.issuperset(nets):
            found[name] = [places[net] for net in nets]
    return found


def watched(emission: Emission) -> list[int]:
    """Return the words of voted registers' copies.

    The bench of faults compares them in every cycle.
    """
    found = []
    for name, register in kept(emission).items():
        if name.endswith(COPIES):
            found += register
    return found


@frozen
class Script:
    """What all kinds of parts are made from.

    jobs: frames that the golden model has played; short: those that are played often; reads: of
    every word.
    """

    sensor: Sensor
    emission: Emission
    jobs: Sequence[FrameJob]
    short: Sequence[FrameJob]
    reads: list[Access]
    rng: random.Random

    @property
    def led(self) -> list[FrameJob]:
        """Return the short frames with the controller."""
        return [job for job in self.short if job.config.controlled.any()]

    @property
    def shortest(self) -> FrameJob:
        """Return the shortest frame."""
        return min(self.short, key=lambda job: job.config.frame_cycles)


def session(
    sensor: Sensor, emission: Emission, jobs: Sequence[FrameJob], whole: bool, seed: int
) -> list[Part]:
    """Return what the host does, in order. The first parts are the jobs.

    emission: the sensor in slices; whole: with faults and large numbers, which take longest.
    """
    script = Script(
        sensor=sensor,
        emission=emission,
        jobs=jobs,
        short=[job for job in jobs if job.config.frame_cycles < SHORT],
        reads=[read(address) for address, _ in words(sensor)],
        rng=random.Random(seed),
    )
    parts = [part("frames", job, after=script.reads) for job in jobs]
    parts += _lights(script)
    parts += _accesses(script)
    parts += _starts(script)
    parts += _resets(script)
    if whole:
        parts += _upset_frames(script)
        parts += _upset_accesses(script)
        parts += _upset_settings(script)
        parts += _scrambles(script)
        parts += _ahead(script)
        parts += _wide(script)
        parts += _long(script)
        parts += _commands(script)
    return parts


def part(name: str, job: FrameJob, dark: bool = False, **others: Any) -> Part:
    """Return a part that plays a job's frame.

    dark: without light; others: arguments of `Lanes.recipe`, also in the place of the job's.
    """
    no_light = Edges(*3 * [np.zeros(0, np.int64)])
    recipe = {
        "config": job.config,
        "edges": no_light if dark else job.edges,
        "ready": job.config.tready(job.ready),
        "patient": False,
    }
    return name, recipe | others


def _lights(script: Script) -> Iterator[Part]:
    """The frames' settings in other light, with other back-pressure.

    Some have long periods, some have large settings.
    """
    rng = script.rng
    for k in range(LIGHTS):
        config = rng.choice(script.jobs).config
        if k % 8 == 0:
            config = config.with_frame(
                period=config.sensor.period_max, pulses=3, minigroup_records=True, mg_threshold=1
            )
        if k % 3 == 0:
            config = _far(config, rng).with_settings(gating=True)
        density = rng.choice((4.0, 12.0, 30.0, 80.0)) * min(1, 4 / config.pulses)
        kind = random_cases.READY_KINDS[k // 3 % len(random_cases.READY_KINDS)]
        ready = random_cases.ready_pattern(k, kind, config.pulses * config.period + 100)
        edges = random_cases.trouble(config, k, density)
        yield part("light", FrameJob(config, edges, script.jobs[0].expected, ready))


def _far(config: Config, rng: random.Random) -> Config:
    """Return a configuration with other settings of progressive gating, often large ones."""
    every = rng.getrandbits(16 - rng.randrange(16))
    step = rng.getrandbits(16 - rng.randrange(16))
    steps = rng.getrandbits(16 - rng.randrange(16))
    gate_every = rng.choice((1, 1, 2, every))
    return config.with_frame(gate_every=gate_every, gate_step=step, gate_steps=max(steps, 1))


def _accesses(script: Script) -> Iterator[Part]:
    """Accesses to every register, in a row, and reads beside writes."""
    rng = script.rng
    first = script.short[0]
    accesses = sweep(script.sensor, rng)
    yield part("registers", first, dark=True, after=accesses)
    writes = [access for access in accesses if access.strobe][:BESIDE_MAX]
    beside = []
    for _ in writes:
        address = rng.choice(script.reads).address
        beside.append(read(address, rng.choice((0, 0, 0, 1, 2, 5))))
    yield part("registers", first, dark=True, after=writes, beside=beside)
    yield part("registers", first, dark=True, after=refused(script.sensor, rng))


def sweep(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return writes of legal and illegal values to every register, each with reads.

    Accesses that make no sense follow.
    """
    every = list(words(sensor))
    accesses: list[Access] = []
    for address, register in every:
        if register.access is Use.SETTING:
            low = register.low(sensor)
            high = register.high(sensor)
            accesses += _sweep_of_setting(address, low, high, every, rng)
        elif register.access not in WRITABLE:
            accesses += [write(address, rng.getrandbits(DATA_BITS)), read(address)]
    return accesses + _strange_accesses(every, rng)


def _sweep_of_setting(
    address: int,
    low: int,
    high: int,
    every: list[tuple[int, registers.Register]],
    rng: random.Random,
) -> list[Access]:
    """Return writes to a setting: at its limits, beyond them, and with partial strobes."""
    span = (1 << high.bit_length()) - 1
    values = [low, high, low - 1, high + 1, 0x55555555 & span, 0xAAAAAAAA & span]
    values += [high | 1 << bit for bit in range(DATA_BITS)]
    values += [rng.randint(low, high) for _ in range(SWEEP_VALUES)]
    values += [rng.getrandbits(DATA_BITS) for _ in range(2)]
    accesses: list[Access] = []
    for value in values:
        skew = rng.choice((0, 0, 1, -1, 3, -3))
        hold = rng.choice((0, 0, 1, 4))
        accesses.append(write(address, value, skew=skew, hold=hold))
        accesses.append(read(address, rng.choice((0, 0, 1, 4))))
    accesses += [read(rng.choice(every)[0]), read(STATUS), write(STATUS, FULL)]
    accesses += [write(address, low, strobe) for strobe in (1, 2, 4, 8, 7, 14)]
    accesses += [read(address), read(STATUS)]
    accesses += [write(STATUS, 1 << rng.randrange(12)), read(STATUS)]
    return accesses


def _strange_accesses(
    every: list[tuple[int, registers.Register]], rng: random.Random
) -> list[Access]:
    """Return accesses to addresses without a register, or near those of one."""
    addresses = [address for address, _ in every]
    holes = {4 * k for k in range(1 << 11)} - set(addresses)
    strange = rng.sample(sorted(holes), 60)
    strange += [rng.randrange(1 << registers.ADDRESS_BITS) for _ in range(100)]
    for address in addresses:
        strange += [address ^ 1 << bit for bit in range(registers.ADDRESS_BITS)]
    accesses: list[Access] = []
    for address in strange:
        if address & ~3 != START[0]:
            accesses.append(read(address))
            accesses.append(write(address, rng.getrandbits(DATA_BITS)))
            accesses.append(read(STATUS))
        if rng.random() < 0.3:
            accesses += [write(STATUS, rng.getrandbits(12)), read(STATUS)]
    return accesses


def refused(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return starts that are refused for one reason.

    So the status shows whether there is another one, too.
    """
    accesses = [write(PERIOD, 1)]
    accesses += _starts_with_descending_bounds(rng)
    accesses += _starts_with_parts_of_words(sensor)
    accesses.append(write(registers.address("auto_bounds"), FULL))
    accesses += _starts_with_late_gates(sensor, rng)
    return [*accesses, RESET_ALL]


def _starts_with_descending_bounds(rng: random.Random) -> list[Access]:
    """Return starts with neighbouring bounds that are nearly equal, in both orders."""
    accesses: list[Access] = []
    for k, bit in itertools.product(range(AUTO_BOUNDS - 1), range(DATA_BITS)):
        low = rng.getrandbits(DATA_BITS)
        pair = sorted((low, low ^ (1 << bit) ^ rng.getrandbits(bit)))
        for one, other in (pair, pair[::-1]):
            bounds = [0] * k + [one, other] + [FULL] * (AUTO_BOUNDS - 2 - k)
            for index, bound in enumerate(bounds):
                accesses.append(write(registers.address("auto_bounds", index=index), bound))
            accesses += REFUSED
    return accesses


def _starts_with_parts_of_words(sensor: Sensor) -> list[Access]:
    """Return starts after writes of parts of a word, which keeps value and parity."""
    accesses: list[Access] = []
    for address, register in words(sensor):
        if register.access is Use.SETTING and address != PERIOD:
            for value in (0, 1, 2):
                accesses += [write(address, value, strobe=7), *REFUSED]
    return accesses


def _starts_with_late_gates(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return starts with a gate that begins near the period's end, before and after it."""
    accesses: list[Access] = []
    for s, bit in itertools.product(range(sensor.subgroups), range(sensor.coarse_bits)):
        accesses.append(write(registers.address("mode", s), 1 << MODE.bit("gating")))
        low = rng.randrange(sensor.period_max)
        near = low ^ 1 << bit
        for period, gate_start in ((low, near), (near, low), (low, low)):
            accesses.append(write(PERIOD, max(period, 1)))
            accesses.append(write(registers.address("gate_start", s), gate_start))
            accesses += REFUSED
    return accesses


def _starts(script: Script) -> Iterator[Part]:
    """Writes, starts and aborts during a frame, and starts that make no sense."""
    rng = script.rng
    for _ in range(STARTS):
        job = rng.choice(script.short)
        during = [write(*START), read(STATUS)]
        for address, value in rng.choice(script.short).config.register_writes():
            if rng.random() < 0.1:
                during += [write(address, value), read(address)]
        during += [write(STATUS, 0xFFC), read(STATUS)]
        if rng.random() < 0.5:
            during.append(write(*ABORT))
        yield part("registers", job, during=during, after=script.reads)
        wrong = _wrong_settings(script.sensor, rng)
        tried = [write(*START), read(STATUS), write(STATUS, FULL), read(STATUS), RESET_ALL]
        yield part("registers", job, dark=True, after=[*wrong, *tried])
        yield part("registers", job, dark=True)


def _wrong_settings(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return writes after which a start is refused: period, bounds, or gate."""
    short_period = [("period", 0, 0, sensor.guard)]
    bounds = []
    for _ in range(2):
        index = rng.randrange(6)
        bounds.append(("auto_bounds", 0, index, 300 + rng.randrange(1 << 20)))
    late_gate = [("mode", s, 0, 2) for s in range(sensor.subgroups)]
    late_gate.append(("gate_start", rng.randrange(sensor.subgroups), 0, sensor.period_max - 1))
    wrong = rng.choice((short_period, bounds, late_gate))
    return [write(registers.address(name, s, index), value) for name, s, index, value in wrong]


def _resets(script: Script) -> Iterator[Part]:
    """Resets in some cycle of a frame, and frames after them."""
    rng = script.rng
    for _ in range(RESETS):
        job = rng.choice(script.short)
        reads = rng.randrange(1, max(2, job.config.frame_cycles // 6))
        wait = [read(STATUS) for _ in range(reads)]
        yield part("resets", job, during=[*wait, RESET_ALL], after=script.reads)
        yield part("resets", rng.choice(script.short))


def _upset_frames(script: Script) -> Iterator[Part]:
    """Frames in which flip-flops flip; another start follows."""
    rng = script.rng
    units = _units(script.emission)
    control = [units[name] for name in units if name.startswith(CONTROL) or ".settings" in name]
    again = [write(*START), read(STATUS), write(STATUS, FULL), read(STATUS), RESET_ALL]
    for k in range(UPSETS):
        job = rng.choice(script.short)
        among = control if k % 3 else list(units.values())
        last = job.config.frame_cycles + 2 * GAP
        upsets = [_flip(among, rng.randrange(last), rng) for _ in range(rng.choice((1, 2, 5, 12)))]
        after = script.reads if k % 10 == 0 else []
        yield part("upsets", job, upsets=upsets, after=[*after, *(again if k % 2 else [])])


def _upset_accesses(script: Script) -> Iterator[Part]:
    """Accesses between which flip-flops of the register front flip."""
    rng = script.rng
    units = _units(script.emission)
    front = [[register for name in FRONT for register in units[name]]]
    first = script.shortest
    begin = _after_frame(first)
    addresses = [access.address for access in script.reads]
    for _ in range(UPSET_ACCESSES):
        accesses = [_any_access(addresses, rng) for _ in range(ACCESSES_TOGETHER)]
        upsets = []
        for k in range(UPSETS_TOGETHER):
            cycle = begin + UPSET_EVERY * k + rng.randrange(UPSET_EVERY)
            upsets.append(_flip(front, cycle, rng))
        yield part("upsets", first, dark=True, after=[*accesses, RESET_ALL], upsets=upsets)


def _any_access(addresses: list[int], rng: random.Random) -> Access:
    """Return a write of a random number of bits, a read, or a read of the status."""
    match rng.choice(("write", "read", "status")):
        case "write":
            address = rng.choice(addresses)
            return write(address, rng.getrandbits(DATA_BITS) >> rng.randrange(DATA_BITS))
        case "read":
            return read(rng.choice(addresses), rng.choice((0, 1, 4)))
        case _:
            return read(STATUS)


def _upset_settings(script: Script) -> Iterator[Part]:
    """Bits of settings that are wrong for a while, one after another, in which starts are tried."""
    first = script.shortest
    begin = _after_frame(first)
    bits = []
    for name, unit in _units(script.emission).items():
        if name in FRONT or ".settings" in name:
            for register in unit:
                bits += register
    for k in range(0, len(bits), UPSET_BITS):
        some = bits[k : k + UPSET_BITS]
        upsets = []
        for i, bit in enumerate(some):
            upsets.append(Upset(bit, begin + UPSET_CYCLES * (i + 1), FLIPS))
            upsets.append(Upset(bit, begin + UPSET_CYCLES * (i + 2), FLIPS))
        tried = REFUSED * (UPSET_CYCLES * (len(some) + 2) // REFUSAL_CYCLES)
        after = [write(PERIOD, 1), *tried, RESET_ALL]
        yield part("upsets", first, dark=True, after=after, upsets=upsets)


def _after_frame(job: FrameJob) -> int:
    """Return a cycle in which the frame is surely over."""
    return job.config.frame_cycles + 4 * GAP


def _scrambles(script: Script) -> Iterator[Part]:
    """Frames in which units come into any state."""
    rng = script.rng
    kinds: dict[str, list[list[Register]]] = {}  # a unit that repeats is one of them
    for name, unit in _units(script.emission).items():
        kinds.setdefault(re.sub(r"\d+", "", name), []).append(unit)
    of_kind = list(kinds.values())
    one = script.emission.layout.nets[ONE]
    for k in range(SCRAMBLES):
        job = rng.choice(script.short)
        upsets: list[Upset] = []
        for _ in range(rng.choice((1, 2, 4, 8))):
            upsets += _scrambled_unit(job, of_kind, one, rng)
        after = [RESET_ALL] if k % 2 else [*TOTALS, RESET_ALL]
        others = {} if k % 3 else {"config": _far(job.config, rng).with_settings(gating=True)}
        yield part("upsets", job, upsets=upsets, after=after, **others)


def _scrambled_unit(
    job: FrameJob, of_kind: list[list[list[Register]]], one: int, rng: random.Random
) -> list[Upset]:
    """Return upsets of registers of a unit in one cycle.

    They become random, nearly equal to others, or close to a carry. one: the word of a constant 1.
    """
    cycle = rng.randrange(job.config.frame_cycles + 2 * GAP)
    unit = rng.choice(rng.choice(of_kind))
    chosen = unit if rng.random() < 0.5 else rng.sample(unit, rng.randrange(1, len(unit) + 1))
    upsets: list[Upset] = []
    for register in chosen:
        match rng.randrange(4):
            case 0:
                sources = rng.choice((unit, rng.choice(rng.choice(of_kind))))
                upsets += _tie([register], sources, cycle, rng)
            case 1:
                low = rng.randrange(len(register) + 1)
                upsets += [Upset(word, cycle, one) for word in register[:low]]
                upsets += _flips(register[low:], cycle, rng.getrandbits(len(register)))
            case _:
                upsets += _flips(register, cycle, rng.getrandbits(len(register)))
    return upsets


def _ahead(script: Script) -> Iterator[Part]:
    """Frames with counters as after a long time.

    They are close to a carry, or to the setting that ends them.
    """
    rng = script.rng
    every = kept(script.emission)
    counters = []
    for name, register in every.items():
        if ".dpcu." in name and len(register) >= WIDE_BITS:
            counters.append(register)
    kinds = (_losing(script.jobs), script.led, script.short)
    for k in range(AHEAD):
        job = rng.choice(kinds[k % 3])
        config = job.config if k % 2 else _far(job.config, rng).with_settings(gating=True)
        begin = rng.randrange(10, 50)
        upsets: list[Upset] = []
        for name, end in (("pulses", config.frame.gate_every), ("steps", config.frame.gate_steps)):
            near_end = max(end - rng.randrange(1, 4), 0)
            upsets += _flips(every[f"sequencer.{name}"], begin, near_end)
        for register in counters:
            cycle = rng.randrange(job.config.frame_cycles) if rng.random() < 0.5 else begin
            ones = rng.choice((rng.randrange(len(register) + 1), len(register)))
            number = rng.getrandbits(len(register)) | ((1 << ones) - 1)
            upsets += _flips(register, cycle, max(number - rng.randrange(3), 0))
        yield part("wide", job, upsets=upsets, config=config)


def _losing(jobs: Sequence[FrameJob]) -> list[FrameJob]:
    """Return frames that are not long, and in which records are dropped."""
    dropped = COUNTER_NAMES.index("mg_dropped")
    found = []
    for job in jobs:
        loses = job.expected.counters[:, dropped].any()
        if job.config.frame_cycles < 2 * SHORT and loses:
            found.append(job)
    return found


def _wide_registers(emission: Emission) -> dict[str, Register]:
    """Return the registers of many bits, by name, without copies of voted ones."""
    found = {}
    for name, register in kept(emission).items():
        if len(register) >= WIDE_BITS and not name.endswith(COPIES):
            found[name] = register
    return found


def _voted_bits(emission: Emission) -> list[list[tuple[int, ...]]]:
    """Return for every voted register its bits, and of each bit the words of its three copies."""
    every = kept(emission)
    found = []
    for name in every:
        if name.endswith(COPIES[0]):
            voted = name.removesuffix(COPIES[0])
            copies = [every[voted + copy] for copy in COPIES[:3]]
            found.append(list(zip(*copies, strict=True)))
    return found


def _wide(script: Script) -> Iterator[Part]:
    """Frames with large numbers in registers of many bits, and large settings.

    Some of the numbers are nearly equal to others.
    """
    rng = script.rng
    wide = _wide_registers(script.emission)
    counting = []
    controller = []
    for name, register in wide.items():
        if ".dpcu." in name or name.startswith(("controller", "readout")):
            counting.append(register)
        if "controller" in name:
            controller.append(register)
    voted = _voted_bits(script.emission)
    led = script.led
    for k in range(WIDE):
        job = rng.choice(led if k % 4 else script.short)
        end = job.config.frame_cycles + 2 * GAP
        upsets: list[Upset] = []
        for register in rng.sample(counting, rng.randrange(1, len(counting))):
            cycle = rng.randrange(20, end)
            nearly_full = not k % 3
            number = -1 << rng.randrange(4) if nearly_full else rng.getrandbits(len(register))
            upsets += _flips(register, cycle, number)
        for _ in range(rng.randrange(TIES)):
            early = rng.randrange(GAP)
            any_time = rng.randrange(end)
            late = rng.randrange(end - GAP, end + 2 * GAP)
            cycle = rng.choice((early, any_time, late))
            among = controller if k % 4 else counting
            upsets += _tie(among, among, cycle, rng)
        for bits in voted:
            for cycle in rng.sample(range(end), 4):
                upsets += _outvoted(bits, cycle, rng)
        after = script.reads[-40:] if k % 4 == 0 else TOTALS
        others = {"config": _with_large_budgets(job.config, rng)} if k % 2 else {}
        yield part("wide", job, upsets=upsets, after=after, **others)


def _outvoted(bits: list[tuple[int, ...]], cycle: int, rng: random.Random) -> list[Upset]:
    """Return upsets: another number in all copies, then another bit in one of them, four times."""
    upsets = []
    for copies in bits:
        if rng.random() < 0.5:
            upsets += [Upset(word, cycle, FLIPS) for word in copies]
    for later in range(1, 5):
        word = rng.choice(rng.choice(bits))
        upsets.append(Upset(word, cycle + later, FLIPS))
    return upsets


def _with_large_budgets(config: Config, rng: random.Random) -> Config:
    """Return a configuration with other bounds and another capacity, often large ones."""
    bounds = sorted(rng.getrandbits(rng.choice((8, 16, 22))) for _ in range(5))
    capacity = rng.getrandbits(rng.choice((20, 32)))
    return config.with_frame(capacity=capacity, auto_bounds=[0, *bounds])


def _long(script: Script) -> Iterator[Part]:
    """Frames of which the sequencer has counted far, or is made to go on for long.

    A reset ends them.
    """
    rng = script.rng
    plan = []
    counters = []
    for name, register in _wide_registers(script.emission).items():
        if name.startswith("registers.plan"):
            plan.append(register)
        if name.startswith("sequencer."):
            counters.append(register)
    both = counters + plan
    for k in range(LONG):
        job = rng.choice(script.short)
        end = job.config.frame_cycles
        register = rng.choice(both)
        upsets = _flips(register, rng.randrange(20, 60), rng.getrandbits(len(register)))
        for _ in range(rng.randrange(TIES)):
            upsets += _tie(counters if k % 2 else both, both, rng.randrange(20, end), rng)
        wait = [read(STATUS) for _ in range(end // 4)]
        others = {"config": _far(job.config, rng)} if k % 4 > 1 else {}
        during = [*wait, RESET_ALL]
        yield part("wide", job, upsets=upsets, during=during, after=script.reads, **others)


def _commands(script: Script) -> Iterator[Part]:
    """Starts during which the command on the configuration bus becomes another one.

    Often it is one that does not exist.
    """
    rng = script.rng
    code = kept(script.emission)["registers.command"][: Shape.cast(Operation).width]
    led = script.led
    for k in range(COMMANDS):
        upsets = _flips(code, rng.randrange(2 * GAP), rng.randrange(1, 1 << len(code)))
        after = [RESET_ALL] if k % 16 == 0 else []
        yield part("upsets", rng.choice(led), upsets=upsets, after=after)


def _units(emission: Emission) -> dict[str, list[Register]]:
    """Return every register once, by the unit that it is in."""
    last_name = {tuple(register): name for name, register in kept(emission).items()}
    units: dict[str, list[Register]] = {}
    for register, name in last_name.items():
        units.setdefault(name.rpartition(".")[0], []).append(list(register))
    return units


def _flip(units: list[list[Register]], cycle: int, rng: random.Random) -> Upset:
    """Return the upset of any flip-flop: of any register of any of the units."""
    word = rng.choice(rng.choice(rng.choice(units)))
    return Upset(word, cycle, FLIPS)


def _flips(register: Register, cycle: int, number: int) -> list[Upset]:
    """Return upsets of a register's bits that are 1 in a number."""
    return [Upset(word, cycle, FLIPS) for bit, word in enumerate(register) if number >> bit & 1]


def _tie(
    some: list[Register], sources: list[Register], cycle: int, rng: random.Random
) -> list[Upset]:
    """Return upsets that make one of some registers nearly equal to one of others.

    They differ in a bit, and perhaps in lower ones. The longer register keeps its upper bits.
    """
    one = rng.choice(some)
    other = rng.choice(sources)
    bits = min(len(one), len(other))
    size = rng.randrange(bits + 1)
    upsets = [
        Upset(word, cycle, source) for word, source in zip(one[:bits], other[:bits], strict=True)
    ]
    highest = max(size - 1, 0)  # of the bits that differ
    upsets += [Upset(word, cycle, FLIPS) for word in one[:highest] if rng.random() < 0.5]
    upsets += [Upset(word, cycle, FLIPS) for word in one[highest:size]]
    return upsets
