// SPDX-License-Identifier: Apache-2.0
// The whole sensor as Verilator makes it fastest, and a host around it: for comparisons of speed only.
//
// lean FILE REPEATS: plays the frame of FILE (numbers of 64 bits, see `engine_speed.py`) and prints cycles, seconds, beats and
// a digest of the beats, of each repetition.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

#include "Vtop.h"
#include "spads.h"
#include "verilated.h"

namespace {

VerilatedContext context;
Vtop top{&context, "TOP"};

void step() {
    top.clk = 1;
    top.eval();
    top.clk = 0;
    top.eval();
}

void write(uint32_t address, uint32_t value) {
    top.s_axi_awaddr = address;
    top.s_axi_wdata = value;
    top.s_axi_wstrb = 15;
    top.s_axi_awvalid = top.s_axi_wvalid = top.s_axi_bready = 1;
    for (bool done = false; !done;) {
        bool aw = top.s_axi_awvalid && top.s_axi_awready, w = top.s_axi_wvalid && top.s_axi_wready;
        done = top.s_axi_bvalid;
        step();
        if (aw) top.s_axi_awvalid = 0;
        if (w) top.s_axi_wvalid = 0;
        if (done) top.s_axi_bready = 0;
    }
}

}  // namespace

int main(int, char** arguments) {
    std::ifstream file(arguments[1], std::ios::binary);
    std::vector<int64_t> numbers;
    for (int64_t number; file.read(reinterpret_cast<char*>(&number), sizeof(number));) numbers.push_back(number);
    const int64_t* at = numbers.data();
    int64_t settings = *at++;
    top.rst = 1;
    for (int i = 0; i < 4; i++) step();
    top.rst = 0;
    for (int i = 0; i < 4; i++) step();
    for (int64_t k = 0; k < settings; k++, at += 2) write(uint32_t(at[0]), uint32_t(at[1]));
    int64_t control = *at++, start = *at++, status = *at++, done = *at++, frame_cycles = *at++, edges = *at++;
    for (int repeat = 0; repeat < std::atoi(arguments[2]); repeat++) {
        auto began = std::chrono::steady_clock::now();
        write(uint32_t(control), uint32_t(start));
        while (!top.laser) step();
        int64_t cycle = 0, beats = 0, next = 0;
        uint64_t digest = 0;
        for (bool ended = false; !ended || cycle < frame_cycles; cycle++) {
            int64_t first = next;
            for (; next < edges && at[3 * next] == cycle; next++) spads(top)[at[3 * next + 1]][at[3 * next + 2] / 32] |= 1u << (at[3 * next + 2] % 32);
            top.m_axis_tready = 1;
            if (top.m_axis_tvalid && !ended) {
                beats++;
                digest = (digest ^ top.m_axis_tdata) * 0x9E3779B97F4A7C15u + 1;
                ended = top.m_axis_tlast;
            }
            step();
            for (; first < next; first++) spads(top)[at[3 * first + 1]][at[3 * first + 2] / 32] = 0;
        }
        double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
        std::printf("%ld %.6f %ld %lu\n", long(cycle), seconds, long(beats), static_cast<unsigned long>(digest));
        top.m_axis_tready = 0;
        for (int i = 0; i < 100; i++) step();
        write(uint32_t(status), uint32_t(done));
    }
}
