// SPDX-License-Identifier: Apache-2.0
// A word of lanes: bit i belongs to lane i. GCC's vectors, so that it compiles for any processor. LANES: 64, 128, 256 or 512.
#pragma once
#include <cstdint>
#ifdef __x86_64__
#include <immintrin.h>
#endif

#if LANES == 64
typedef uint64_t W;
#else
typedef uint64_t W __attribute__((vector_size(LANES / 8), may_alias));
#endif
constexpr int CHUNKS = LANES / 64;  // 64-bit parts of a word

#define ZEROS (W{})
#define ONES (~W{})

static inline bool any(W x) {
#if LANES == 64
    return x != 0;
#elif LANES == 512 && defined(__AVX512F__)
    return _mm512_test_epi64_mask((__m512i)x, (__m512i)x);
#elif LANES == 256 && defined(__AVX__)
    return !_mm256_testz_si256((__m256i)x, (__m256i)x);
#elif LANES == 128 && defined(__SSE4_1__)
    return !_mm_testz_si128((__m128i)x, (__m128i)x);
#else
    uint64_t some = 0;
    for (int i = 0; i < CHUNKS; i++) some |= x[i];
    return some;
#endif
}

// A function of two or three words; bit a + 2 b + 4 c of BITS is its value.
template <unsigned BITS> static inline W table(W a) {
    static_assert(BITS == 1 || BITS == 2);
    if constexpr (BITS == 1) return ~a;
    else return a;
}

template <unsigned BITS> static inline W table(W a, W b) {
    if constexpr (BITS == 0) return ZEROS;
    else if constexpr (BITS == 1) return ~(a | b);
    else if constexpr (BITS == 2) return a & ~b;
    else if constexpr (BITS == 3) return ~b;
    else if constexpr (BITS == 4) return b & ~a;
    else if constexpr (BITS == 5) return ~a;
    else if constexpr (BITS == 6) return a ^ b;
    else if constexpr (BITS == 7) return ~(a & b);
    else if constexpr (BITS == 8) return a & b;
    else if constexpr (BITS == 9) return ~(a ^ b);
    else if constexpr (BITS == 10) return a;
    else if constexpr (BITS == 11) return a | ~b;
    else if constexpr (BITS == 12) return b;
    else if constexpr (BITS == 13) return b | ~a;
    else if constexpr (BITS == 14) return a | b;
    else return ONES;
}

// Operations that `table` needs for a function of two words.
constexpr int cost(unsigned bits) {
    constexpr int OF[16] = {0, 2, 2, 1, 2, 1, 1, 2, 1, 2, 0, 2, 0, 2, 1, 0};
    return OF[bits];
}

// Operations for a function of three words that is split by the last one.
constexpr int split_cost(unsigned low, unsigned high) {
    if (low == high) return cost(low);
    if (low == (high ^ 15)) return cost(low) + 1;
    if (low == 0 || high == 15) return cost(low | (high == 15 ? 0 : high)) + 1;
    if (high == 0 || low == 15) return cost(high == 0 ? low : high) + 2;
    return cost(low) + cost(high) + 3;
}

template <unsigned LOW, unsigned HIGH> static inline W split(W a, W b, W c) {
    if constexpr (LOW == HIGH) return table<LOW>(a, b);
    else if constexpr (LOW == (HIGH ^ 15)) return table<LOW>(a, b) ^ c;
    else if constexpr (LOW == 0) return table<HIGH>(a, b) & c;
    else if constexpr (HIGH == 15) return table<LOW>(a, b) | c;
    else if constexpr (HIGH == 0) return table<LOW>(a, b) & ~c;
    else if constexpr (LOW == 15) return table<HIGH>(a, b) | ~c;
    else {
        W low = table<LOW>(a, b);
        return low ^ ((low ^ table<HIGH>(a, b)) & c);
    }
}

// Half of a function of three words: the values for which input `k` is `value`.
constexpr unsigned half(unsigned bits, int k, int value) {
    unsigned found = 0;
    for (int row = 0, i = 0; row < 8; row++)
        if ((row >> k & 1) == value) found |= (bits >> row & 1) << i++;
    return found;
}

template <unsigned BITS> static inline W table(W a, W b, W c) {
#if LANES > 64 && defined(__AVX512VL__)
    // The instruction's first operand is the highest bit of the function's argument.
#if LANES == 512
    return (W)_mm512_ternarylogic_epi64((__m512i)c, (__m512i)b, (__m512i)a, BITS);
#elif LANES == 256
    return (W)_mm256_ternarylogic_epi64((__m256i)c, (__m256i)b, (__m256i)a, BITS);
#else
    return (W)_mm_ternarylogic_epi64((__m128i)c, (__m128i)b, (__m128i)a, BITS);
#endif
#else
    constexpr unsigned A0 = half(BITS, 0, 0), A1 = half(BITS, 0, 1), B0 = half(BITS, 1, 0), B1 = half(BITS, 1, 1);
    constexpr unsigned C0 = half(BITS, 2, 0), C1 = half(BITS, 2, 1);
    constexpr int BY_A = split_cost(A0, A1), BY_B = split_cost(B0, B1), BY_C = split_cost(C0, C1);
    if constexpr (BY_C <= BY_A && BY_C <= BY_B) return split<C0, C1>(a, b, c);
    else if constexpr (BY_B <= BY_A) return split<B0, B1>(a, c, b);
    else return split<A0, A1>(b, c, a);
#endif
}

static inline W mux(W chosen, W one, W zero) { return table<0xCA>(zero, one, chosen); }
