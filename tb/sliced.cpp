// SPDX-License-Identifier: Apache-2.0
// Sliced engine: sensors whose subgroups are lanes of slices, each with a Verilated core of its own.
//
// Every output of a slice and of the core comes from a register, so nothing has to settle between two clock edges: take all
// outputs, set all inputs, step everything. The tests show that this equals the wiring of the top module.
//
// wiring.h is generated: sizes, the names of the ports that depend on the number of streams, addresses.

#include <algorithm>
#include <array>
#include <coroutine>
#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <type_traits>
#include <vector>

#include "Vcore.h"
#include "Vcore___024root.h"
#include "Vcore__Syms.h"
#include "lanes.h"
#include "verilated.h"
#include "wiring.h"

void Vcore___024root___eval_settle(Vcore___024root*);  // of Verilator: all logic that follows from the registers

namespace {

constexpr int64_t NO_END = std::numeric_limits<int64_t>::max();
constexpr int64_t BEFORE_GAP_ENDS = 2;  // cycles that are played at the end of a gap
constexpr int64_t LOOK_EVERY = 64;      // cycles between two looks whether all sensors are idle

// Bits of a port, for any type that Verilator gives it.
template <class T> uint32_t* words_of(T& port) {
    if constexpr (std::is_class_v<T>) return port.data();
    else return reinterpret_cast<uint32_t*>(&port);
}
template <class T> constexpr int BYTES = sizeof(T);

// A rising clock edge. Nothing happens at a falling edge, but evaluating it would take as long as the logic behind the
// inputs. So Verilator is only told that the clock has fallen.
template <class Model> void rise(Model& model) {
    model.rootp->__Vtrigprevexpr___TOP__clk__0 = 0;
    model.clk = 1;
    model.eval();
}

struct Edge {
    int64_t cycle;
    int32_t bit, subgroup;
};
// A stream's link takes `beats` beats in `cycles` cycles.
struct Link {
    int64_t beats, cycles;
    // The rule of `takes_beats` in model/contract/link.py.
    bool takes(int64_t cycle) const {
        int64_t since = cycle % cycles;
        return (since + 1) * beats / cycles > since * beats / cycles;
    }
};
struct Frame {
    std::vector<Edge> edges;        // by cycle
    std::vector<uint8_t> receiver;  // whether it takes a beat in a cycle; afterwards it always does
    Link link;
    int64_t limit;  // cycles within which it ends
    bool ready(int64_t cycle) const {
        return link.takes(cycle) && (cycle >= int64_t(receiver.size()) || receiver[cycle]);
    }
};
struct Op {
    enum Kind { WRITE, READ, WAIT, FRAME } kind;  // WAIT: read until a bit of `value` is set
    uint32_t address, value;
    std::shared_ptr<Frame> frame;
};
struct Beat { uint64_t data; int64_t cycle; };
struct Commit { int64_t subgroup, cycle; };
struct Record {
    std::vector<Beat> beats[STREAMS];
    std::vector<Commit> commits;
};
enum Outcome : int { FINE = 0, REFUSED = 1, HANGS = 2 };

// What a sensor's host does: a coroutine that continues once per clock cycle.
struct Host {
    struct promise_type {
        Host get_return_object() { return {std::coroutine_handle<promise_type>::from_promise(*this)}; }
        std::suspend_always initial_suspend() { return {}; }
        std::suspend_always final_suspend() noexcept { return {}; }
        void return_void() {}
        void unhandled_exception() { std::abort(); }
    };
    std::coroutine_handle<promise_type> handle;
};
constexpr std::suspend_always CYCLE;

// 64 lanes, or those of them that belong to a stream of a sensor.
struct Lanes {
    Slice* slice;
    int chunk;       // of the words
    uint64_t mask;
    int subgroup;    // of the mask's lowest bit
};

// Sensors of fewer than 64 subgroups share the 64 bits of a chunk; others have whole chunks.
constexpr int PER_CHUNK = SUBGROUPS < 64 ? 64 / SUBGROUPS : 1;
constexpr int CHUNKS_EACH = (SUBGROUPS + 63) / 64;
constexpr int first_chunk(int sensor) { return SUBGROUPS < 64 ? sensor / PER_CHUNK : sensor * CHUNKS_EACH; }
constexpr int first_lane(int sensor) { return SUBGROUPS < 64 ? sensor % PER_CHUNK * SUBGROUPS : 0; }

class Sensor {
public:
    Sensor(int number, std::vector<std::unique_ptr<Slice>>& slices) : core_(std::make_unique<Vcore>(&context_, "core")), host_(play()) {
        for (int s = 0; s <= STREAMS; s++) {  // the last one: all subgroups
            int begin = s < STREAMS ? STREAM_FIRST[s] : 0, end = s + 1 < STREAMS ? STREAM_FIRST[s + 1] : SUBGROUPS;
            for (int subgroup = begin; subgroup < end;) {
                int lane = first_lane(number) + subgroup, bit = lane % 64, chunk = first_chunk(number) + lane / 64;
                int n = std::min(64 - bit, end - subgroup);
                uint64_t mask = (n == 64 ? ~0ull : (1ull << n) - 1) << bit;
                lanes_[s].push_back({slices[chunk / CHUNKS].get(), chunk % CHUNKS, mask, subgroup});
                subgroup += n;
            }
        }
        for (Lanes& lanes : lanes_[STREAMS])
            for (uint64_t rest = lanes.mask, subgroup = lanes.subgroup; rest; rest &= rest - 1, subgroup++)
                for (int k = 0; k < int(std::size(IN_number)); k++)
                    if (subgroup >> k & 1) lanes.slice->chunk(IN_number[k], lanes.chunk) |= rest & -rest;
        core_->rst = 1;
    }
    // The host gives up whatever it is doing, and starts anew.
    void give_up() {
        host_.handle.destroy();
        todo_.clear();
        during_.clear();
        records_.clear();
        frame_.reset();
        next_edge_ = 0;
        cycle_ = -1;
        outcome_ = FINE;
        idle_ = write_busy_ = false;
        core_->s_axi_awvalid = core_->s_axi_wvalid = core_->s_axi_bready = core_->s_axi_arvalid = core_->s_axi_rready = 0;
        for_each_stream(*core_, [&](int, auto&, auto&, auto& tready, auto&...) { tready = 0; });
        host_ = play();
    }
    // A reset, from the next edge on, whatever the sensor is doing.
    void reset() {
        give_up();
        core_->rst = 1;
    }
    ~Sensor() { host_.handle.destroy(); }
    Sensor(const Sensor&) = delete;

    void post(Op op) { todo_.push_back(std::move(op)); idle_ = false; }
    // A write to the frame that is posted or running. Without one, it would reach the next frame.
    void post_during_frame(uint32_t address, uint32_t value) {
        if (!idle_) during_.push_back({Op::WRITE, address, value, {}});
    }
    bool idle() const { return idle_; }
    int64_t cycle() const { return cycle_; }
    int64_t hung() const { return hung_; }
    int64_t cycles() const { return cycles_ + std::max<int64_t>(cycle_, 0); }
    Outcome outcome() const { return outcome_; }
    uint32_t value() const { return value_; }
    void forget() { records_.clear(); outcome_ = FINE; }
    const std::vector<std::unique_ptr<Record>>& records() const { return records_; }
    Vcore& core() { return *core_; }

    // Idle cycles. See formal/idle.py for what makes skipping them the same as playing them.

    // Cycles from the next one on in which this sensor only waits in a gap, if it has nothing left to send.
    int64_t idle_cycles() const {
        if (!taps_.empty()) return 0;
        if (idle_) return NO_END;
        const auto& gap = sequencer();
        bool waits = gap.__PVT__running && gap.__PVT__waiting && gap.__PVT__in_gap && !gap.__PVT__draining;
        if (cycle_ < 0 || !waits || write_busy_ || !during_.empty()) return 0;
        int64_t of_gap = int64_t(gap.__PVT__last) - int64_t(gap.__PVT__waited) - BEFORE_GAP_ENDS;
        int64_t dark = next_edge_ < frame_->edges.size() ? frame_->edges[next_edge_].cycle - cycle_ - 1 : NO_END;
        return std::min(of_gap, dark);
    }
    // Keep `tready` low while there is no beat, and note whether anything moves.
    void watch(bool on) {
        watched_ = on;
        moved_ = false;
        delivered_ = sequencer().__PVT__delivered;
    }
    void remember() { copy_state(before_); }
    // Whether nothing has moved since `watch`, and the state is the one that was remembered.
    bool as_before() {
        copy_state(now_);
        return !moved_ && now_ == before_;
    }
    void skip(int64_t cycles) {
        if (idle_) return;
        cycle_ += cycles;
        sequencer().__PVT__waited += cycles;
        Vcore___024root___eval_settle(core_->rootp);
    }

    // Before the clock edge: the host acts, and outputs go to inputs. beats: whether any subgroup of any sensor sends one.
    void before(bool beats, bool data) {
        host_.handle.resume();
        gather(beats, data);
        aw_ = core_->s_axi_awvalid && core_->s_axi_awready;
        w_ = core_->s_axi_wvalid && core_->s_axi_wready;
        b_ = core_->s_axi_bvalid && core_->s_axi_bready;
        response_ = core_->s_axi_bresp;
        ship(core_->command, IN_command, 0);
        ship(core_->period, IN_period, 1);
        ship(core_->frame, IN_frame, 2);
        ship(core_->timing, IN_timing, 3);
        uint8_t reset = core_->rst | core_->soft_reset;
        ship(reset, IN_rst, 4);
        for_each_stream(*core_, [&](int s, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto&, auto& grant, auto& send) {
            if (send != send_[s]) {
                for (int k = 0; k < int(std::size(IN_send)); k++)
                    for (Lanes& lanes : lanes_[s]) assign(lanes, IN_send[k], send >> k & 1 ? lanes.mask : 0);
                send_[s] = send;
            }
            uint32_t* words = words_of(grant);
            if (std::memcmp(words, grant_[s], sizeof(grant))) {
                std::memcpy(grant_[s], words, sizeof(grant));
                for (Lanes& lanes : lanes_[s]) assign(lanes, IN_grant[0], bits_at(grant_[s], lanes.subgroup - STREAM_FIRST[s]) << low(lanes));
            }
        });
        light(true);
    }

    // Take samples of some subgroups, if anybody wants them.
    void sample() {
        for (auto& [subgroup, samples] : taps_) {
            Place at = place(subgroup);
            samples.resize(samples.size() + SAMPLE_WORDS);
            at.slice->sample(at.lane, samples.data() + samples.size() - SAMPLE_WORDS);
        }
    }
    void tap(int subgroup) { taps_.push_back({subgroup, {}}); }
    void untap() { taps_.clear(); }
    const std::vector<uint64_t>& samples(int number) const { return taps_[number].second; }

    // The slice and the lane of a subgroup.
    struct Place { Slice* slice; int lane; };
    Place place(int subgroup) const {
        const auto& all = lanes_[STREAMS];
        int bit = subgroup + low(all[0]);
        const Lanes& lanes = all[bit / 64];
        return {lanes.slice, lanes.chunk * 64 + bit % 64};
    }

    void edge() { rise(*core_); }

    // After the clock edge.
    void after() {
        light(false);
        if (aw_) core_->s_axi_awvalid = 0;
        if (w_) core_->s_axi_wvalid = 0;
        if (b_) {
            core_->s_axi_bready = 0;
            write_busy_ = false;
            write_response_ = response_;
        }
    }

private:
    static int low(const Lanes& lanes) { return __builtin_ctzll(lanes.mask); }
    static void assign(Lanes& lanes, int word, uint64_t bits) {
        uint64_t& chunk = lanes.slice->chunk(word, lanes.chunk);
        chunk = (chunk & ~lanes.mask) | (bits & lanes.mask);
    }
    static uint64_t bits_at(const uint32_t* words, int bit) {
        uint64_t low = words[bit / 32] | uint64_t(words[bit / 32 + 1]) << 32;
        return bit % 32 ? low >> (bit % 32) | uint64_t(words[bit / 32 + 2]) << (64 - bit % 32) : low;
    }
    static uint64_t of(const Lanes& lanes, int word) { return lanes.slice->chunk(word, lanes.chunk) & lanes.mask; }
    static bool some(const std::vector<Lanes>& all, int word) {
        uint64_t found = 0;
        for (const Lanes& lanes : all) found |= of(lanes, word);
        return found;
    }

    // Set a port that all subgroups share, as far as it has changed.
    template <class T, int N> void ship(T& port, const int (&to)[N], int which) {
        uint32_t* now = words_of(port);
        uint32_t* before = shared_[which];
        if (!std::memcmp(now, before, sizeof(T))) return;
        uint32_t words[SHARED_WORDS] = {};
        std::memcpy(words, now, sizeof(T));
        for (int k = 0; k < N; k++)
            if ((words[k / 32] ^ before[k / 32]) >> (k % 32) & 1)
                for (Lanes& lanes : lanes_[STREAMS]) assign(lanes, to[k], words[k / 32] >> (k % 32) & 1 ? ~0ull : 0);
        std::memcpy(before, words, sizeof(words));
    }

    // Join the subgroups' outputs as the top module does.
    void gather(bool beats, bool data) {
        core_->data = 0;
        if (data) for (int k = 0; k < int(std::size(OUT_data)); k++) core_->data |= uint32_t(some(lanes_[STREAMS], OUT_data[k])) << k;
        core_->gate_late = some(lanes_[STREAMS], OUT_gate_late[0]);
        core_->settings_upset = some(lanes_[STREAMS], OUT_upset[0]);
        for_each_stream(*core_, [&](int s, auto&, auto&, auto&, auto&, auto& stored, auto& record_stored, auto& valid, auto& beat,
                                    auto& beat_controlled, auto&, auto&) {
            list(s, OUT_stored[0], stored, stored_[s]);
            list(s, OUT_record_stored[0], record_stored, record_stored_[s]);
            valid = beats && some(lanes_[s], OUT_valid[0]);
            beat = 0;
            if (valid) for (int k = 0; k < int(std::size(OUT_beat)); k++) beat |= uint64_t(some(lanes_[s], OUT_beat[k])) << k;
            beat_controlled = valid && some(lanes_[s], OUT_beat_controlled[0]);
        });
    }

    // Copy a bit of each subgroup of a stream to a port. set: whether the port has ones now.
    template <class T> void list(int s, int word, T& port, bool& set) {
        bool any = some(lanes_[s], word);
        if (!any && !set) return;
        uint32_t words[GRANT_WORDS] = {};
        for (Lanes& lanes : lanes_[s])
            for (uint64_t rest = of(lanes, word); rest; rest &= rest - 1) {
                int i = lanes.subgroup - STREAM_FIRST[s] + __builtin_ctzll(rest) - low(lanes);
                words[i / 32] |= 1u << (i % 32);
            }
        std::memcpy(words_of(port), words, sizeof(T));
        set = any;
    }

    // The SPADs' edges of a cycle: they come on, and then go off.
    void light(bool on) {
        if (cycle_ < 0 || !frame_) return;
        const std::vector<Edge>& edges = frame_->edges;
        const Lanes* all = lanes_[STREAMS].data();
        int shift = low(*all);
        size_t e = next_edge_;
        for (; e < edges.size() && edges[e].cycle == cycle_; e++) {
            Edge edge = edges[e];
            const Lanes& lanes = all[(edge.subgroup + shift) / 64];
            uint64_t bit = 1ull << ((edge.subgroup + shift) % 64);
            uint64_t& chunk = lanes.slice->chunk(IN_words[edge.bit], lanes.chunk);
            if (on) {
                chunk |= bit;
                for (int flag : FLAGS_OF_words[edge.bit]) lanes.slice->flags()[flag] = 1;
            } else chunk &= ~bit;
        }
        if (!on) next_edge_ = e;
    }

    Vcore_coincid_sequencer& sequencer() const { return core_->rootp->vlSymsp->TOP__coincid_core__sequencer; }

    // Copy the state of the core without its sequencer, which counts the gap.
    void copy_state(std::vector<char>& to) const {
        const char* begin = reinterpret_cast<const char*>(core_->rootp->vlSymsp);
        const char* counts = reinterpret_cast<const char*>(&sequencer());
        to.assign(begin, counts);
        to.insert(to.end(), counts + sizeof(Vcore_coincid_sequencer), begin + sizeof(Vcore__Syms));
    }

    void begin_write(uint32_t address, uint32_t value) {
        core_->s_axi_awaddr = address;
        core_->s_axi_wdata = value;
        core_->s_axi_wstrb = 15;
        core_->s_axi_awvalid = core_->s_axi_wvalid = core_->s_axi_bready = 1;
        write_busy_ = true;
        write_response_ = 0;
    }

    // The host: reset, then whatever is posted, one after the other. It gives the rest up if the sensor refuses an access.
    Host play() {
        for (int i = 0; i < RESET_CYCLES; i++) co_await CYCLE;
        core_->rst = 0;
        for (int i = 0; i < RESET_CYCLES; i++) co_await CYCLE;
        for (;;) {
            if (todo_.empty() || outcome_) {
                todo_.clear();
                idle_ = true;
                co_await CYCLE;
                continue;
            }
            Op op = std::move(todo_.front());
            todo_.pop_front();
            if (op.kind == Op::READ || op.kind == Op::WAIT) {
                do {
                    core_->s_axi_araddr = op.address;
                    core_->s_axi_arvalid = core_->s_axi_rready = 1;
                    for (bool answered = false; !answered;) {
                        bool taken = core_->s_axi_arvalid && core_->s_axi_arready;
                        answered = core_->s_axi_rvalid;
                        if (answered) {
                            value_ = core_->s_axi_rdata;
                            if (core_->s_axi_rresp) outcome_ = REFUSED;
                        }
                        co_await CYCLE;
                        if (taken) core_->s_axi_arvalid = 0;
                        if (answered) core_->s_axi_rready = 0;
                    }
                } while (op.kind == Op::WAIT && !(value_ & op.value) && !outcome_);
                continue;
            }
            begin_write(op.address, op.value);
            if (op.kind == Op::WRITE) {
                while (write_busy_) co_await CYCLE;
                if (write_response_) outcome_ = REFUSED;
                continue;
            }
            frame_ = op.frame;
            next_edge_ = 0;
            records_.push_back(std::make_unique<Record>());
            Record& record = *records_.back();
            bool ended[STREAMS] = {};
            while (!core_->laser && !outcome_) {
                co_await CYCLE;
                if (!write_busy_ && write_response_) outcome_ = REFUSED;
            }
            for (cycle_ = 0; !outcome_; cycle_++) {
                bool ready = frame_->ready(cycle_);
                bool all_ended = true;
                if (watched_) moved_ |= sequencer().__PVT__delivered != delivered_;
                for_each_stream(*core_, [&](int s, auto& tdata, auto& tvalid, auto& tready, auto& tlast, auto&...) {
                    tready = ready && (tvalid || !watched_);
                    moved_ |= tvalid;
                    if (ready && tvalid && !ended[s]) {
                        record.beats[s].push_back({tdata, cycle_});
                        ended[s] = tlast;
                    }
                    all_ended &= ended[s];
                });
                if (!write_busy_ && !during_.empty()) {
                    begin_write(during_.front().address, during_.front().value);
                    during_.pop_front();
                }
                for (Lanes& lanes : lanes_[STREAMS])
                    for (uint64_t rest = of(lanes, OUT_stored[0]); rest; rest &= rest - 1)
                        record.commits.push_back({lanes.subgroup + __builtin_ctzll(rest) - low(lanes), cycle_ - STORED_TO_COMMIT});
                co_await CYCLE;
                if (all_ended) break;
                if (cycle_ + 1 >= frame_->limit) {
                    outcome_ = HANGS;
                    hung_ = cycle_ + 1;
                }
            }
            cycles_ += cycle_ + 1;
            cycle_ = -1;
            frame_.reset();
            during_.clear();
            while (write_busy_) co_await CYCLE;
            for_each_stream(*core_, [&](int, auto&, auto&, auto& tready, auto&...) { tready = 0; });
        }
    }

    VerilatedContext context_;
    std::unique_ptr<Vcore> core_;
    std::vector<Lanes> lanes_[STREAMS + 1];
    uint32_t shared_[5][SHARED_WORDS] = {}, grant_[STREAMS][GRANT_WORDS] = {};
    uint8_t send_[STREAMS] = {};
    bool stored_[STREAMS] = {}, record_stored_[STREAMS] = {};
    bool aw_ = false, w_ = false, b_ = false, write_busy_ = false, idle_ = false;
    int response_ = 0, write_response_ = 0;
    std::deque<Op> todo_, during_;
    std::shared_ptr<Frame> frame_;
    size_t next_edge_ = 0;             // of the frame
    int64_t cycle_ = -1, cycles_ = 0;  // of the frame, and of all frames before
    int64_t hung_ = 0;                 // cycles of the frame that hangs
    // While it is watched whether the sensor is idle.
    bool watched_ = false, moved_ = false, delivered_ = false;
    std::vector<char> before_, now_;
    uint32_t value_ = 0;
    Outcome outcome_ = FINE;
    std::vector<std::unique_ptr<Record>> records_;
    std::vector<std::pair<int, std::vector<uint64_t>>> taps_;
    Host host_;
};

class Engine {
public:
    explicit Engine(int sensors) {
        int chunks = first_chunk(sensors - 1) + CHUNKS_EACH;
        for (int k = 0; k < (chunks + CHUNKS - 1) / CHUNKS; k++) slices_.push_back(std::make_unique<Slice>());
        for (int k = 0; k < sensors; k++) sensors_.push_back(std::make_unique<Sensor>(k, slices_));
    }

    Sensor& sensor(int number) { return *sensors_[number]; }

    // Cycles of frames that were played, summed over the sensors.
    int64_t cycles() const {
        int64_t sum = 0;
        for (auto& sensor : sensors_) sum += sensor->cycles();
        return sum;
    }

    // Go on for some cycles, or until no sensor has anything to do; return how many have.
    int run(int64_t cycles) {
        for (int64_t k = 0; k < cycles && busy(); k++) step();
        return busy();
    }

    // The same, but idle cycles of gaps are skipped and do not count.
    int run_busy(int64_t cycles) {
        for (int64_t k = 0; k < cycles && busy(); k++) {
            step();
            if (k % LOOK_EVERY == 0 && idle_cycles() >= 2 * IDLE_PERIOD) k += skip_idle();
        }
        return busy();
    }

private:
    int busy() const {
        int busy = 0;
        for (auto& sensor : sensors_) busy += !sensor->idle();
        return busy;
    }

    // Cycles from the next one on in which all sensors are idle, if they have nothing left to send.
    int64_t idle_cycles() const {
        int64_t cycles = NO_END;
        for (auto& sensor : sensors_) cycles = std::min(cycles, sensor->idle_cycles());
        return cycles;
    }

    // Play IDLE_PERIOD cycles. If the state is the same then, it will be after each further IDLE_PERIOD: skip as many of
    // them as there are in the gap. Return the cycles that were played.
    int64_t skip_idle() {
        for (auto& sensor : sensors_) sensor->watch(true);
        step();  // with `tready` low
        std::vector<std::vector<W>> before;
        for (auto& slice : slices_) before.emplace_back(&slice->word(0), &slice->word(0) + SLICE_WORDS);
        for (auto& sensor : sensors_) sensor->remember();
        for (int64_t k = 0; k < IDLE_PERIOD; k++) step();
        bool idle = true;
        for (auto& sensor : sensors_) idle &= sensor->as_before();
        for (size_t k = 0; k < slices_.size(); k++)
            idle &= !std::memcmp(before[k].data(), &slices_[k]->word(0), sizeof(W) * SLICE_WORDS);
        int64_t rest = idle_cycles() / IDLE_PERIOD * IDLE_PERIOD;
        for (auto& sensor : sensors_) {
            if (idle && rest > 0) sensor->skip(rest);
            sensor->watch(false);
        }
        return 1 + IDLE_PERIOD;
    }

    // One clock edge of all sensors.
    void step() {
        bool beats = false, data = false;
        for (auto& slice : slices_) {
            beats |= any(slice->word(OUT_valid[0]));
            W bits = ZEROS;
            for (int word : OUT_data) bits |= slice->word(word);
            data |= any(bits);
        }
        for (auto& sensor : sensors_) sensor->before(beats, data);
        for (auto& sensor : sensors_) sensor->sample();
        for (auto& sensor : sensors_) sensor->edge();
        for (auto& slice : slices_) {
            slice->pass();
            std::memset(slice->flags(), 0, SLICE_FLAGS);
        }
        for (auto& sensor : sensors_) sensor->after();
    }

    std::vector<std::unique_ptr<Slice>> slices_;
    std::vector<std::unique_ptr<Sensor>> sensors_;
};

}  // namespace

extern "C" {
Engine* sliced_new(int sensors) { return new Engine(sensors); }
void sliced_delete(Engine* engine) { delete engine; }
int64_t sliced_cycles(Engine* engine) { return engine->cycles(); }
int sliced_run(Engine* engine, int64_t cycles) { return engine->run(cycles); }
int sliced_run_busy(Engine* engine, int64_t cycles) { return engine->run_busy(cycles); }
void sliced_write(Engine* engine, int sensor, uint32_t address, uint32_t value) {
    engine->sensor(sensor).post({Op::WRITE, address, value, {}});
}
void sliced_read(Engine* engine, int sensor, uint32_t address) { engine->sensor(sensor).post({Op::READ, address, 0, {}}); }
void sliced_wait(Engine* engine, int sensor, uint32_t address, uint32_t mask) {
    engine->sensor(sensor).post({Op::WAIT, address, mask, {}});
}

// A frame that a write starts. Edge k is in cycle[k] at bit[k] (pixel * phases + phase) of subgroup[k], in any order.
void sliced_frame(Engine* engine, int sensor, uint32_t address, uint32_t value, int64_t edges, const int64_t* cycle,
                  const int64_t* subgroup, const int64_t* bit, const uint8_t* receiver, int64_t receiver_cycles, int64_t link_beats,
                  int64_t link_cycles, int64_t limit) {
    auto frame = std::make_shared<Frame>();
    *frame = {std::vector<Edge>(edges), {receiver, receiver + receiver_cycles}, {link_beats, link_cycles}, limit};
    for (int64_t k = 0; k < edges; k++) frame->edges[k] = {cycle[k], int32_t(bit[k]), int32_t(subgroup[k])};
    std::stable_sort(frame->edges.begin(), frame->edges.end(), [](const Edge& a, const Edge& b) { return a.cycle < b.cycle; });
    engine->sensor(sensor).post({Op::FRAME, address, value, frame});
}
void sliced_write_during_frame(Engine* engine, int sensor, uint32_t address, uint32_t value) {
    engine->sensor(sensor).post_during_frame(address, value);
}
void sliced_reset(Engine* engine, int sensor) { engine->sensor(sensor).reset(); }
void sliced_give_up(Engine* engine, int sensor) { engine->sensor(sensor).give_up(); }
int sliced_outcome(Engine* engine, int sensor) { return engine->sensor(sensor).outcome(); }
uint32_t sliced_value(Engine* engine, int sensor) { return engine->sensor(sensor).value(); }
int64_t sliced_cycle(Engine* engine, int sensor) { return engine->sensor(sensor).cycle(); }
int64_t sliced_hung(Engine* engine, int sensor) { return engine->sensor(sensor).hung(); }
int64_t sliced_records(Engine* engine, int sensor) { return int64_t(engine->sensor(sensor).records().size()); }
int64_t sliced_beats(Engine* engine, int sensor, int64_t record, int stream, const Beat** beats) {
    const auto& found = engine->sensor(sensor).records()[record]->beats[stream];
    *beats = found.data();
    return int64_t(found.size());
}
int64_t sliced_commits(Engine* engine, int sensor, int64_t record, const Commit** commits) {
    const auto& found = engine->sensor(sensor).records()[record]->commits;
    *commits = found.data();
    return int64_t(found.size());
}
void sliced_tap(Engine* engine, int sensor, int subgroup) { engine->sensor(sensor).tap(subgroup); }
void sliced_untap(Engine* engine, int sensor) { engine->sensor(sensor).untap(); }
int64_t sliced_samples(Engine* engine, int sensor, int number, const uint64_t** samples) {
    const auto& found = engine->sensor(sensor).samples(number);
    *samples = found.data();
    return int64_t(found.size()) / SAMPLE_WORDS;
}

// The words of the slice that plays a subgroup, and its lane there.
uint64_t* sliced_words(Engine* engine, int sensor, int subgroup, int* lane) {
    auto at = engine->sensor(sensor).place(subgroup);
    *lane = at.lane;
    return &at.slice->chunk(0, 0);
}
void sliced_forget(Engine* engine, int sensor) { engine->sensor(sensor).forget(); }
}
