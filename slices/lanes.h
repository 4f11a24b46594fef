// SPDX-License-Identifier: Apache-2.0
// A slice: the words of a netlist, in which lane i is bit i of every word.
#pragma once
#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "slice.h"

constexpr int SAMPLE_WORDS = (SLICE_WORDS + 63) / 64;

class Slice {
public:
    Slice() : words_(static_cast<W*>(std::aligned_alloc(64, (sizeof(W) * SLICE_WORDS + 63) / 64 * 64))) { reset(); }
    ~Slice() { std::free(words_); }
    Slice(const Slice&) = delete;
    Slice& operator=(const Slice&) = delete;

    // Registers as they are at power-up, inputs 0.
    void reset() {
        std::memset(words_, 0, sizeof(W) * SLICE_WORDS);
        std::memset(flags_, 0, sizeof(flags_));
        for (const int* word = SLICE_ONES; *word >= 0; word++) words_[*word] = ONES;
    }

    void pass() { slice_pass(words_, flags_); }
    void settle() { slice_settle(words_, flags_); }

    W& word(int number) { return words_[number]; }
    uint64_t& chunk(int number, int chunk) { return reinterpret_cast<uint64_t*>(words_)[size_t(number) * CHUNKS + chunk]; }
    bool get(int number, int lane) { return chunk(number, lane / 64) >> (lane % 64) & 1; }
    void put(int number, int lane, bool bit) {
        uint64_t& part = chunk(number, lane / 64);
        uint64_t mask = uint64_t(1) << (lane % 64);
        part = bit ? part | mask : part & ~mask;
    }
    uint8_t* flags() { return flags_; }

    // One bit of every word: all that a lane is made of.
    void sample(int lane, uint64_t* bits) {
        const uint64_t* from = &chunk(0, lane / 64);
        for (int word = 0; word < SLICE_WORDS; word += 64) {
            uint64_t part = 0;
            for (int k = std::min(64, SLICE_WORDS - word) - 1; k >= 0; k--)
                part = part << 1 | (from[size_t(word + k) * CHUNKS] >> (lane % 64) & 1);
            *bits++ = part;
        }
    }
    void restore(int lane, const uint64_t* bits) {
        for (int word = 0; word < SLICE_WORDS; word++) put(word, lane, bits[word / 64] >> (word % 64) & 1);
    }

private:
    W* words_;
    uint8_t flags_[SLICE_FLAGS];
};
