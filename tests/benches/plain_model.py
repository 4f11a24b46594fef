# SPDX-License-Identifier: Apache-2.0
"""The subgroup of docs/contract.md in plain Python, sentence by sentence and tick by tick, to check
the golden model.

It does not include FIFOs and readout: it lists all windows that met their threshold, all minigroup
records, and each edge's fate.
"""

from collections import defaultdict

from coincid.model.contract.config import Config
from coincid.model.contract.edges import Fate


def where(config: Config, pixel: int) -> tuple[int, int, int, int]:
    """Return (subgroup, pixel in it, minigroup, pixel in the minigroup)."""
    s = config.sensor
    (sr, sc), (mr, mc) = s.subgroup, s.minigroup
    row, col = divmod(pixel, s.cols)
    r, c = row % sr, col % sc
    subgroup, minigroup = (row // sr) * (s.cols // sc) + col // sc, (r // mr) * (sc // mc) + c // mc
    return subgroup, r * sc + c, minigroup, (r % mr) * mc + c % mc


class PlainSubgroup:
    """One subgroup over one frame."""

    def __init__(self, config: Config, index: int, threshold: int):
        self.config, self.index = config, index
        on = bool(config.coincidence[index])
        self.window = int(config.window[index]) if on else 1
        self.threshold = threshold if on else 1
        self.events, self.records = [], []
        self.opened = self.committed = self.rejected = self.photons = self.blind = self.lower = 0

    def gate_open(self, pulse: int, cycle: int) -> bool:
        c = self.config
        if not c.gating[self.index]:
            return True
        start = int(c.gate_start[self.index])
        if c.frame.gate_every:
            start += c.frame.gate_step * ((pulse // c.frame.gate_every) % c.frame.gate_steps)
        return start <= cycle < start + int(c.gate_len[self.index])

    def period(self, pulse: int, edges: list[tuple[int, int, int, int, int]], fate: list) -> None:
        """edges: (tick, pixel inside, minigroup, pixel in minigroup, number in the file)."""
        config = self.config
        phases = config.sensor.phases
        at_tick = defaultdict(list)
        for edge in sorted(edges):
            at_tick[edge[0]].append(edge)
        self.open_window = None
        self.armed_from = 0  # cycle
        seen_in_cycle, blind_cycles = set(), set()
        accepted = defaultdict(list)
        for tick in range(config.period * phases):
            cycle = tick // phases
            if tick % phases == 0:
                seen_in_cycle = set()
            for _, i, g, j, number in at_tick.get(tick, ()):
                fate[number] = self.refused(pulse, cycle, i, seen_in_cycle)
                seen_in_cycle.add(i)
                if fate[number] is None:
                    accepted[g, cycle].append((tick, j))
                    fate[number] = self.take(tick, i, g)
                if fate[number] == Fate.BLIND:
                    blind_cycles.add(cycle)
            if self.open_window and tick == self.open_window["t0"] + self.window - 1:
                self.close(pulse, cycle)
        assert self.open_window is None, "a period is self-contained"
        self.blind += len(blind_cycles)
        if config.frame.minigroup_records and config.format != "counts":
            record = self.record(accepted)
            if record:
                self.records.append((pulse, record))

    def refused(self, pulse: int, cycle: int, i: int, seen_in_cycle: set[int]) -> Fate | None:
        """Return the fate of an edge that does not come to the tree."""
        if i in seen_in_cycle:
            return Fate.DUPLICATE
        if not self.config.mask[self.index, i]:
            return Fate.MASKED
        if not self.gate_open(pulse, cycle):
            return Fate.GATED
        return None

    def take(self, tick: int, i: int, g: int) -> Fate:
        """Let an edge come to the tree."""
        phases = self.config.sensor.phases
        cycle = tick // phases
        window = self.open_window
        if self.config.format == "counts":
            return Fate.BLIND
        if window and i in window["hits"]:
            return Fate.DUPLICATE
        if window:
            fate = Fate.COUNTED
        elif self.armed_from <= cycle < self.config.period - self.config.sensor.guard:
            fate = Fate.OPENING
            window = self.open_window = {"t0": tick, "winner": i, "hits": set(), "offsets": {}}
            self.opened += 1
        else:
            return Fate.BLIND
        window["hits"].add(i)
        since_cycle = tick - phases * (window["t0"] // phases)
        window["offsets"].setdefault(g, since_cycle // (phases // self.config.sensor.offset_phases))
        return fate

    def close(self, pulse: int, cycle: int) -> None:
        """Compare the window's count with the threshold."""
        window = self.open_window
        count = len(window["hits"])
        self.photons += count
        if count >= self.threshold - 1:
            self.lower += 1
        if count >= self.threshold:
            self.committed += 1
            hits, offsets = frozenset(window["hits"]), window["offsets"]
            self.events.append((pulse, window["t0"], count, window["winner"], hits, offsets, cycle))
        else:
            self.rejected += 1
        self.open_window = None
        self.armed_from = cycle + 1 + self.config.sensor.rearm

    def record(self, accepted) -> dict:
        config, sensor = self.config, self.config.sensor
        latched = {}
        for g in range(sensor.minigroups):
            cycle = 0
            while cycle < config.period and g not in latched:
                if cycle < config.period - sensor.guard and accepted.get((g, cycle)):
                    collected = [
                        edge
                        for k in range(config.frame.mg_window)
                        for edge in accepted.get((g, cycle + k), ())
                    ]
                    pixels = {j for _, j in collected}
                    if len(pixels) >= config.frame.mg_threshold:
                        latched[g] = (
                            min(collected)[0] // (sensor.phases // 4),
                            sum(1 << j for j in pixels),
                        )
                    cycle += config.frame.mg_window
                else:
                    cycle += 1
        return latched


def period_starts(config: Config) -> list[int]:
    """Return the cycle in which each period of a frame begins."""
    starts, register, at = [], config.frame.dither_seed, 0
    for pulse in range(config.pulses):
        starts.append(at)
        for _ in range(config.period):
            bit, register = register & 1, register >> 1
            register ^= 0b1011_0100_0000_0000 * bit
        at += config.period + _gap_after(config, pulse) + register % 2**config.frame.dither_bits
    return starts


def _gap_after(config: Config, pulse: int) -> int:
    """Return the cycles between two periods, without dither's wait."""
    gap = config.frame.gap
    minigroups = config.sensor.minigroups
    if config.format == "counts" and pulse + 1 == config.search_pulses:
        return max(gap, 832 * minigroups + 32)
    if config.format == "counts" and pulse + 1 == 2 * config.search_pulses:
        return max(gap, 520 * minigroups + 32)
    return gap


class PlainController:
    """The thresholds of all subgroups and the budgets of all streams, frame after frame."""

    def __init__(self, config: Config):
        self.config = config
        n = config.sensor.subgroups
        self.auto = [bool(config.auto[s] and config.coincidence[s]) for s in range(n)]
        self.threshold = [int(config.threshold[s]) for s in range(n)]
        self.members = {}
        for s in range(n):
            self.members.setdefault(s * config.sensor.streams // n, []).append(s)
        self.share = {
            stream: config.capacity // len(members) for stream, members in self.members.items()
        }
        self.budget = dict(self.share)
        self.limit = dict(self.share)

    def frame_ended(self, subgroups: list[PlainSubgroup]) -> None:
        for stream, members in self.members.items():
            self.new_budget(stream, [(s, subgroups[s]) for s in members])
            for s in members:
                if self.auto[s]:
                    self.threshold[s] = self.new_threshold(
                        s, subgroups[s], self.budget[stream], self.limit[stream]
                    )

    def new_budget(self, stream: int, members) -> None:
        budget, capacity, share = self.budget[stream], self.config.capacity, self.share[stream]
        total, most = 0, 0
        for s, frame in members:
            total += frame.committed
            if self.auto[s]:
                most = max(most, frame.committed)
        top = min(most, self.limit[stream])
        self.budget[stream] = share
        if total > capacity * 2:
            self.limit[stream] = share
        elif total > capacity:
            self.limit[stream] = max(share, top - top // 4)
        else:
            for step in (budget, *(budget + budget // part + 1 for part in (8, 4, 2, 1))):
                step = max(share, min(capacity, step))
                if self.would_send(step, members) <= capacity:
                    self.budget[stream] = step
            self.limit[stream] = max(self.budget[stream], top)

    def would_send(self, budget: int, members) -> int:
        sent = 0
        for s, frame in members:
            if self.auto[s] and self.threshold[s] > 1 and frame.lower <= budget:
                sent += frame.lower
            else:
                sent += frame.committed
        return sent

    def new_threshold(self, s: int, frame: PlainSubgroup, budget: int, limit: int) -> int:
        threshold = self.threshold[s]
        if frame.committed > limit:
            if threshold < 7:
                threshold += 1
        elif threshold > 1 and frame.lower <= budget:
            threshold -= 1
        ceiling = 1
        for bound in self.config.auto_bounds.tolist():
            if frame.opened >= bound:
                ceiling += 1
        return max(self.config.frame.threshold_floor, 1, min(threshold, ceiling))


def plain_run(
    config: Config, edges, pulses: int | None = None
) -> tuple[list[list[PlainSubgroup]], list[int]]:
    """Return every frame's subgroups, and the fates.

    pulses: that each frame plays, and that the edges' pulses count; None: those of the
    configuration.
    """
    pulses = config.pulses if pulses is None else pulses
    fate = [None] * len(edges)
    grouped = defaultdict(list)
    for number, (pulse, pixel, tick) in enumerate(
        zip(edges.pulse.tolist(), edges.pixel.tolist(), edges.tick.tolist(), strict=True)
    ):
        subgroup, i, g, j = where(config, pixel)
        grouped[pulse, subgroup].append((tick, i, g, j, number))
    frames, controller = [], PlainController(config)
    for frame in range(config.frames):
        subgroups = []
        for index in range(config.sensor.subgroups):
            threshold = controller.threshold[index]
            subgroup = PlainSubgroup(config, index, threshold)
            subgroup.threshold_used = threshold
            for pulse in range(pulses):
                subgroup.period(pulse, grouped.get((frame * pulses + pulse, index), []), fate)
            subgroups.append(subgroup)
        frames.append(subgroups)
        controller.frame_ended(subgroups)
    return frames, fate
