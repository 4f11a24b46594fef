/* SPDX-License-Identifier: Apache-2.0 */
#include "coincid.h"

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

/* Return a read-only register, or 0 with *failed set. */
static uint32_t constant(const coincid_bus *bus, uint32_t address, int *failed) {
    uint32_t value = 0;
    if (bus->read(bus->context, address, &value)) *failed = 1;
    return value;
}

int coincid_probe(const coincid_bus *bus, coincid_sensor_info *info) {
    int failed = 0;
    uint32_t rows, cols, minigroup;
    if (constant(bus, COINCID_ID, &failed) != COINCID_ID_VALUE || failed) return COINCID_NO_SENSOR;
    if (constant(bus, COINCID_VERSION, &failed) >> 16 != COINCID_VERSION_VALUE >> 16) return COINCID_NO_SENSOR;
    rows = constant(bus, COINCID_ROWS, &failed);
    cols = constant(bus, COINCID_COLS, &failed);
    info->pixels = constant(bus, COINCID_SUBGROUP_ROWS, &failed) * constant(bus, COINCID_SUBGROUP_COLS, &failed);
    minigroup = constant(bus, COINCID_MINIGROUP_ROWS, &failed) * constant(bus, COINCID_MINIGROUP_COLS, &failed);
    info->record_stamp_bits = constant(bus, COINCID_COARSE_BITS, &failed) + 2u;
    if (failed || !info->pixels || !minigroup) return COINCID_NO_SENSOR;
    info->subgroups = rows * cols / info->pixels;
    info->minigroups = info->pixels / minigroup;
    info->record_bits = info->record_stamp_bits + minigroup <= 16u ? 16u : 32u;
    return COINCID_OK;
}

int coincid_start(const coincid_bus *bus) {
    return bus->write(bus->context, COINCID_CONTROL, COINCID_CONTROL_START) ? COINCID_REFUSED : COINCID_OK;
}

int coincid_abort(const coincid_bus *bus) {
    return bus->write(bus->context, COINCID_CONTROL, COINCID_CONTROL_ABORT) ? COINCID_REFUSED : COINCID_OK;
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

int coincid_decode(const coincid_sensor_info *info, uint32_t subgroups, const uint64_t *beats, size_t n, coincid_packet *packet) {
    coincid_packet found = {0};
    uint32_t length = 0, bit = 0, times = 1;
    if (!n) return 0;
    found.kind = (int)(beats[0] >> KIND_LSB);
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

uint32_t coincid_counter(const coincid_packet *packet, uint32_t index, uint32_t counter) {
    return (uint32_t)(packet->counters[index * COUNTER_BEATS + counter / 2u] >> counter % 2u * 32u);
}
