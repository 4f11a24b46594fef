// SPDX-License-Identifier: Apache-2.0
// The emulator behind its two serial pins, as a library: bytes pass at the speed of the line, bit by bit. See simulated.py.
#include <cstdint>
#include <deque>
#include "Vemulator.h"

struct Line {
    VerilatedContext context;
    Vemulator top{&context};
    int clocks;
    int64_t cycle = 0;
    std::deque<uint8_t> out, in;  // to the emulator, from it
    int send_left = 0, send_count = 0, take_left = 0, take_count = 0;
    unsigned send_bits = 0, take_bits = 0;
    bool connected = true;

    void drive() {  // the host's end of rx
        if (send_left == 0 && !out.empty()) {
            send_bits = (out.front() << 1) | 0x200;
            out.pop_front();
            send_left = 10;
            send_count = clocks;
        }
        top.rx = send_left && connected ? send_bits & 1 : 1;
        if (send_left && --send_count == 0) {
            send_bits >>= 1;
            send_count = clocks;
            --send_left;
        }
    }
    void listen() {  // the host's end of tx
        bool tx = !connected || top.tx;
        if (take_left == 0) {
            if (!tx) {
                take_left = 10;
                take_count = clocks / 2;
            }
        } else if (--take_count == 0) {
            take_bits = (take_bits >> 1) | (tx ? 0x200 : 0);
            take_count = clocks;
            if (--take_left == 0 && (take_bits & 0x200)) in.push_back((take_bits >> 1) & 0xff);
        }
    }
    void step() {
        drive();
        top.clk = 0;
        top.eval();
        top.clk = 1;
        top.eval();
        listen();
        ++cycle;
    }
};

extern "C" {
Line* coincid_line_new(int clocks) {
    Line* line = new Line;
    line->clocks = clocks;
    line->top.rx = 1;
    return line;
}
void coincid_line_delete(Line* line) { delete line; }
void coincid_line_reset(Line* line, int64_t cycles) {
    line->top.rst = 1;
    for (int64_t i = 0; i < cycles; ++i) line->step();
    line->top.rst = 0;
}
void coincid_line_connect(Line* line, int connected) {
    line->connected = connected;
    if (!connected) line->out.clear();
}
void coincid_line_send(Line* line, const uint8_t* bytes, int64_t n) { line->out.insert(line->out.end(), bytes, bytes + n); }
// Run until a byte has arrived or so many cycles have passed, and on while the line is busy; return the number of bytes.
int64_t coincid_line_run(Line* line, int64_t cycles, uint8_t* bytes, int64_t room) {
    int64_t end = line->cycle + cycles, n = 0;
    while (line->cycle < end && line->in.empty()) line->step();
    while (n < room && !line->in.empty()) {
        bytes[n++] = line->in.front();
        line->in.pop_front();
    }
    return n;
}
int64_t coincid_line_cycle(Line* line) { return line->cycle; }
}
