# SPDX-License-Identifier: Apache-2.0
"""What one host does with all lanes to tell mutants from the RTL: frames, accesses, resets, upsets, wide numbers.

The golden model says what the frames are. Of everything else, the lane without mutation is the reference, so it only shows
whether such stimuli reach a mutant; the benches of the regression (`benches`) have the same kinds of stimuli, and
expectations of their own.
"""

import random
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np

from coincid.model.contract import registers
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import DATA_BITS, WRITABLE
from coincid.model.contract.registers import Access as Use
from coincid.slices.emit import Emission
from coincid.tb.frames import FrameJob

from .lanes import GAP, RESET, Access

WHOLE = 15  # strobe of a word
FULL = (1 << DATA_BITS) - 1
SHORT = 400  # cycles of a frame that is played often
SWEEP_VALUES, STARTS, RESETS, UPSETS, UPSET_ACCESSES, WIDE = 40, 20, 60, 900, 16, 800
WIDE_BITS = 9  # of a register whose values a short frame does not reach
COPIES = ("_plain", "_inverse", "_by_turns", "_turn")  # ends of the names of a voted register's parts
CONTROL = ("registers", "sequencer", "readout", "controller", "module_0.resets", "module_0.rests")
RESET_ALL: Access = (0, 0, RESET, 0, 0)
STATUS, START, ABORT = registers.address("status"), registers.control("start"), registers.control("abort")
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


def kept(emission: Emission) -> dict[str, list[int]]:
    """Return the words of every register, by its name in the flat design."""
    flops = {flop.output for flop in emission.top.flops}
    places = emission.layout.nets
    return {name: [places[net] for net in nets] for name, nets in emission.top.names.items() if flops.issuperset(nets)}


def watched(emission: Emission) -> list[int]:
    """Return the words of voted registers' copies, which the bench of faults compares in every cycle."""
    return [word for name, of in kept(emission).items() if name.endswith(COPIES) for word in of]


def session(sensor: Sensor, emission: Emission, jobs: Sequence[FrameJob]) -> list[Part]:
    """Return what the host does, in order. The first parts are the jobs."""
    rng = random.Random(1)
    short = [job for job in jobs if job.config.frame_cycles < SHORT]
    reads = [read(address) for address, _ in words(sensor)]
    return [
        *(part("frames", job, after=reads) for job in jobs),
        *_accesses(sensor, short, reads, rng),
        *_starts(sensor, short, reads, rng),
        *_resets(short, reads, rng),
        *_upsets(emission, short, reads, rng),
        *_wide(emission, short, reads, rng),
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


def _accesses(sensor: Sensor, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Accesses to every register, in a row, and reads beside writes."""
    accesses = sweep(sensor, rng)
    yield part("registers", short[0], dark=True, after=accesses)
    writes = [access for access in accesses if access[2]][:3000]
    beside = [read(rng.choice(reads)[0], rng.choice((0, 0, 0, 1, 2, 5))) for _ in writes]
    yield part("registers", short[0], dark=True, after=writes, beside=beside)


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
    strange += [address ^ 1 << bit for address, _ in rng.sample(every, 10) for bit in range(registers.ADDRESS_BITS)]
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
    """Flip-flops that flip, each in its frame, which another start follows; then in the register front, between accesses."""
    every = kept(emission)
    control = [of for name, of in every.items() if name.startswith(CONTROL) or ".settings" in name]
    for k in range(UPSETS):
        job = rng.choice(short)
        upset = rng.choice(rng.choice(control)), rng.randrange(job.config.frame_cycles)
        again = [write(*START), read(STATUS), write(STATUS, FULL), read(STATUS), RESET_ALL]
        yield part("upsets", job, upsets=[upset], after=[*(reads if k % 10 == 0 else ()), *(again if k % 2 else ())])
    front = [of for name, of in every.items() if name.startswith("registers.")]
    first = min(short, key=lambda job: job.config.frame_cycles)
    addresses = [address for address, *_ in reads if address != START[0]]
    for _ in range(UPSET_ACCESSES):
        begin = first.config.frame_cycles + 4 * GAP
        upsets = [(rng.choice(rng.choice(front)), begin + 20 * k + rng.randrange(20)) for k in range(100)]
        accesses = []
        for _ in range(400):
            value = rng.getrandbits(DATA_BITS) >> rng.randrange(DATA_BITS)
            accesses.append(
                rng.choice(
                    (
                        read(STATUS),
                        read(rng.choice(addresses), rng.choice((0, 1, 4))),
                        write(rng.choice(addresses), value),
                    )
                )
            )
        yield part("upsets", first, dark=True, after=[*accesses, RESET_ALL], upsets=upsets)


def _wide(emission: Emission, short: Sequence[FrameJob], reads: list[Access], rng: random.Random) -> Iterator[Part]:
    """Frames with large numbers in registers of many bits, and large settings."""
    every = {name: of for name, of in kept(emission).items() if len(of) >= WIDE_BITS and not name.endswith(COPIES)}
    counting = [of for name, of in every.items() if ".dpcu." in name or "controller" in name]
    timing = [of for name, of in every.items() if "sequencer" in name or "registers.plan" in name]
    led = [job for job in short if job.config.controlled.any()]
    for k in range(WIDE):
        job = rng.choice(led if k % 4 else short)
        upsets = []
        for of in rng.sample(counting, rng.randrange(1, len(counting))):
            cycle = rng.randrange(20, job.config.frame_cycles + 2 * GAP)
            if k % 3:
                upsets += [(word, cycle) for word in of if rng.random() < 0.5]
            else:  # nearly full
                upsets += [(word, cycle) for word in of[rng.randrange(4) :]]
        name, recipe = part("wide", job, upsets=upsets, after=reads[-40:] if k % 4 == 0 else ())
        if k % 2:
            bounds = sorted(rng.getrandbits(rng.choice((8, 16, 22))) for _ in range(5))
            capacity = rng.getrandbits(rng.choice((20, 32)))
            recipe["config"] = job.config.with_frame(capacity=capacity, auto_bounds=[0, *bounds])
        yield name, recipe
    for _ in range(40):
        job = rng.choice(short)
        upsets = [(word, rng.randrange(20, 60)) for word in rng.choice(timing) if rng.random() < 0.5]
        wait = [read(STATUS) for _ in range(job.config.frame_cycles // 4)]
        yield part("wide", job, upsets=upsets, during=[*wait, RESET_ALL], after=reads)
