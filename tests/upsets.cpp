// SPDX-License-Identifier: Apache-2.0
// A Verilated sensor whose flip-flops can be flipped, and a host that uses it: it programs, starts frames, takes the streams,
// and writes its settings again if the sensor reports an error. `upsets.py` chooses flip-flop and time, and judges.
#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "Vtop.h"
#include "ports.h"
#include "verilated.h"
#include "verilated_syms.h"

// From Verilator: computes everything behind the registers again; `eval` only does so behind ports and clocks.
void Vtop___024root___eval_settle(Vtop___024root* self);

namespace {

constexpr int ANSWER_CYCLES = 200;  // of the register bus, at most
constexpr int LASER_CYCLES = 100;   // from a start's answer to the frame's first cycle, at most
constexpr int QUIET_CYCLES = 40;    // of a stream that has said all it had to say
enum Outcome { FINE = 0, BUS_WAITS, NEVER_DONE, REFUSED, NO_LASER, WITHOUT_LAST, NOISY };
enum Status : uint32_t { BUSY = 1, DONE = 2 };

struct Edge { int64_t cycle; int32_t subgroup, bit; };
struct Recipe {
    std::vector<Edge> edges;
    std::vector<uint8_t> ready;
    int64_t frame_cycles;
    int64_t limit;  // cycles within which a frame ends, whatever an upset did to it
};
struct Beat { uint64_t data; int64_t cycle; };

class Host {
public:
    Host() : top_(std::make_unique<Vtop>(&context_, "TOP")) { reset(); }

    void reset() {
        quiet_inputs();
        top_->rst = 1;
        for (int i = 0; i < 4; i++) step();
        top_->rst = 0;
        for (int i = 0; i < 4; i++) step();
    }

    int find(const char* scope, const char* name) {
        const VerilatedScope* found = context_.scopeFind(scope);
        VerilatedVar* var = found ? found->varFind(name) : nullptr;
        if (!var) return -1;
        vars_.push_back(static_cast<uint8_t*>(var->datap()));
        return int(vars_.size()) - 1;
    }

    void setting(uint32_t address, uint32_t value) { settings_.push_back({address, value}); }
    void recipe(Recipe recipe) { recipes_.push_back(std::move(recipe)); }

    // Flip bit `bit` of `flop`, as found, in cycle `cycle` counted from now.
    void upset(int flop, int64_t byte, int bit, int64_t cycle) {
        flop_ = vars_[flop] + byte;
        bit_ = bit;
        at_ = now_ + cycle;
    }

    int write(uint32_t address, uint32_t value, int* response) {
        top_->s_axi_awaddr = address;
        top_->s_axi_wdata = value;
        top_->s_axi_wstrb = 15;
        top_->s_axi_awvalid = top_->s_axi_wvalid = top_->s_axi_bready = 1;
        bool answered = false;
        for (int cycle = 0; cycle < ANSWER_CYCLES; cycle++) {
            bool aw = top_->s_axi_awvalid && top_->s_axi_awready, w = top_->s_axi_wvalid && top_->s_axi_wready;
            if (!answered && top_->s_axi_bvalid) {
                answered = true;
                *response = top_->s_axi_bresp;
            }
            step();
            if (aw) top_->s_axi_awvalid = 0;
            if (w) top_->s_axi_wvalid = 0;
            if (answered) top_->s_axi_bready = 0;
            if (answered && !top_->s_axi_awvalid && !top_->s_axi_wvalid) return FINE;
        }
        return BUS_WAITS;
    }

    int read(uint32_t address, uint32_t* value, int* response) {
        top_->s_axi_araddr = address;
        top_->s_axi_arvalid = top_->s_axi_rready = 1;
        bool answered = false;
        for (int cycle = 0; cycle < ANSWER_CYCLES; cycle++) {
            bool ar = top_->s_axi_arvalid && top_->s_axi_arready;
            if (!answered && top_->s_axi_rvalid) {
                answered = true;
                *value = top_->s_axi_rdata;
                *response = top_->s_axi_rresp;
            }
            step();
            if (ar) top_->s_axi_arvalid = 0;
            if (answered) top_->s_axi_rready = 0;
            if (answered && !top_->s_axi_arvalid) return FINE;
        }
        return BUS_WAITS;
    }

    int program() {
        int response = 0;
        for (auto [address, value] : settings_)
            if (int outcome = write(address, value, &response)) return outcome;
        return FINE;
    }

    // Start a frame and take its output. If the sensor reports an error, the host clears it and writes all settings again.
    int frame(int number) {
        const Recipe& of = recipes_[number];
        int response = 0;
        begin_ = now_;
        for (auto& beats : beats_) beats.clear();
        lasers_.clear();
        gates_ = 0;
        uint32_t status = 0;
        if (int outcome = write(CONTROL, START, &response)) return outcome;
        if (response) {
            if (int outcome = read(STATUS, &status, &response)) return outcome;
            if (int outcome = write(STATUS, ~0u, &response)) return outcome;
            if (int outcome = program()) return outcome;
            return REFUSED;
        }
        int outcome = FINE;
        for (int wait = 0; !top_->laser; wait++) {
            if (wait == LASER_CYCLES) {
                outcome = NO_LASER;
                break;
            }
            step();
        }
        bool ended[STREAMS] = {};
        size_t next = 0;
        bool all_ended = false;
        int64_t cycle = 0;
        for (; !(all_ended && cycle >= of.frame_cycles) && cycle < of.limit && !outcome; cycle++) {
            for_each_spad([](auto& spad) { spad = 0; });
            for (; next < of.edges.size() && of.edges[next].cycle == cycle; next++) light(of.edges[next]);
            bool ready = cycle >= int64_t(of.ready.size()) || of.ready[cycle];
            all_ended = true;
            for_each_stream(*top_, [&](int s, auto& tdata, auto& tvalid, auto& tready, auto& tlast) {
                tready = ready;
                if (ready && tvalid) {
                    beats_[s].push_back({tdata, cycle});
                    ended[s] |= tlast;
                }
                all_ended &= ended[s];
            });
            if (top_->laser) lasers_.push_back(cycle);
            gates_ = (gates_ ^ top_->spad_gate) * 0x9E3779B97F4A7C15u + 1;
            step();
        }
        for_each_spad([](auto& spad) { spad = 0; });
        if (!outcome && !all_ended) outcome = WITHOUT_LAST;
        // Then the status shows it.
        for (int64_t wait = 0; wait <= of.limit; wait++) {
            if (int broken = read(STATUS, &status, &response)) return broken;
            if (!(status & BUSY)) break;
            if (wait == of.limit) return NEVER_DONE;
        }
        int after = 0;
        for (int64_t wait = 0, quiet = 0; quiet < QUIET_CYCLES; wait++, quiet++) {
            for_each_stream(*top_, [&](int, auto&, auto& tvalid, auto& tready, auto&) {
                tready = 1;
                if (tvalid) {
                    after++;
                    quiet = 0;
                }
            });
            step();
            if (wait > of.limit) return NEVER_DONE;
        }
        for_each_stream(*top_, [&](int, auto&, auto&, auto& tready, auto&) { tready = 0; });
        if (status & ~uint32_t(BUSY | DONE)) {
            if (int broken = write(STATUS, ~0u, &response)) return broken;
            if (int broken = program()) return broken;
            if (!outcome) outcome = NOISY;
        } else if (int broken = write(STATUS, DONE, &response)) return broken;
        if (!outcome && (after || !(status & DONE))) outcome = NOISY;
        return outcome;
    }

    // Return whether every setting reads as it was written.
    int check_settings() {
        uint32_t value = 0;
        int response = 0;
        for (auto [address, expected] : settings_) {
            if (int outcome = read(address, &value, &response)) return outcome;
            if (value != expected || response) return NOISY;
        }
        return FINE;
    }

    void idle(int64_t cycles) { for (int64_t i = 0; i < cycles; i++) step(); }

    int64_t now() const { return now_; }
    const std::vector<Beat>& beats(int stream) const { return beats_[stream]; }
    const std::vector<int64_t>& lasers() const { return lasers_; }
    uint64_t gates() const { return gates_; }

private:
    void quiet_inputs() {
        top_->s_axi_awvalid = top_->s_axi_wvalid = top_->s_axi_arvalid = top_->s_axi_bready = top_->s_axi_rready = 0;
        for_each_spad([](auto& spad) { spad = 0; });
        for_each_stream(*top_, [&](int, auto&, auto&, auto& tready, auto&) { tready = 0; });
        at_ = -1;
    }

    template <class Visit> void for_each_spad(Visit visit) { spads(*top_, [&](int, auto& spad) { visit(spad); }); }

    void light(const Edge& edge) {
        spads(*top_, [&](int s, auto& spad) { if (s == edge.subgroup) spad |= uint64_t(1) << edge.bit; });
    }

    // Registers flip just after the clock edge.
    void step() {
        top_->clk = 1;
        top_->eval();
        top_->clk = 0;
        top_->eval();
        if (now_++ == at_) {
            flop_[bit_ / 8] ^= 1 << (bit_ % 8);
            Vtop___024root___eval_settle(top_->rootp);
        }
    }

    VerilatedContext context_;
    std::unique_ptr<Vtop> top_;
    std::vector<uint8_t*> vars_;
    std::vector<std::array<uint32_t, 2>> settings_;
    std::vector<Recipe> recipes_;
    std::vector<Beat> beats_[STREAMS];
    std::vector<int64_t> lasers_;
    uint64_t gates_ = 0;
    uint8_t* flop_ = nullptr;
    int bit_ = 0;
    int64_t at_ = -1, now_ = 0, begin_ = 0;
};

}  // namespace

extern "C" {
Host* upsets_new() { return new Host(); }
void upsets_delete(Host* host) { delete host; }
void upsets_reset(Host* host) { host->reset(); }
int upsets_find(Host* host, const char* scope, const char* name) { return host->find(scope, name); }
void upsets_setting(Host* host, uint32_t address, uint32_t value) { host->setting(address, value); }
void upsets_recipe(Host* host, int64_t n, const int64_t* cycle, const int32_t* subgroup, const int32_t* bit, const uint8_t* ready, int64_t ready_cycles,
                   int64_t frame_cycles, int64_t limit) {
    Recipe recipe{{}, {ready, ready + ready_cycles}, frame_cycles, limit};
    for (int64_t k = 0; k < n; k++) recipe.edges.push_back({cycle[k], subgroup[k], bit[k]});
    host->recipe(std::move(recipe));
}
int upsets_program(Host* host) { return host->program(); }
int upsets_frame(Host* host, int recipe) { return host->frame(recipe); }
int upsets_check_settings(Host* host) { return host->check_settings(); }
void upsets_upset(Host* host, int flop, int64_t byte, int bit, int64_t cycle) { host->upset(flop, byte, bit, cycle); }
void upsets_idle(Host* host, int64_t cycles) { host->idle(cycles); }
int64_t upsets_now(Host* host) { return host->now(); }
int64_t upsets_beats(Host* host, int stream, const Beat** beats) {
    *beats = host->beats(stream).data();
    return int64_t(host->beats(stream).size());
}
int64_t upsets_lasers(Host* host, const int64_t** lasers) {
    *lasers = host->lasers().data();
    return int64_t(host->lasers().size());
}
uint64_t upsets_gates(Host* host) { return host->gates(); }
}
