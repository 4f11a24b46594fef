/* SPDX-License-Identifier: Apache-2.0 */
#include "coincid.h"

#include <string.h>

#include "coincid_regs.h"

#define KIND_LSB (64u - COINCID_KIND_BITS)
#define COUNTER_BEATS beats_for(COINCID_COUNTERS * 32u)

static uint32_t beats_for(uint32_t bits) { return (bits + 63u) / 64u; }

/* Return `width` bits (at most 32) of a packet of n beats, from bit `*bit` on, and move `*bit` behind them. Bits of the kind do not count;
   what lies behind the n beats is 0. */
static uint32_t number(const uint64_t *beats, size_t n, uint32_t *bit, unsigned width) {
    uint64_t value = 0;
    unsigned k;
    for (k = 0; k < width;) {
        const uint32_t at = *bit < KIND_LSB ? *bit : *bit + COINCID_KIND_BITS;
        const uint32_t room = at < KIND_LSB ? KIND_LSB - at : 64u - at % 64u;
        const unsigned taken = room < width - k ? room : width - k;
        if (at / 64u < n) value |= (beats[at / 64u] >> at % 64u & (((uint64_t)1 << taken) - 1u)) << k;
        *bit += taken;
        k += taken;
    }
    return (uint32_t)value;
}

static uint32_t bits_for(uint32_t highest) {
    uint32_t bits = 1;
    while (highest >>= 1) bits++;
    return bits;
}

/* Return a read-only register, or 0 with *failed set. */
static uint32_t constant(const coincid_bus *bus, uint32_t address, int *failed) {
    uint32_t value = 0;
    if (bus->read(bus->context, address, &value)) *failed = 1;
    return value;
}

int coincid_probe(const coincid_bus *bus, coincid_sensor_info *info) {
    int failed = 0;
    uint32_t rows, cols, minigroup, phases, window, steps;
    if (constant(bus, COINCID_ID, &failed) != COINCID_ID_VALUE || failed) return COINCID_NO_SENSOR;
    if (constant(bus, COINCID_VERSION, &failed) >> 16 != COINCID_VERSION_VALUE >> 16) return COINCID_NO_SENSOR;
    rows = constant(bus, COINCID_ROWS, &failed);
    cols = constant(bus, COINCID_COLS, &failed);
    info->pixels = constant(bus, COINCID_SUBGROUP_ROWS, &failed) * constant(bus, COINCID_SUBGROUP_COLS, &failed);
    minigroup = constant(bus, COINCID_MINIGROUP_ROWS, &failed) * constant(bus, COINCID_MINIGROUP_COLS, &failed);
    info->record_stamp_bits = constant(bus, COINCID_COARSE_BITS, &failed) + 2u;
    if (failed || !info->pixels || !minigroup) return COINCID_NO_SENSOR;
    info->minigroup_pixels = minigroup;
    info->subgroups = rows * cols / info->pixels;
    info->minigroups = info->pixels / minigroup;
    info->record_bits = info->record_stamp_bits + minigroup <= 16u ? 16u : 32u;
    info->minigroup_rows = constant(bus, COINCID_MINIGROUP_ROWS, &failed);
    info->minigroup_cols = constant(bus, COINCID_MINIGROUP_COLS, &failed);
    info->subgroup_cols = constant(bus, COINCID_SUBGROUP_COLS, &failed);
    phases = constant(bus, COINCID_PHASES, &failed);
    window = constant(bus, COINCID_WINDOW_MAX, &failed);
    steps = constant(bus, COINCID_OFFSET_PHASES, &failed);
    if (failed || !steps) return COINCID_NO_SENSOR;
    info->subgroup_bits = bits_for(info->subgroups - 1u);
    info->pixel_bits = bits_for(info->pixels - 1u);
    info->offset_bits = bits_for((phases + window - 2u) * steps / phases);
    info->grouped = 0;
    return COINCID_OK;
}

int coincid_start(const coincid_bus *bus) {
    return bus->write(bus->context, COINCID_CONTROL, COINCID_CONTROL_START) ? COINCID_REFUSED : COINCID_OK;
}

int coincid_abort(const coincid_bus *bus) {
    return bus->write(bus->context, COINCID_CONTROL, COINCID_CONTROL_ABORT) ? COINCID_REFUSED : COINCID_OK;
}

int coincid_reset(const coincid_bus *bus) {
    return bus->write(bus->context, COINCID_CONTROL, COINCID_CONTROL_RESET) ? COINCID_REFUSED : COINCID_OK;
}

int coincid_wait(const coincid_bus *bus, uint32_t polls) {
    uint32_t status;
    while (polls--) {
        if (bus->read(bus->context, COINCID_STATUS, &status)) return COINCID_REFUSED;
        if (status & COINCID_STATUS_DONE)
            return bus->write(bus->context, COINCID_STATUS, COINCID_STATUS_DONE) ? COINCID_REFUSED : COINCID_OK;
    }
    return COINCID_TIMEOUT;
}

static coincid_packet no_packet(void) {
    coincid_packet packet;
    memset(&packet, 0, sizeof packet);
    return packet;
}

static int begins_group(uint64_t beat) { return beat >> KIND_LSB == COINCID_GROUP && (beat >> COINCID_FIRST_LSB & 1u); }

/* Return whether a beat cannot begin a packet in a frame with groups. */
static int is_damaged(uint64_t beat) {
    switch (beat >> KIND_LSB) {
    case COINCID_GROUP: return !begins_group(beat);
    case COINCID_RECORD: return (beat & COINCID_RECORD_UNUSED) != 0;
    case COINCID_FRAME_START: return (beat & COINCID_FRAME_START_UNUSED) != 0;
    case COINCID_FRAME_END: return (beat & COINCID_FRAME_END_UNUSED) != 0;
    default: return 1;
    }
}

/* Return the CRC-32 of a group, whose check counts as 0. */
static uint32_t check_of(const uint64_t *beats, uint32_t n) {
    uint32_t check = 0xffffffffu, k, bit;
    for (k = 0; k < n; k++) {
        const uint64_t mask = k == n - 1u ? (uint64_t)0xffffffffu << COINCID_CHECK_LSB : 0;
        const uint64_t beat = beats[k] & ~mask;
        for (bit = 0; bit < 64u; bit++) {
            const uint32_t odd = (check ^ (uint32_t)(beat >> bit)) & 1u;
            check = check >> 1 ^ (odd ? COINCID_CHECK_POLYNOMIAL : 0u);
        }
    }
    return ~check;
}

/* Return `width` bits (at most 32) of the payloads of n beats, from bit `*bit` on, and move `*bit` behind them; what lies behind the beats
   is 0. */
static uint32_t next(const uint64_t *beats, uint32_t n, uint32_t *bit, uint32_t width) {
    uint64_t value = 0;
    uint32_t k, taken;
    for (k = 0; k < width; k += taken, *bit += taken) {
        const uint32_t beat = *bit / COINCID_PAYLOAD_BITS, lsb = *bit % COINCID_PAYLOAD_BITS, room = COINCID_PAYLOAD_BITS - lsb;
        taken = room < width - k ? room : width - k;
        if (beat < n) value |= (beats[beat] >> lsb & (((uint64_t)1 << taken) - 1u)) << k;
    }
    return (uint32_t)value;
}

/* Decode a group, or the damaged beats up to where a packet can begin; result as of coincid_decode. */
static int decode_group(const uint64_t *beats, size_t n, coincid_packet *packet) {
    coincid_packet found = no_packet();
    uint32_t k = 1, bit = 0;
    found.kind = COINCID_DAMAGED;
    if (begins_group(beats[0])) {
        while (!(beats[k - 1u] >> COINCID_LAST_LSB & 1u)) {
            if (k == n) return 0;
            if (beats[k] >> KIND_LSB != COINCID_GROUP || begins_group(beats[k])) break;
            k++;
        }
        if ((beats[k - 1u] >> COINCID_LAST_LSB & 1u) && check_of(beats, k) == (uint32_t)(beats[k - 1u] >> COINCID_CHECK_LSB)) {
            found.kind = COINCID_GROUP;
            found.group = beats;
            found.group_beats = k;
            found.pulse = next(beats, k, &bit, COINCID_PULSE_IN_HEAD);
            found.number = next(beats, k, &bit, COINCID_NUMBER_IN_HEAD);
            found.stamp_bits = next(beats, k, &bit, COINCID_STAMP_BITS_IN_HEAD);
            found.with_offsets = next(beats, k, &bit, COINCID_WITH_OFFSETS_IN_HEAD);
            found.bit = bit;
        }
    } else {
        while (k < n && is_damaged(beats[k])) k++;
    }
    *packet = found;
    return (int)k;
}

/* Return whether a frame has packets of a kind. */
static int is_expected(const coincid_sensor_info *info, int kind) {
    if (kind == COINCID_FRAME_START || kind == COINCID_FRAME_END) return 1;
    return (info->grouped == COINCID_WITH_COUNTS) == (kind == COINCID_GATE_COUNTS);
}

int coincid_decode(const coincid_sensor_info *info, uint32_t subgroups, const uint64_t *beats, size_t n, coincid_packet *packet) {
    coincid_packet found = no_packet();
    uint32_t length = 0, bit = 0, times = 1;
    if (!n) return 0;
    if (info->grouped == COINCID_WITH_GROUPS && (begins_group(beats[0]) || is_damaged(beats[0]))) return decode_group(beats, n, packet);
    found.kind = (int)(beats[0] >> KIND_LSB);
    if (!is_expected(info, found.kind)) return COINCID_BAD_STREAM;
    switch (found.kind) {
#define NUMBER(name, width) found.name = number(beats, n, &bit, width);
#define ITEMS(name, width, items)                                                  \
    found.name = beats + beats_for(bit + COINCID_KIND_BITS);                        \
    bit = 64u * beats_for(bit + COINCID_KIND_BITS) - COINCID_KIND_BITS + (width) * (items);
#define PACKET(kind, count, fields) \
    case kind:                      \
        fields times = count;       \
        break;
        COINCID_PACKETS(PACKET, NUMBER, ITEMS)
    default:
        return COINCID_BAD_STREAM;
    }
    length = 1u + (beats_for(bit + COINCID_KIND_BITS) - 1u) * times;
    if (length > n) return 0;
    *packet = found;
    return (int)length;
}

void coincid_group_begin(const coincid_packet *packet, coincid_group *group) {
    group->beats = packet->group;
    group->n = packet->group_beats;
    group->bit = packet->bit;
    group->pulse = group->event_pulse = packet->pulse;
    group->stamp_bits = packet->stamp_bits;
    group->with_offsets = packet->with_offsets;
}

/* Read the offsets of the minigroups that are hit: the lowest, the highest, and so on to the middle. */
static void group_offsets(const coincid_sensor_info *info, coincid_group *group) {
    const uint32_t across = info->subgroup_cols / info->minigroup_cols;
    uint32_t low = 0, high = info->minigroups, from_high = 0, minigroup, pixel;
    unsigned char hit[256] = {0};
    for (minigroup = 0; minigroup < 32u; minigroup++) group->offsets[minigroup] = ~(uint64_t)0;
    for (pixel = 0; pixel < info->pixels; pixel++)
        if (group->map[pixel / 64u] >> pixel % 64u & 1u)
            hit[pixel / info->subgroup_cols / info->minigroup_rows * across + pixel % info->subgroup_cols / info->minigroup_cols] = 1;
    for (;; from_high = !from_high) {
        uint32_t offset;
        while (low < high && !hit[low]) low++;
        while (low < high && !hit[high - 1u]) high--;
        if (low == high) return;
        minigroup = from_high ? --high : low++;
        offset = next(group->beats, group->n, &group->bit, info->offset_bits);
        group->offsets[minigroup / 8u] ^= (uint64_t)(offset ^ 0xffu) << minigroup % 8u * 8u;
    }
}

int coincid_group_event(const coincid_sensor_info *info, coincid_group *group, coincid_packet *packet) {
    const uint64_t *beats = group->beats;
    const uint32_t n = group->n, end = n * COINCID_PAYLOAD_BITS - (COINCID_PAYLOAD_BITS - COINCID_CHECK_LSB);
    uint32_t listed, pixel, k;
    coincid_packet found = no_packet();
    if (group->bit + COINCID_LISTED_BITS > end) return 0;
    listed = next(beats, n, &group->bit, COINCID_LISTED_BITS);
    if (!listed) return group->bit = end, 0;
    found.kind = COINCID_GROUP;
    found.overrun = next(beats, n, &group->bit, 1u);
    found.subgroup = next(beats, n, &group->bit, info->subgroup_bits);
    if (!next(beats, n, &group->bit, 1u)) group->event_pulse = group->pulse - next(beats, n, &group->bit, COINCID_AGE_BITS);
    found.pulse = group->event_pulse;
    found.stamp = next(beats, n, &group->bit, group->stamp_bits);
    found.winner = next(beats, n, &group->bit, info->pixel_bits);
    for (k = 0; k < 4u; k++) group->map[k] = 0;
    if (listed == COINCID_MAPPED) {
        for (pixel = 0; pixel < info->pixels; pixel++)
            group->map[pixel / 64u] |= (uint64_t)next(beats, n, &group->bit, 1u) << pixel % 64u;
    } else {
        group->map[found.winner / 64u] |= (uint64_t)1 << found.winner % 64u;
        while (--listed) {
            pixel = next(beats, n, &group->bit, info->pixel_bits);
            group->map[pixel / 64u] |= (uint64_t)1 << pixel % 64u;
        }
    }
    for (pixel = 0; pixel < info->pixels; pixel++) found.count += (uint32_t)(group->map[pixel / 64u] >> pixel % 64u & 1u);
    found.map = group->map;
    if (group->with_offsets) {
        group_offsets(info, group);
        found.offsets = group->offsets;
    }
    *packet = found;
    return 1;
}

int coincid_hit(const coincid_packet *packet, uint32_t pixel) { return (int)(packet->map[pixel / 64u] >> pixel % 64u & 1u); }

uint32_t coincid_offset(const coincid_packet *packet, uint32_t minigroup) {
    return (uint32_t)(packet->offsets[minigroup / 8u] >> minigroup % 8u * 8u & 0xffu);
}

void coincid_entry(const coincid_sensor_info *info, const coincid_packet *packet, uint32_t minigroup, uint32_t *stamp, uint32_t *map) {
    const uint32_t per_beat = 64u / info->record_bits;
    const uint64_t entry = packet->entries[minigroup / per_beat] >> minigroup % per_beat * info->record_bits;
    *stamp = (uint32_t)(entry & ((1u << info->record_stamp_bits) - 1u));
    *map = (uint32_t)(entry & (info->record_bits == 32u ? 0xffffffffu : 0xffffu)) >> info->record_stamp_bits;
}

uint32_t coincid_gate(const coincid_packet *packet, uint32_t gate) {
    return packet->gates >> gate * COINCID_GATE_BITS & ((1u << COINCID_GATE_BITS) - 1u);
}

uint32_t coincid_pulses(const coincid_packet *packet, uint32_t pixel) {
    const uint32_t bit = pixel * COINCID_COUNT_PULSE_BITS;
    return (uint32_t)(packet->pulses[bit / 64u] >> bit % 64u & ((1u << COINCID_COUNT_PULSE_BITS) - 1u));
}

uint32_t coincid_gate_hits(const coincid_packet *packet, uint32_t gate, uint32_t pixel, uint32_t quarter) {
    const uint32_t cycle = coincid_gate(packet, gate) + quarter / COINCID_QUARTERS;
    const uint64_t row = packet->rows[gate * COINCID_GATE_CYCLES + cycle % COINCID_GATE_CYCLES];
    const uint32_t bit = quarter % COINCID_QUARTERS * (64u / COINCID_QUARTERS) + pixel * COINCID_COUNT_BITS;
    return (uint32_t)(row >> bit & ((1u << COINCID_COUNT_BITS) - 1u));
}

uint32_t coincid_pixel(const coincid_sensor_info *info, const coincid_packet *packet, uint32_t pixel) {
    const uint32_t across = info->subgroup_cols / info->minigroup_cols;
    const uint32_t row = packet->minigroup / across * info->minigroup_rows + pixel / info->minigroup_cols;
    const uint32_t col = packet->minigroup % across * info->minigroup_cols + pixel % info->minigroup_cols;
    return row * info->subgroup_cols + col;
}

uint32_t coincid_counter(const coincid_packet *packet, uint32_t index, uint32_t counter) {
    return (uint32_t)(packet->counters[index * COUNTER_BEATS + counter / 2u] >> counter % 2u * 32u);
}
