/* SPDX-License-Identifier: Apache-2.0 */
/* Minimal C driver of the sensor, and decoder of its stream. Plain C99, no allocation; addresses and bits: coincid_regs.h. */
#ifndef COINCID_H
#define COINCID_H

#include <stddef.h>
#include <stdint.h>

#include "coincid_packets.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { COINCID_OK = 0, COINCID_REFUSED = -1, COINCID_NO_SENSOR = -2, COINCID_TIMEOUT = -3, COINCID_BAD_STREAM = -4 };

/* Access to the registers. Both functions return 0, or another value if the sensor refused the access. */
typedef struct {
    void *context;
    int (*read)(void *context, uint32_t address, uint32_t *value);
    int (*write)(void *context, uint32_t address, uint32_t value);
} coincid_bus;

/* The sensor as built, as coincid_probe reads it. */
typedef struct {
    uint32_t subgroups, pixels, minigroups; /* pixels and minigroups of a subgroup */
    uint32_t record_bits, record_stamp_bits; /* of a minigroup's entry */
    uint32_t subgroup_bits, pixel_bits, offset_bits; /* of the fields in groups of events */
    uint32_t minigroup_rows, minigroup_cols, subgroup_cols; /* in pixels */
    uint32_t minigroup_pixels;
    uint32_t grouped; /* what the frame has: set it to the `count` of the frame start; 0 events, 1 groups of events, 2 counts */
} coincid_sensor_info;

int coincid_probe(const coincid_bus *bus, coincid_sensor_info *info);
int coincid_start(const coincid_bus *bus);
int coincid_abort(const coincid_bus *bus);
/* Reset the sensor, whatever it is doing. Its settings have their reset values; a frame in progress ends without a last beat. */
int coincid_reset(const coincid_bus *bus);
/* Poll the status up to `polls` times until the frame has been delivered, then clear the `done` bit. */
int coincid_wait(const coincid_bus *bus, uint32_t polls);

/* A packet of the stream, of a kind of coincid_packets.h. map, offsets, entries, counters, pulses and rows point to beats of the stream,
   or are 0 if the kind has none. */
typedef struct {
    int kind;
    uint32_t overrun, subgroup, pulse, count, winner, stamp; /* pulse: in the frame; for frame start and end, the frame number */
    const uint64_t *map, *offsets, *entries, *counters;
    const uint64_t *pulses, *rows; /* of counts: read them with coincid_pulses and coincid_gate_hits */
    uint32_t gates, minigroup; /* of counts: read the first one with coincid_gate */
    const uint64_t *group; /* of a group of events: its beats */
    uint32_t group_beats, bit, number, stamp_bits, with_offsets; /* number: of groups before it in the frame, modulo 256 */
} coincid_packet;

/* A group of events that is being read. */
typedef struct {
    const uint64_t *beats;
    uint32_t n, bit, pulse, event_pulse, stamp_bits, with_offsets;
    uint64_t map[4], offsets[32]; /* of the event that was read last */
} coincid_group;

/* Decode beats of a stream that carries `subgroups` subgroups, one packet per call. Return the number of beats in the packet,
   0 if it is not complete yet, or COINCID_BAD_STREAM. */
int coincid_decode(const coincid_sensor_info *info, uint32_t subgroups, const uint64_t *beats, size_t n, coincid_packet *packet);

/* In frames with groups of events, set info->grouped. A whole group then is one packet of kind COINCID_GROUP; coincid_group_begin
   and coincid_group_event read its events. Beats of kind COINCID_DAMAGED hold nothing else: go on behind them. Groups are lost
   where their numbers do not follow each other. */
void coincid_group_begin(const coincid_packet *packet, coincid_group *group);
/* Read the group's next event into `packet`, whose map and offsets stay until the next one. Return 1, or 0 if there is none. */
int coincid_group_event(const coincid_sensor_info *info, coincid_group *group, coincid_packet *packet);

/* Whether pixel `pixel` is in a packet's map. Coarse offset of a minigroup, or 255 if it was not hit. */
int coincid_hit(const coincid_packet *packet, uint32_t pixel);
uint32_t coincid_offset(const coincid_packet *packet, uint32_t minigroup);
/* Stamp and map of a minigroup's entry in a record; the map is 0 if the minigroup has not latched. */
void coincid_entry(const coincid_sensor_info *info, const coincid_packet *packet, uint32_t minigroup, uint32_t *stamp, uint32_t *map);
/* Of the counts of a minigroup (kind COINCID_GATE_COUNTS). A gate is 0 or 1, `pixel` the pixel's number in the minigroup, `quarter` from
   0 to 15 the quarter of a cycle since the gate's beginning. First cycle of a gate, or COINCID_NO_GATE; number of pulses in which a
   pixel counted; its hits; its number in the subgroup. */
uint32_t coincid_gate(const coincid_packet *packet, uint32_t gate);
uint32_t coincid_pulses(const coincid_packet *packet, uint32_t pixel);
uint32_t coincid_gate_hits(const coincid_packet *packet, uint32_t gate, uint32_t pixel, uint32_t quarter);
uint32_t coincid_pixel(const coincid_sensor_info *info, const coincid_packet *packet, uint32_t pixel);
/* Counter `counter`, such as COINCID_COUNTER_STORED, of subgroup `index` of the stream, from a frame end. */
uint32_t coincid_counter(const coincid_packet *packet, uint32_t index, uint32_t counter);

#ifdef __cplusplus
}
#endif
#endif
