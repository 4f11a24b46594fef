# SPDX-License-Identifier: Apache-2.0
"""What one host does with all lanes to tell mutants from the RTL: frames, accesses, resets, upsets, wide numbers.

The golden model says what the frames are. Of everything else, the lane without mutation is the reference, so it only shows
whether such stimuli reach a mutant; the benches of the regression (`benches`) have the same kinds of stimuli, and
expectations of their own.
"""

import itertools
import random
import re
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
from amaranth.hdl import Shape

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
from .lanes import FLIPS, GAP, RESET, Access

WHOLE = 15  # strobe of a word
FULL = (1 << DATA_BITS) - 1
SHORT = 400  # cycles of a frame that is played often
SWEEP_VALUES, STARTS, RESETS, UPSETS, UPSET_ACCESSES, WIDE, LONG = 40, 20, 100, 2500, 60, 2500, 600
SCRAMBLES, AHEAD = 5000, 1000
COMMANDS = 1000
LIGHTS = 1200  # frames whose light is drawn anew
TIES = 16  # in a frame, at most
UPSET_TOGETHER, UPSET_CYCLES = 100, 80  # settings' bits in a part, and how long each is upset
REFUSAL_CYCLES = 30  # of a start that is refused, with reading and clearing the status, at least
WIDE_BITS = 9  # of a register whose values a short frame does not reach
COPIES = ("_plain", "_inverse", "_by_turns", "_turn")  # ends of the names of a voted register's parts
CONTROL = ("registers", "sequencer", "readout", "controller")
RESET_ALL: Access = (0, 0, RESET, 0, 0)
STATUS, START, ABORT = registers.address("status"), registers.control("start"), registers.control("abort")
PERIOD = registers.address("period")
Upset: TypeAlias = tuple[int, int, int]  # word, cycle, source: as in `Lanes.recipe`
Part: TypeAlias = tuple[str, dict[str, Any]]  # name, and arguments of `Lanes.recipe`


def words(sensor: Sensor) -> Iterator[tuple[int, registers.Register]]:
    """Yield address and register of every word."""
    for table, subgroups in ((registers.GLOBAL, 1), (registers.SUBGROUP, sensor.subgroups)):
        for _, register, index in registers.words(table, sensor):
            for s in range(subgroups):
                yield registers.address(register.name, s, index), register


def read(address: int, hold: int = 0) -> Access:
    return address, 0, 0, 0, hold


def write(address: int, value: int, strobe: int = WHOLE, skew: int = 0, hold: int = 0) -> Access:
    return address, value & FULL, strobe, skew, hold


TOTALS = [read(registers.address(name)) for name in ("budget", "limit")]
REFUSED = [write(*START), read(STATUS), write(STATUS, FULL)]  # a start that settings forbid: the status tells why


def kept(emission: Emission) -> dict[str, list[int]]:
    """Return the words of every register, by its name in the flat design."""
    flops = {flop.output for flop in emission.top.flops}
    places = emission.layout.nets
    return {name: [places[net] for net in nets] for name, nets in emission.top.names.items() if flops.issuperset(nets)}


def watched(emission: Emission) -> list[int]:
    """Return the words of voted registers' copies, which the bench of faults compares in every cycle."""
    return [word for name, of in kept(emission).items() if name.endswith(COPIES) for word in of]


def session(sensor: Sensor, emission: Emission, jobs: Sequence[FrameJob], whole: bool, seed: int) -> list[Part]:
    """Return what the host does, in order. The first parts are the jobs. whole: with faults and numbers, which take longest."""
    rng = random.Random(seed)
    short = [job for job in jobs if job.config.frame_cycles < SHORT]
    reads = [read(address) for address, _ in words(sensor)]
    parts = [
        *(part("frames", job, after=reads) for job in jobs),
        *_lights(jobs, rng),
        *_accesses(sensor, short, reads, rng),
        *_starts(sensor, short, reads, rng),
        *_resets(short, reads, rng),
    ]
    if not whole:
        return parts
    return [
        *parts,
        *_upsets(emission, short, reads, rng),
        *_scrambles(emission, short, rng),
        *_ahead(emission, jobs, rng),
        *_wide(emission, short, reads, rng),
        *_commands(emission, short, rng),
    ]


def part(name: str, job: FrameJob, dark: bool = False, **others: Any) -> Part:
    """Return a part that plays a job's frame. dark: without light; others: arguments of `Lanes.recipe`."""
    edges = Edges(*3 * [np.zeros(0, np.int64)]) if dark else job.edges
    return name, {
        "config": job.config,
        "edges": edges,
        "ready": job.config.tready(job.ready),
        "patient": False,
    } | others


def _lights(jobs: Sequence[FrameJob], rng: random.Random) -> Iterator[Part]:
    """The frames' settings in other light, with other back-pressure; some with long periods, some with large settings."""
    for k in range(LIGHTS):
        config = rng.choice(jobs).config
        if k % 8 == 0:
            config = config.with_frame(
                period=config.sensor.period_max, pulses=3, minigroup_records=True, mg_threshold=1
            )
        if k % 3 == 0:
            config = _far(config, rng).with_settings(gating=True)
        density = rng.choice((4.0, 12.0, 30.0, 80.0)) * min(1, 4 / config.pulses)
        kind = random_cases.READY_KINDS[k // 3 % len(random_cases.READY_KINDS)]
        ready = random_cases.ready_pattern(k, kind, config.pulses * config.period + 100)
        job = FrameJob(config, random_cases.trouble(config, k, density), jobs[0].expected, ready)
        yield part("light", job)


def _far(config: Config, rng: random.Random) -> Config:
    """Return a configuration with other settings of progressive gating, often large ones."""
    every, step, steps = (rng.getrandbits(16 - rng.randrange(16)) for _ in range(3))
    return config.with_frame(gate_every=rng.choice((1, 1, 2, every)), gate_step=step, gate_steps=max(steps, 1))


def _accesses(sensor: Sensor, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Accesses to every register, in a row, and reads beside writes."""
    accesses = sweep(sensor, rng)
    yield part("registers", short[0], dark=True, after=accesses)
    writes = [access for access in accesses if access[2]][:3000]
    beside = [read(rng.choice(reads)[0], rng.choice((0, 0, 0, 1, 2, 5))) for _ in writes]
    yield part("registers", short[0], dark=True, after=writes, beside=beside)
    yield part("registers", short[0], dark=True, after=refused(sensor, rng))


def refused(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return starts that are refused for one reason, so that the status shows whether there is another one, too."""
    accesses = [write(PERIOD, 1)]
    for k, bit in itertools.product(range(AUTO_BOUNDS - 1), range(DATA_BITS)):  # neighbouring bounds, nearly equal
        low = rng.getrandbits(DATA_BITS)
        pair = sorted((low, low ^ (1 << bit) ^ rng.getrandbits(bit)))
        for one, other in (pair, pair[::-1]):
            bounds = [0] * k + [one, other] + [FULL] * (AUTO_BOUNDS - 2 - k)
            accesses += [write(registers.address("auto_bounds", index=i), bound) for i, bound in enumerate(bounds)]
            accesses += REFUSED
    for address, register in words(sensor):  # a part of a word keeps value and parity
        if register.access is Use.SETTING and address != PERIOD:
            accesses += [access for value in (0, 1, 2) for access in (write(address, value, strobe=7), *REFUSED)]
    accesses += [write(registers.address("auto_bounds"), FULL)]
    for s, bit in itertools.product(range(sensor.subgroups), range(sensor.coarse_bits)):  # a gate near the period's end
        accesses += [write(registers.address("mode", s), 1 << MODE.bit("gating"))]
        low = rng.randrange(sensor.period_max)
        for one, other in ((low, low ^ 1 << bit), (low ^ 1 << bit, low), (low, low)):
            accesses += [write(PERIOD, max(one, 1)), write(registers.address("gate_start", s), other), *REFUSED]
    return [*accesses, RESET_ALL]


def sweep(sensor: Sensor, rng: random.Random) -> list[Access]:
    """Return writes of legal and illegal values to every register, each with reads, and accesses that make no sense."""
    every = list(words(sensor))
    accesses: list[Access] = []
    for address, register in every:
        if register.access is Use.SETTING:
            low, high = register.low(sensor), register.high(sensor)
            span = (1 << high.bit_length()) - 1
            values = [low, high, low - 1, high + 1, 0x55555555 & span, 0xAAAAAAAA & span]
            values += [high | 1 << bit for bit in range(DATA_BITS)]
            values += [rng.randint(low, high) for _ in range(SWEEP_VALUES)]
            values += [rng.getrandbits(DATA_BITS) for _ in range(2)]
            for value in values:
                skew, hold = rng.choice((0, 0, 1, -1, 3, -3)), rng.choice((0, 0, 1, 4))
                accesses += [write(address, value, skew=skew, hold=hold), read(address, rng.choice((0, 0, 1, 4)))]
            accesses += [read(rng.choice(every)[0]), read(STATUS), write(STATUS, FULL)]
            accesses += [write(address, low, strobe) for strobe in (1, 2, 4, 8, 7, 14)]
            accesses += [read(address), read(STATUS), write(STATUS, 1 << rng.randrange(12)), read(STATUS)]
        elif register.access not in WRITABLE:
            accesses += [write(address, rng.getrandbits(DATA_BITS)), read(address)]
    holes = {4 * k for k in range(1 << 11)} - {address for address, _ in every}
    strange = rng.sample(sorted(holes), 60) + [rng.randrange(1 << registers.ADDRESS_BITS) for _ in range(100)]
    strange += [address ^ 1 << bit for address, _ in every for bit in range(registers.ADDRESS_BITS)]
    for address in strange:
        if address & ~3 != START[0]:
            accesses += [read(address), write(address, rng.getrandbits(DATA_BITS)), read(STATUS)]
        if rng.random() < 0.3:
            accesses += [write(STATUS, rng.getrandbits(12)), read(STATUS)]
    return accesses


def _starts(sensor: Sensor, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Writes, starts and aborts during a frame, and starts that make no sense."""
    for _ in range(STARTS):
        job = rng.choice(short)
        during = [write(*START), read(STATUS)]
        for address, value in rng.choice(short).config.register_writes():
            if rng.random() < 0.1:
                during += [write(address, value), read(address)]
        during += [write(STATUS, 0xFFC), read(STATUS)]
        if rng.random() < 0.5:
            during += [write(*ABORT)]
        yield part("registers", job, during=during, after=reads)
        wrong = rng.choice(
            (
                [("period", 0, 0, sensor.guard)],
                [("auto_bounds", 0, rng.randrange(6), 300 + rng.randrange(1 << 20)) for _ in range(2)],
                [("mode", s, 0, 2) for s in range(sensor.subgroups)]
                + [("gate_start", rng.randrange(sensor.subgroups), 0, sensor.period_max - 1)],
            )
        )
        refused = [write(registers.address(name, s, index), value) for name, s, index, value in wrong]
        refused += [write(*START), read(STATUS), write(STATUS, FULL), read(STATUS), RESET_ALL]
        yield part("registers", job, dark=True, after=refused)
        yield part("registers", job, dark=True)


def _resets(short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Resets in some cycle of a frame, and frames after them."""
    for _ in range(RESETS):
        job = rng.choice(short)
        wait = [read(STATUS) for _ in range(rng.randrange(1, max(2, job.config.frame_cycles // 6)))]
        yield part("resets", job, during=[*wait, RESET_ALL], after=reads)
        yield part("resets", rng.choice(short))


def _upsets(emission: Emission, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Flip-flops that flip during a frame, which another start follows; then in the register front, between accesses."""
    units = _units(emission)
    control = [of for name, of in units.items() if name.startswith(CONTROL) or ".settings" in name]
    for k in range(UPSETS):
        job, among = rng.choice(short), control if k % 3 else list(units.values())
        last = job.config.frame_cycles + 2 * GAP
        upsets = [_flip(among, rng.randrange(last), rng) for _ in range(rng.choice((1, 2, 5, 12)))]
        again = [write(*START), read(STATUS), write(STATUS, FULL), read(STATUS), RESET_ALL]
        yield part("upsets", job, upsets=upsets, after=[*(reads if k % 10 == 0 else ()), *(again if k % 2 else ())])
    front = [units["registers"]]
    first = min(short, key=lambda job: job.config.frame_cycles)
    begin = first.config.frame_cycles + 4 * GAP
    addresses = [address for address, *_ in reads]
    for _ in range(UPSET_ACCESSES):
        accesses = [rng.choice((_any_write, _any_read, lambda *_: read(STATUS)))(addresses, rng) for _ in range(400)]
        upsets = [_flip(front, begin + 20 * k + rng.randrange(20), rng) for k in range(100)]
        yield part("upsets", first, dark=True, after=[*accesses, RESET_ALL], upsets=upsets)
    bits = [
        bit for name, unit in units.items() if name == "registers" or ".settings" in name for of in unit for bit in of
    ]
    for k in range(0, len(bits), UPSET_TOGETHER):  # each for a while, in which starts are tried
        some = bits[k : k + UPSET_TOGETHER]
        upsets = [(bit, begin + UPSET_CYCLES * (i + end), FLIPS) for i, bit in enumerate(some) for end in (1, 2)]
        tried = REFUSED * (UPSET_CYCLES * (len(some) + 2) // REFUSAL_CYCLES)
        yield part("upsets", first, dark=True, after=[write(PERIOD, 1), *tried, RESET_ALL], upsets=upsets)


def _commands(emission: Emission, short: Sequence[FrameJob], rng: random.Random) -> Iterator[Part]:
    """Starts during which the command on the configuration bus becomes another one, often one that does not exist."""
    code = kept(emission)["registers.command"][: Shape.cast(Operation).width]
    led = [job for job in short if job.config.controlled.any()]
    for k in range(COMMANDS):
        upsets = _flips(code, rng.randrange(2 * GAP), rng.randrange(1, 1 << len(code)))
        yield part("upsets", rng.choice(led), upsets=upsets, after=[RESET_ALL] if k % 16 == 0 else ())


def _any_read(addresses: list[int], rng: random.Random) -> Access:
    return read(rng.choice(addresses), rng.choice((0, 1, 4)))


def _any_write(addresses: list[int], rng: random.Random) -> Access:
    return write(rng.choice(addresses), rng.getrandbits(DATA_BITS) >> rng.randrange(DATA_BITS))


def _units(emission: Emission) -> dict[str, list[list[int]]]:
    """Return the words of every register once, by the unit that they are in."""
    units: dict[str, list[list[int]]] = {}
    once = {tuple(of): name for name, of in kept(emission).items()}
    for of, name in once.items():
        units.setdefault(name.rpartition(".")[0], []).append(list(of))
    return units


def _flip(units: list[list[list[int]]], cycle: int, rng: random.Random) -> Upset:
    """Return the upset of any flip-flop: of any register of any of the units."""
    return rng.choice(rng.choice(rng.choice(units))), cycle, FLIPS


def _flips(of: list[int], cycle: int, number: int) -> list[Upset]:
    """Return upsets of a register's bits that are 1 in a number."""
    return [(word, cycle, FLIPS) for bit, word in enumerate(of) if number >> bit & 1]


def _tie(some: list[list[int]], sources: list[list[int]], cycle: int, rng: random.Random) -> list[Upset]:
    """Return upsets that make one of some registers equal to one of others, except in some low bits."""
    one, other = rng.choice(some), rng.choice(sources)
    size = rng.randrange(min(len(one), len(other)) + 1)
    upsets = [(word, cycle, source) for word, source in zip(one, other, strict=True)]
    upsets += [(word, cycle, FLIPS) for word in one[: max(size - 1, 0)] if rng.random() < 0.5]
    return upsets + [(word, cycle, FLIPS) for word in one[max(size - 1, 0) : size]]


def _scrambles(emission: Emission, short: Sequence[FrameJob], rng: random.Random) -> Iterator[Part]:
    """Frames in which units come into any state: registers that are random, nearly equal to others, or close to a carry."""
    kinds: dict[str, list[list[list[int]]]] = {}  # a unit that repeats is one of them
    for name, unit in _units(emission).items():
        kinds.setdefault(re.sub(r"\d+", "", name), []).append(unit)
    of_kind = list(kinds.values())
    one = emission.layout.nets[ONE]
    for k in range(SCRAMBLES):
        job = rng.choice(short)
        upsets: list[Upset] = []
        for _ in range(rng.choice((1, 2, 4, 8))):
            cycle = rng.randrange(job.config.frame_cycles + 2 * GAP)
            unit = rng.choice(rng.choice(of_kind))
            for of in unit if rng.random() < 0.5 else rng.sample(unit, rng.randrange(1, len(unit) + 1)):
                match rng.randrange(4):
                    case 0:
                        upsets += _tie([of], rng.choice((unit, rng.choice(rng.choice(of_kind)))), cycle, rng)
                    case 1:
                        low = rng.randrange(len(of) + 1)
                        upsets += [(word, cycle, one) for word in of[:low]]
                        upsets += _flips(of[low:], cycle, rng.getrandbits(len(of)))
                    case _:
                        upsets += _flips(of, cycle, rng.getrandbits(len(of)))
        name, recipe = part("upsets", job, upsets=upsets, after=[RESET_ALL] if k % 2 else [*TOTALS, RESET_ALL])
        yield name, recipe | ({} if k % 3 else {"config": _far(job.config, rng).with_settings(gating=True)})


def _ahead(emission: Emission, jobs: Sequence[FrameJob], rng: random.Random) -> Iterator[Part]:
    """Frames with counters as after a long time: close to a carry, or to the setting that ends them."""
    every = kept(emission)
    counters = [of for name, of in every.items() if ".dpcu." in name and len(of) >= WIDE_BITS]
    lost = COUNTER_NAMES.index("mg_dropped")
    short = [job for job in jobs if job.config.frame_cycles < SHORT]
    led = [job for job in short if job.config.controlled.any()]
    losing = [job for job in jobs if job.config.frame_cycles < 2 * SHORT and job.expected.counters[:, lost].any()]
    for k in range(AHEAD):
        job = rng.choice((losing, led, short)[k % 3])
        config = job.config if k % 2 else _far(job.config, rng).with_settings(gating=True)
        begin = rng.randrange(10, 50)
        upsets: list[Upset] = []
        for name, setting in (("pulses", "gate_every"), ("steps", "gate_steps")):
            upsets += _flips(every[f"sequencer.{name}"], begin, max(config.frame[setting] - rng.randrange(1, 4), 0))
        for of in counters:
            cycle = rng.randrange(job.config.frame_cycles) if rng.random() < 0.5 else begin
            full = (1 << rng.choice((rng.randrange(len(of) + 1), len(of)))) - 1
            upsets += _flips(of, cycle, max((rng.getrandbits(len(of)) | full) - rng.randrange(3), 0))
        name, recipe = part("wide", job, upsets=upsets)
        yield name, recipe | {"config": config}


def _wide(emission: Emission, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Frames with large numbers in registers of many bits, some of them nearly equal to others, and large settings."""
    every = kept(emission)
    wide = {name: of for name, of in every.items() if len(of) >= WIDE_BITS and not name.endswith(COPIES)}
    counting = [of for name, of in wide.items() if ".dpcu." in name or name.startswith(("controller", "readout"))]
    controller = [of for name, of in wide.items() if "controller" in name]
    voted = [name.removesuffix(COPIES[0]) for name in every if name.endswith(COPIES[0])]
    copies = [list(zip(*(every[name + copy] for copy in COPIES[:3]), strict=True)) for name in voted]
    led = [job for job in short if job.config.controlled.any()]
    for k in range(WIDE):
        job = rng.choice(led if k % 4 else short)
        end = job.config.frame_cycles + 2 * GAP
        upsets = []
        for of in rng.sample(counting, rng.randrange(1, len(counting))):
            cycle = rng.randrange(20, end)
            upsets += _flips(of, cycle, rng.getrandbits(len(of)) if k % 3 else -1 << rng.randrange(4))  # or nearly full
        for _ in range(rng.randrange(TIES)):
            cycle = rng.choice((rng.randrange(GAP), rng.randrange(end), rng.randrange(end - GAP, end + 2 * GAP)))
            among = controller if k % 4 else counting
            upsets += _tie(among, among, cycle, rng)
        for bits in copies:  # another number in all copies, then another one in one of them
            for cycle in rng.sample(range(end), 4):
                upsets += [(word, cycle, FLIPS) for bit in bits if rng.random() < 0.5 for word in bit]
                upsets += [(rng.choice(rng.choice(bits)), cycle + 1 + j, FLIPS) for j in range(4)]
        name, recipe = part("wide", job, upsets=upsets, after=reads[-40:] if k % 4 == 0 else TOTALS)
        if k % 2:
            bounds = sorted(rng.getrandbits(rng.choice((8, 16, 22))) for _ in range(5))
            capacity = rng.getrandbits(rng.choice((20, 32)))
            recipe["config"] = job.config.with_frame(capacity=capacity, auto_bounds=[0, *bounds])
        yield name, recipe
    yield from _long(wide, short, reads, rng)


def _long(
    wide: dict[str, list[int]], short: Sequence[FrameJob], reads: list[Access], rng: random.Random
) -> Iterator[Part]:
    """Frames of which the sequencer has counted far, or is made to go on for long; a reset ends them."""
    plan = [of for name, of in wide.items() if name.startswith("registers.plan")]
    counters = [of for name, of in wide.items() if name.startswith("sequencer.")]
    for k in range(LONG):
        job = rng.choice(short)
        end = job.config.frame_cycles
        of = rng.choice(counters + plan)
        upsets = _flips(of, rng.randrange(20, 60), rng.getrandbits(len(of)))
        for _ in range(rng.randrange(TIES)):
            some = counters if k % 2 else counters + plan
            upsets += _tie(some, counters + plan, rng.randrange(20, end), rng)
        wait = [read(STATUS) for _ in range(end // 4)]
        name, recipe = part("wide", job, upsets=upsets, during=[*wait, RESET_ALL], after=reads)
        yield name, recipe | ({"config": _far(job.config, rng)} if k % 4 > 1 else {})
