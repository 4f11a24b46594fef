// SPDX-License-Identifier: Apache-2.0
// Batch engine: the sensor's modules and its core, each compiled once by Verilator, wired and stepped here.
//
// Every output of a module and of the core comes from a register, so nothing has to settle between two clock edges: take all
// outputs, set all inputs, step everything. The tests show that this equals the wiring of the top module.
//
// wiring.h is generated: sizes, and the names of the ports that depend on the number of streams.

#include <atomic>
#include <cstdint>
#include <cstring>
#include <memory>
#include <thread>
#include <type_traits>
#include <vector>

#include "Vcore.h"
#include "Vcore___024root.h"
#include "Vmodule.h"
#include "Vmodule___024root.h"
#include "verilated.h"
#include "wiring.h"

namespace {

constexpr int MODULES = (SUBGROUPS + 1) / 2;  // the second line of an odd number's last module is left alone
constexpr int PARTS_A_THREAD = 4;             // so that threads end together
constexpr int SPINS = 100000;                 // some ten cycles' time, before a waiting thread lets others run
constexpr int ALONE = 300;                   // cycles without help after a wait as long as that
enum Status { RUNNING = 0, DELIVERED = 1, HANGS = 2 };

// Bits of a port, for any type that Verilator gives it.
template <class T> uint32_t* words_of(T& port) {
    if constexpr (std::is_class_v<T>) return port.data();
    else return reinterpret_cast<uint32_t*>(&port);
}
template <class T> bool bit_of(T& port, int i) {
    if constexpr (std::is_class_v<T>) return port.data()[i / 32] >> (i % 32) & 1;
    else return port >> i & 1;
}
template <class T> void set_bit(T& port, int i) {
    if constexpr (std::is_class_v<T>) port.data()[i / 32] |= 1u << (i % 32);
    else port |= T(1) << i;
}
template <class T> void clear(T& port) {
    if constexpr (std::is_class_v<T>) std::memset(port.data(), 0, sizeof(port));
    else port = 0;
}

// A rising clock edge. Nothing happens at a falling edge, but evaluating it would take as long as the logic behind the
// inputs. So Verilator is only told that the clock has fallen.
template <class Model> void rise(Model& model) {
    model.rootp->__Vtrigprevexpr___TOP__clk__0 = 0;
    model.clk = 1;
    model.eval();
}

int stream_of(int subgroup) { return int(int64_t(subgroup) * STREAMS / SUBGROUPS); }

struct Beat { uint64_t data; int64_t cycle; };
struct Commit { int64_t subgroup, cycle; };

// A part of the modules, and their outputs to the core in a cycle. Every thread begins with its own parts and then takes parts
// that the others have not started. If other programs keep a thread from running, the first one works alone, and for a while
// does not even ask. So a busy machine costs no more than the second core.
struct alignas(64) Part {
    std::atomic<uint64_t> claimed{0}, done{0};  // the last cycle that somebody took, and finished
    uint64_t beat[STREAMS];
    bool valid[STREAMS], beat_controlled[STREAMS];
    uint32_t data;
    bool gate_late, upset;
    std::vector<int> stored, record_stored;
};

class Engine {
public:
    explicit Engine(int threads) : threads_(std::max(1, threads)), parts_(std::min(threads_ > 1 ? PARTS_A_THREAD * threads_ : 1, MODULES)) {
        core_context_.threads(1);
        core_ = std::make_unique<Vcore>(&core_context_, "core");
        for (int k = 0; k < MODULES; k++) {
            contexts_.push_back(std::make_unique<VerilatedContext>());
            contexts_.back()->threads(1);
            modules_.push_back(std::make_unique<Vmodule>(contexts_.back().get(), "module"));
            modules_.back()->number = k;
        }
        for (int thread = 1; thread < threads_; thread++) workers_.emplace_back([this, thread] { work(thread); });
        core_->rst = 1;
        for (int i = 0; i < 4; i++) step();
        core_->rst = 0;
        for (int i = 0; i < 4; i++) step();
    }

    ~Engine() {
        stopping_ = true;
        epoch_.fetch_add(1);
        epoch_.notify_all();
        for (auto& worker : workers_) worker.join();
    }

    int write(uint32_t address, uint32_t value) {
        begin_write(address, value);
        while (write_busy_) step();
        return write_response_;
    }

    int read(uint32_t address, uint32_t* value) {
        core_->s_axi_araddr = address;
        core_->s_axi_arvalid = core_->s_axi_rready = 1;
        for (;;) {
            bool taken = core_->s_axi_arvalid && core_->s_axi_arready;
            bool answered = core_->s_axi_rvalid;
            int response = core_->s_axi_rresp;
            if (answered) *value = core_->s_axi_rdata;
            step();
            if (taken) core_->s_axi_arvalid = 0;
            if (answered) { core_->s_axi_rready = 0; return response; }
        }
    }

    // Start a frame; `run` continues it. Edges are sorted by subgroup, then cycle; bit = pixel * phases + phase.
    int start(const int64_t* cycle, const int32_t* bit, const int64_t* bounds, const uint8_t* ready, int64_t ready_cycles, int64_t frame_cycles,
              int64_t limit, uint32_t control, uint32_t start_value) {
        cycle_of_.assign(cycle, cycle + bounds[SUBGROUPS]);
        bit_of_edge_.assign(bit, bit + bounds[SUBGROUPS]);
        next_.assign(bounds, bounds + SUBGROUPS);
        end_.assign(bounds + 1, bounds + SUBGROUPS + 1);
        ready_.assign(ready, ready + ready_cycles);
        frame_cycles_ = frame_cycles;
        limit_ = limit;
        commits_.clear();
        for (auto& beats : beats_) beats.clear();
        std::fill(std::begin(ended_), std::end(ended_), false);
        cycle_ = -1;
        begin_write(control, start_value);
        while (!core_->laser) {
            step();
            if (!write_busy_ && write_response_) return write_response_;
        }
        cycle_ = 0;
        return 0;
    }

    int run(int64_t cycles) {
        for (int64_t k = 0; k < cycles; k++) {
            bool is_ready = cycle_ >= int64_t(ready_.size()) || ready_[cycle_];
            bool all_ended = true;
            for_each_stream(*core_, [&](int s, auto& tdata, auto& tvalid, auto& tready, auto& tlast, auto&...) {
                tready = is_ready;
                if (is_ready && tvalid && !ended_[s]) {
                    beats_[s].push_back({tdata, cycle_});
                    ended_[s] = tlast;
                }
                all_ended &= ended_[s];
            });
            for (auto& part : parts_)
                for (int subgroup : part.stored) commits_.push_back({subgroup, cycle_ - STORED_TO_COMMIT});
            step();
            cycle_++;
            if (all_ended && cycle_ >= frame_cycles_) return finish();
            if (cycle_ >= limit_) return HANGS;
        }
        return RUNNING;
    }

    int64_t cycle() const { return cycle_; }
    const std::vector<Beat>& beats(int stream) const { return beats_[stream]; }
    const std::vector<Commit>& commits() const { return commits_; }

private:
    int finish() {
        cycle_ = -1;
        while (write_busy_) step();
        for_each_stream(*core_, [&](int, auto&, auto&, auto& tready, auto&...) { tready = 0; });
        return DELIVERED;
    }

    void begin_write(uint32_t address, uint32_t value) {
        core_->s_axi_awaddr = address;
        core_->s_axi_wdata = value;
        core_->s_axi_wstrb = 15;
        core_->s_axi_awvalid = core_->s_axi_wvalid = core_->s_axi_bready = 1;
        write_busy_ = true;
        write_response_ = 0;
    }

    // One clock edge of the whole sensor.
    void step() {
        gather();
        bool aw = core_->s_axi_awvalid && core_->s_axi_awready, w = core_->s_axi_wvalid && core_->s_axi_wready;
        bool b = core_->s_axi_bvalid && core_->s_axi_bready;
        int response = core_->s_axi_bresp;
        shared_.command = core_->command;
        shared_.period = core_->period;
        shared_.frame = core_->frame;
        shared_.timing = core_->timing;
        shared_.rst = core_->rst;
        for_each_stream(*core_, [&](int s, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto& grant, auto& send) {
            std::memcpy(shared_.grant[s], words_of(grant), sizeof(grant));
            shared_.send[s] = send;
        });
        uint64_t epoch = ++steps_;
        if (alone_) alone_--;
        else if (threads_ > 1) {
            epoch_.store(epoch, std::memory_order_release);
            epoch_.notify_all();
        }
        rise(*core_);
        take_all(0, epoch);
        for (auto& part : parts_)
            for (int spins = 0; part.done.load(std::memory_order_acquire) != epoch; spins++)
                if (spins > SPINS) {
                    std::this_thread::yield();
                    alone_ = ALONE;
                }
        if (aw) core_->s_axi_awvalid = 0;
        if (w) core_->s_axi_wvalid = 0;
        if (b) { core_->s_axi_bready = 0; write_busy_ = false; write_response_ = response; }
    }

    // Join the modules' outputs as the top module does.
    void gather() {
        core_->data = 0;
        core_->gate_late = core_->settings_upset = 0;
        for (auto& part : parts_) {
            core_->data |= part.data;
            core_->gate_late |= part.gate_late;
            core_->settings_upset |= part.upset;
        }
        for_each_stream(*core_, [&](int s, auto&, auto&, auto&, auto&, auto& stored, auto& record_stored, auto& valid, auto& beat, auto& beat_controlled, auto&, auto&) {
            clear(stored);
            clear(record_stored);
            valid = 0;
            beat = 0;
            beat_controlled = 0;
            for (auto& part : parts_) {
                valid |= part.valid[s];
                beat |= part.beat[s];
                beat_controlled |= part.beat_controlled[s];
                for (int subgroup : part.stored) if (stream_of(subgroup) == s) set_bit(stored, subgroup - STREAM_FIRST[s]);
                for (int subgroup : part.record_stored) if (stream_of(subgroup) == s) set_bit(record_stored, subgroup - STREAM_FIRST[s]);
            }
        });
    }

    template <int LINE> void inputs(Vmodule& module, int subgroup) {
        int s = stream_of(subgroup), i = subgroup - STREAM_FIRST[s];
        Line<LINE>::grant(module) = shared_.grant[s][i / 32] >> (i % 32) & 1;
        Line<LINE>::send(module) = shared_.send[s];
        uint32_t* words = words_of(Line<LINE>::words(module));
        for (int64_t e = next_.empty() ? 0 : next_[subgroup]; cycle_ >= 0 && e < end_[subgroup] && cycle_of_[e] == cycle_; e++)
            words[bit_of_edge_[e] / 32] |= 1u << (bit_of_edge_[e] % 32);
    }

    template <int LINE> void outputs(Vmodule& module, int subgroup, Part& part) {
        int s = stream_of(subgroup);
        uint32_t* words = words_of(Line<LINE>::words(module));
        if (cycle_ >= 0)
            for (int64_t& e = next_[subgroup]; e < end_[subgroup] && cycle_of_[e] == cycle_; e++) words[bit_of_edge_[e] / 32] = 0;
        part.valid[s] |= Line<LINE>::valid(module);
        part.beat[s] |= Line<LINE>::beat(module);
        part.beat_controlled[s] |= Line<LINE>::beat_controlled(module);
        part.data |= Line<LINE>::data(module);
        part.gate_late |= Line<LINE>::gate_late(module);
        part.upset |= Line<LINE>::upset(module);
        if (Line<LINE>::stored(module)) part.stored.push_back(subgroup);
        if (Line<LINE>::record_stored(module)) part.record_stored.push_back(subgroup);
    }

    // Do a thread's share of a cycle.
    void take_all(int thread, uint64_t epoch) {
        int parts = parts_.size(), first = parts * thread / threads_;
        for (int i = 0; i < parts; i++) take((first + i) % parts, epoch);
    }

    // Step the modules of a part, unless another thread has taken them in this cycle.
    void take(int number, uint64_t epoch) {
        Part& part = parts_[number];
        uint64_t before = epoch - 1;
        if (part.claimed.load(std::memory_order_relaxed) != before) return;
        if (!part.claimed.compare_exchange_strong(before, epoch, std::memory_order_acquire)) return;
        std::fill(std::begin(part.beat), std::end(part.beat), 0);
        std::fill(std::begin(part.valid), std::end(part.valid), false);
        std::fill(std::begin(part.beat_controlled), std::end(part.beat_controlled), false);
        part.data = part.gate_late = part.upset = 0;
        part.stored.clear();
        part.record_stored.clear();
        int64_t parts = parts_.size();
        for (int k = int(MODULES * number / parts); k < int(MODULES * (number + 1) / parts); k++) {
            Vmodule& module = *modules_[k];
            bool both = 2 * k + 1 < SUBGROUPS;
            module.rst = shared_.rst;
            module.command = shared_.command;
            module.period = shared_.period;
            module.frame = shared_.frame;
            module.timing = shared_.timing;
            inputs<0>(module, 2 * k);
            if (both) inputs<1>(module, 2 * k + 1);
            rise(module);
            outputs<0>(module, 2 * k, part);
            if (both) outputs<1>(module, 2 * k + 1, part);
        }
        part.done.store(epoch, std::memory_order_release);
    }

    void work(int thread) {
        for (uint64_t seen = 0;;) {
            uint64_t epoch = seen;
            for (int spins = 0; (epoch = epoch_.load(std::memory_order_acquire)) == seen; spins++)
                if (spins > SPINS) epoch_.wait(seen, std::memory_order_acquire);
            if (stopping_) return;
            take_all(thread, epoch);
            seen = epoch;
        }
    }

    VerilatedContext core_context_;
    std::unique_ptr<Vcore> core_;
    std::vector<std::unique_ptr<VerilatedContext>> contexts_;
    std::vector<std::unique_ptr<Vmodule>> modules_;
    std::vector<std::thread> workers_;
    std::atomic<uint64_t> epoch_{0};  // the last cycle that workers were told of
    uint64_t steps_ = 0;
    int alone_ = 0;
    std::atomic<bool> stopping_{false};
    const int threads_;
    std::vector<Part> parts_;
    struct {
        std::remove_reference_t<decltype(Vmodule::command)> command;
        std::remove_reference_t<decltype(Vmodule::period)> period;
        std::remove_reference_t<decltype(Vmodule::frame)> frame;
        std::remove_reference_t<decltype(Vmodule::timing)> timing;
        uint8_t rst, send[STREAMS];
        uint32_t grant[STREAMS][GRANT_WORDS];
    } shared_{};

    bool write_busy_ = false;
    int write_response_ = 0;
    int64_t cycle_ = -1, frame_cycles_ = 0, limit_ = 0;
    std::vector<int64_t> cycle_of_, next_, end_;
    std::vector<int32_t> bit_of_edge_;
    std::vector<uint8_t> ready_;
    std::vector<Beat> beats_[STREAMS];
    std::vector<Commit> commits_;
    bool ended_[STREAMS] = {};
};

}  // namespace

extern "C" {
Engine* coincid_new(int threads) { return new Engine(threads); }
void coincid_delete(Engine* engine) { delete engine; }
int coincid_write(Engine* engine, uint32_t address, uint32_t value) { return engine->write(address, value); }
int coincid_read(Engine* engine, uint32_t address, uint32_t* value) { return engine->read(address, value); }
int coincid_start(Engine* engine, const int64_t* cycle, const int32_t* bit, const int64_t* bounds, const uint8_t* ready, int64_t ready_cycles,
                  int64_t frame_cycles, int64_t limit, uint32_t control, uint32_t start_value) {
    return engine->start(cycle, bit, bounds, ready, ready_cycles, frame_cycles, limit, control, start_value);
}
int coincid_run(Engine* engine, int64_t cycles) { return engine->run(cycles); }
int64_t coincid_cycle(Engine* engine) { return engine->cycle(); }
int64_t coincid_beats(Engine* engine, int stream, const Beat** beats) {
    *beats = engine->beats(stream).data();
    return int64_t(engine->beats(stream).size());
}
int64_t coincid_commits(Engine* engine, const Commit** commits) {
    *commits = engine->commits().data();
    return int64_t(engine->commits().size());
}
}
