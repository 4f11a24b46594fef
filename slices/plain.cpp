// SPDX-License-Identifier: Apache-2.0
// Slices as Python sees them: their words, and passes.
#include "lanes.h"

extern "C" {
int slice_lanes() { return LANES; }
Slice* slice_new() { return new Slice(); }
void slice_delete(Slice* slice) { delete slice; }
void slice_reset(Slice* slice) { slice->reset(); }
uint64_t* slice_words(Slice* slice) { return &slice->chunk(0, 0); }
uint8_t* slice_flags(Slice* slice) { return slice->flags(); }
void slice_step(Slice* slice, int64_t edges) {
    for (int64_t i = 0; i < edges; i++) slice->pass();
    slice->settle();
}

// Clock edges, and a sample of a lane before each.
void slice_record(Slice* slice, int lane, int64_t edges, uint64_t* samples) {
    for (int64_t i = 0; i < edges; i++) {
        slice->sample(lane, samples + i * SAMPLE_WORDS);
        slice->pass();
    }
    slice->settle();
}
}
