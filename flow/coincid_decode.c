/* SPDX-License-Identifier: Apache-2.0 */
/* An example of the driver: decodes a captured frame (captured/NAME.txt), and prints its events or counts as in captured/NAME.csv.
   Here the registers are those of coincid_regs.h; on a chip, `read` and `write` access the bus. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "coincid.h"
#include "coincid_regs.h"

/* The registers that coincid_probe reads. */
static const uint32_t constants[][2] = {
    {COINCID_ID, COINCID_ID_VALUE},
    {COINCID_VERSION, COINCID_VERSION_VALUE},
    {COINCID_ROWS, COINCID_ROWS_VALUE},
    {COINCID_COLS, COINCID_COLS_VALUE},
    {COINCID_PHASES, COINCID_PHASES_VALUE},
    {COINCID_COARSE_BITS, COINCID_COARSE_BITS_VALUE},
    {COINCID_WINDOW_MAX, COINCID_WINDOW_MAX_VALUE},
    {COINCID_SUBGROUP_ROWS, COINCID_SUBGROUP_ROWS_VALUE},
    {COINCID_SUBGROUP_COLS, COINCID_SUBGROUP_COLS_VALUE},
    {COINCID_MINIGROUP_ROWS, COINCID_MINIGROUP_ROWS_VALUE},
    {COINCID_MINIGROUP_COLS, COINCID_MINIGROUP_COLS_VALUE},
    {COINCID_OFFSET_PHASES, COINCID_OFFSET_PHASES_VALUE},
};

static int read_register(void *context, uint32_t address, uint32_t *value) {
    size_t k;
    (void)context;
    for (k = 0; k < sizeof constants / sizeof constants[0]; k++) {
        if (constants[k][0] == address) {
            *value = constants[k][1];
            return 0;
        }
    }
    return 1;
}

static int write_register(void *context, uint32_t address, uint32_t value) {
    (void)context;
    (void)address;
    (void)value;
    return 1;
}

static void print_event(const coincid_sensor_info *info, const coincid_packet *packet) {
    uint32_t beat;
    uint32_t minigroup;
    printf("%" PRIu32 ",%" PRIu32 ",%" PRIu32, packet->subgroup, packet->pulse, packet->stamp);
    printf(",%" PRIu32 ",%" PRIu32 ",%" PRIu32, packet->count, packet->winner, packet->overrun);
    if (packet->map) {
        putchar(',');
        for (beat = (info->pixels + 63u) / 64u; beat-- > 0;) printf("%016" PRIx64, packet->map[beat]);
    }
    if (packet->offsets) {
        for (minigroup = 0; minigroup < info->minigroups; minigroup++) {
            printf("%c%" PRIu32, minigroup ? ' ' : ',', coincid_offset(packet, minigroup));
        }
    }
    putchar('\n');
}

/* Print the pixels of a minigroup, one per line. */
static void print_counts(const coincid_sensor_info *info, const coincid_packet *packet) {
    uint32_t pixel;
    uint32_t gate;
    uint32_t quarter;
    for (pixel = 0; pixel < info->minigroup_pixels; pixel++) {
        printf("%" PRIu32 ",%" PRIu32, packet->subgroup, coincid_pixel(info, packet, pixel));
        printf(",%" PRIu32, coincid_pulses(packet, pixel));
        for (gate = 0; gate < COINCID_GATES; gate++) {
            printf(",%" PRIu32, coincid_gate(packet, gate));
            for (quarter = 0; quarter < COINCID_GATE_CYCLES * COINCID_QUARTERS; quarter++) {
                printf("%c%" PRIu32, quarter ? ' ' : ',', coincid_gate_hits(packet, gate, pixel, quarter));
            }
        }
        putchar('\n');
    }
}

/* Print the events or counts of one stream, which carries `subgroups` subgroups. Return 0, or 1 if its beats are no whole frame. */
static int print_stream(coincid_sensor_info *info, uint32_t subgroups, const uint64_t *beats, size_t n) {
    size_t at = 0;
    uint64_t printed = 0;
    int kind = COINCID_FRAME_END;
    while (at < n) {
        coincid_packet packet;
        const int length = coincid_decode(info, subgroups, beats + at, n - at, &packet);
        if (length <= 0 || packet.kind == COINCID_DAMAGED) return 1;
        /* A frame start comes first and nowhere else, and nothing comes behind the frame end. */
        if ((packet.kind == COINCID_FRAME_START) != (at == 0) || (at && kind == COINCID_FRAME_END)) return 1;
        at += (size_t)length;
        kind = packet.kind;
        if (packet.kind == COINCID_FRAME_START) {
            info->grouped = packet.count;
        } else if (packet.kind == COINCID_GROUP) {
            coincid_group group;
            coincid_group_begin(&packet, &group);
            for (; coincid_group_event(info, &group, &packet); printed++) print_event(info, &packet);
        } else if (packet.kind == COINCID_GATE_COUNTS) {
            print_counts(info, &packet);
        } else if (packet.kind == COINCID_FRAME_END) {
            uint64_t stored = 0;
            uint32_t index;
            for (index = 0; index < subgroups; index++) stored += coincid_counter(&packet, index, COINCID_COUNTER_STORED);
            if (info->grouped != COINCID_WITH_COUNTS && printed < stored) return 1; /* whole groups are lost */
        } else if (packet.kind != COINCID_RECORD) {
            print_event(info, &packet);
            printed++;
        }
    }
    return !at || kind != COINCID_FRAME_END;
}

/* Stream s carries the subgroups from `first_subgroup(info, s)` to before `first_subgroup(info, s + 1)`. */
static uint32_t first_subgroup(const coincid_sensor_info *info, uint32_t stream) {
    return (stream * info->subgroups + COINCID_STREAMS_VALUE - 1u) / COINCID_STREAMS_VALUE;
}

int main(int arguments, char **argument) {
    const coincid_bus bus = {NULL, read_register, write_register};
    coincid_sensor_info info;
    uint64_t *beats = NULL;
    uint64_t beat;
    size_t n = 0;
    uint32_t stream = 0;
    uint32_t of_stream;
    int more = 1;
    FILE *file = arguments == 2 ? fopen(argument[1], "r") : NULL;
    if (!file || fscanf(file, "stream beat last") != 0 || coincid_probe(&bus, &info) != COINCID_OK) {
        fprintf(stderr, "usage: coincid_decode captured/NAME.txt\n");
        return 2;
    }
    while (more) {
        more = fscanf(file, "%" SCNu32 " %" SCNx64 " %*d", &of_stream, &beat) == 2;
        if (!more || of_stream != stream) {
            const uint32_t subgroups = first_subgroup(&info, stream + 1u) - first_subgroup(&info, stream);
            if (print_stream(&info, subgroups, beats, n)) {
                fprintf(stderr, "stream %" PRIu32 ": is no whole frame\n", stream);
                return 1;
            }
            stream++;
            n = 0;
            if (more && of_stream != stream) {
                fprintf(stderr, "stream %" PRIu32 ": is missing\n", stream);
                return 1;
            }
        }
        beats = realloc(beats, (n + 1u) * sizeof *beats);
        if (!beats) return 1;
        beats[n++] = beat;
    }
    free(beats);
    fclose(file);
    if (stream != COINCID_STREAMS_VALUE) {
        fprintf(stderr, "stream %" PRIu32 ": is missing\n", stream);
        return 1;
    }
    return 0;
}
