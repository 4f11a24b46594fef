// SPDX-License-Identifier: Apache-2.0
// Sensors in the lanes of a slice, and hosts that use them: a host programs its sensor, starts frames, takes the streams, and
// writes the settings again if the sensor reports an error. Either every lane has a host and an upset of its own, or one
// host plays all lanes at once and notes those that differ from its own. `lanes.py` has the Python side.
#include <coroutine>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "lanes.h"
#include "wiring.h"

namespace {

constexpr int ANSWER_CYCLES = 200;  // of the register bus, at most
constexpr int LASER_CYCLES = 100;   // from a start's answer to the frame's first cycle, at most
constexpr int QUIET_CYCLES = 40;    // of a stream that has said all it had to say
constexpr int RESET_CYCLES = 4;
constexpr int FRAMES = 3;           // of a trial
constexpr int STARTS = 3;           // of a trial, before a refused one counts as a frame
constexpr int AFTER = FRAMES;       // in a row: not a frame, but whether the settings read as they were written
enum Outcome { FINE = 0, BUS_WAITS, NEVER_DONE, REFUSED, NO_LASER, WITHOUT_LAST, NOISY };
enum Status : uint32_t { BUSY = 1, DONE = 2 };

struct Edge { int64_t cycle; int32_t subgroup, bit; };
struct Access { uint32_t address, value; };
struct Recipe {
    std::vector<Access> settings;
    std::vector<Edge> edges;
    std::vector<uint8_t> ready;
    int64_t frame_cycles;
    int64_t limit;  // cycles within which a frame ends, whatever an upset did to it
};
struct Beat { uint64_t data; int64_t cycle; };
struct Shown {
    std::vector<Beat> beats[STREAMS];
    std::vector<int64_t> lasers;
    uint64_t gates = 0;
};
struct Row { int32_t trial, frame, outcome, shown, write, cycles; };  // write: whether an access was under way when it flipped
struct Upset { int32_t word; int64_t cycle; };  // the flip-flop's word; the edge after which it flips

// A part of a host's program. It returns an outcome to the part that awaits it.
struct Task {
    struct promise_type {
        int value = FINE;
        std::coroutine_handle<> caller = std::noop_coroutine();
        Task get_return_object() { return Task(std::coroutine_handle<promise_type>::from_promise(*this)); }
        std::suspend_always initial_suspend() { return {}; }
        struct Return {
            bool await_ready() noexcept { return false; }
            std::coroutine_handle<> await_suspend(std::coroutine_handle<promise_type> task) noexcept { return task.promise().caller; }
            void await_resume() noexcept {}
        };
        Return final_suspend() noexcept { return {}; }
        void return_value(int outcome) { value = outcome; }
        void unhandled_exception() { std::abort(); }
    };
    std::coroutine_handle<promise_type> handle;

    Task() = default;
    explicit Task(std::coroutine_handle<promise_type> of) : handle(of) {}
    Task(Task&& other) : handle(std::exchange(other.handle, {})) {}
    Task& operator=(Task&& other) { std::swap(handle, other.handle); return *this; }
    ~Task() { if (handle) handle.destroy(); }
    bool await_ready() const { return false; }
    std::coroutine_handle<> await_suspend(std::coroutine_handle<> by) { handle.promise().caller = by; return handle; }
    int await_resume() const { return handle.promise().value; }
};

class Host {
public:
    // lane: whose outputs it reads. lanes: whose inputs it sets.
    Host(Slice& slice, int lane, W lanes) : slice_(slice), lane_(lane), lanes_(lanes) {}

    void begin(Task task) {
        task_ = std::move(task);
        next_ = task_.handle;
    }
    void resume() { next_.resume(); }
    bool idle() const { return !task_.handle || task_.handle.done(); }

    Task reset() {
        put(IN_rst, 1);
        for (int i = 0; i < RESET_CYCLES; i++) co_await step();
        put(IN_rst, 0);
        for (int i = 0; i < RESET_CYCLES; i++) co_await step();
        co_return FINE;
    }

    Task write(uint32_t address, uint32_t value) {
        Busy writing(writing_);
        put(IN_s_axi_awaddr, address);
        put(IN_s_axi_wdata, value);
        put(IN_s_axi_wstrb, 15);
        bool address_waits = true, data_waits = true, answered = false;
        for (int cycle = 0; cycle < ANSWER_CYCLES; cycle++) {
            put(IN_s_axi_awvalid, address_waits);
            put(IN_s_axi_wvalid, data_waits);
            put(IN_s_axi_bready, !answered);
            if (answered && !address_waits && !data_waits) co_return FINE;
            bool answers = !answered && get(OUT_s_axi_bvalid);
            if (answers) response_ = get(OUT_s_axi_bresp);
            bool address_goes = get(OUT_s_axi_awready), data_goes = get(OUT_s_axi_wready);
            co_await step();
            address_waits &= !address_goes;
            data_waits &= !data_goes;
            answered |= answers;
        }
        co_return BUS_WAITS;
    }

    Task read(uint32_t address) {
        put(IN_s_axi_araddr, address);
        bool address_waits = true, answered = false;
        for (int cycle = 0; cycle < ANSWER_CYCLES; cycle++) {
            put(IN_s_axi_arvalid, address_waits);
            put(IN_s_axi_rready, !answered);
            if (answered && !address_waits) co_return FINE;
            bool answers = !answered && get(OUT_s_axi_rvalid);
            if (answers) {
                value_ = get(OUT_s_axi_rdata);
                response_ = get(OUT_s_axi_rresp);
            }
            bool address_goes = get(OUT_s_axi_arready);
            co_await step();
            address_waits &= !address_goes;
            answered |= answers;
        }
        co_return BUS_WAITS;
    }

    Task program(const Recipe& of) {
        for (Access access : of.settings)
            if (int broken = co_await write(access.address, access.value)) co_return broken;
        co_return FINE;
    }

    // Start a frame and take its output. If the sensor reports an error, the host clears it and writes all settings again.
    Task frame(const Recipe& of, Shown& shown) {
        if (int broken = co_await write(CONTROL, START)) co_return broken;
        if (response_) {
            if (int broken = co_await read(STATUS)) co_return broken;
            if (int broken = co_await write(STATUS, ~0u)) co_return broken;
            if (int broken = co_await program(of)) co_return broken;
            co_return REFUSED;
        }
        int outcome = FINE;
        for (int wait = 0; !get(OUT_laser); wait++) {
            if (wait == LASER_CYCLES) {
                outcome = NO_LASER;
                break;
            }
            co_await step();
        }
        bool ended[STREAMS] = {};
        size_t next = 0, dark = 0;
        bool all_ended = false;
        for (int64_t cycle = 0; !(all_ended && cycle >= of.frame_cycles) && cycle < of.limit && !outcome; cycle++) {
            for (; dark < next; dark++) light(of.edges[dark], false);
            for (; next < of.edges.size() && of.edges[next].cycle == cycle; next++) light(of.edges[next], true);
            bool ready = cycle >= int64_t(of.ready.size()) || of.ready[cycle];
            all_ended = true;
            for (int s = 0; s < STREAMS; s++) {
                put(TREADY[s], ready);
                if (ready && bit(TVALID[s])) {
                    shown.beats[s].push_back({number(TDATA[s], 64), cycle});
                    ended[s] |= bit(TLAST[s]);
                }
                all_ended &= ended[s];
            }
            if (get(OUT_laser)) shown.lasers.push_back(cycle);
            shown.gates = (shown.gates ^ get(OUT_spad_gate)) * 0x9E3779B97F4A7C15u + 1;
            co_await step();
        }
        for (; dark < next; dark++) light(of.edges[dark], false);
        if (!outcome && !all_ended) outcome = WITHOUT_LAST;
        // Then the status shows it.
        for (int64_t wait = 0; wait <= of.limit; wait++) {
            if (int broken = co_await read(STATUS)) co_return broken;
            if (!(value_ & BUSY)) break;
            if (wait == of.limit) co_return NEVER_DONE;
        }
        uint32_t status = value_;
        bool after = false;
        for (int64_t wait = 0, quiet = 0; quiet < QUIET_CYCLES; wait++, quiet++) {
            for (int s = 0; s < STREAMS; s++) {
                put(TREADY[s], true);
                if (bit(TVALID[s])) {
                    after = true;
                    quiet = 0;
                }
            }
            co_await step();
            if (wait > of.limit) co_return NEVER_DONE;
        }
        for (int s = 0; s < STREAMS; s++) put(TREADY[s], false);
        if (status & ~uint32_t(BUSY | DONE)) {
            if (int broken = co_await write(STATUS, ~0u)) co_return broken;
            if (int broken = co_await program(of)) co_return broken;
            if (!outcome) outcome = NOISY;
        } else if (int broken = co_await write(STATUS, DONE)) co_return broken;
        if (!outcome && (after || !(status & DONE))) outcome = NOISY;
        co_return outcome;
    }

    // Return whether every setting reads as it was written.
    Task check(const Recipe& of) {
        for (Access access : of.settings) {
            if (int broken = co_await read(access.address)) co_return broken;
            if (value_ != access.value || response_) co_return NOISY;
        }
        co_return FINE;
    }

    Task idle(int64_t cycles) {
        for (int64_t i = 0; i < cycles; i++) co_await step();
        co_return FINE;
    }

    // After the clock edge, registers flip.
    void upset(Upset upset) {
        upset_ = upset;
        upset_write_ = false;
        edges_ = 0;
    }
    void edge() {
        if (edges_++ != upset_.cycle) return;
        slice_.put(upset_.word, lane_, !slice_.get(upset_.word, lane_));
        upset_write_ = writing_;
    }
    bool upset_write() const { return upset_write_; }
    int64_t edges() const { return edges_; }

private:
    // Tells that something goes on, as long as it exists.
    struct Busy {
        bool& flag;
        explicit Busy(bool& of) : flag(of) { flag = true; }
        ~Busy() { flag = false; }
    };
    // The program goes on after the next clock edge.
    struct Step {
        Host& host;
        bool await_ready() { return false; }
        void await_suspend(std::coroutine_handle<> program) { host.next_ = program; }
        void await_resume() {}
    };
    Step step() { return {*this}; }

    bool bit(int word) { return slice_.get(word, lane_); }
    uint64_t number(const int* words, int bits) {
        uint64_t value = 0;
        for (int k = 0; k < bits; k++) value |= uint64_t(bit(words[k])) << k;
        return value;
    }
    template <int N> uint64_t get(const int (&words)[N]) { return number(words, N); }
    void put(int word, bool value) {
        W& now = slice_.word(word);
        now = value ? now | lanes_ : now & ~lanes_;
    }
    template <int N> void put(const int (&words)[N], uint64_t value) {
        for (int k = 0; k < N; k++) put(words[k], value >> k & 1);
    }
    void light(const Edge& edge, bool on) { put(SPADS[edge.subgroup][edge.bit], on); }

    Slice& slice_;
    int lane_;
    W lanes_;
    Task task_;
    std::coroutine_handle<> next_;
    uint32_t value_ = 0;
    int response_ = 0;
    bool writing_ = false, upset_write_ = false;
    Upset upset_ = {0, -1};
    int64_t edges_ = 0;
};

class Lanes {
public:
    void recipe(Recipe recipe) { recipes_.push_back(std::move(recipe)); }

    // Reset a sensor, program it and play every frame, then the first one again; trials begin where this ends.
    void warm_up() {
        Host host(slice_, 0, ONES);
        host.begin(warmed_up(host));
        slice_.settle();
        while (!host.idle()) {
            host.resume();
            pass({&host, 1});
        }
        start_.resize(SAMPLE_WORDS);
        slice_.sample(0, start_.data());
    }

    // Play trials, each in the next lane that has nothing to do.
    void run(const Upset* upsets, int n) {
        std::vector<Host> hosts;
        for (int lane = 0; lane < LANES; lane++) hosts.emplace_back(slice_, lane, only(lane));
        int next = 0;
        for (bool busy = true; busy;) {
            busy = false;
            for (int lane = 0; lane < LANES; lane++) {
                Host& host = hosts[lane];
                if (host.idle() && next < n) {
                    slice_.restore(lane, start_.data());
                    host.upset(upsets[next]);
                    host.begin(trial(host, next++));
                }
                if (!host.idle()) host.resume();
                busy |= !host.idle() || next < n;
            }
            pass(hosts);
        }
    }

    std::vector<Row>& rows() { return rows_; }
    const Shown& shown(int number) const { return *shown_[number]; }

private:
    Task warmed_up(Host& host) {
        co_await host.reset();
        if (int broken = co_await host.program(recipes_[0])) co_return broken;
        for (int frame : {0, 1, 2, 0}) co_await play(host, -1, frame);
        co_return FINE;
    }

    // One flip-flop flips in the first frame, in its start, or in between. A start that is refused is tried again.
    Task trial(Host& host, int number) {
        for (int frame = 0, starts = 1; frame < FRAMES;) {
            int outcome = co_await play(host, number, frame);
            if (outcome == BUS_WAITS || outcome == NEVER_DONE) co_return outcome;
            if (outcome == REFUSED && starts < STARTS) starts++;
            else frame++;
        }
        int outcome = co_await host.check(recipes_[0]);
        note(host, number, AFTER, outcome, {}, host.edges());
        co_return outcome;
    }

    Task play(Host& host, int number, int frame) {
        Shown shown;
        int64_t begin = host.edges();
        int outcome = co_await host.frame(recipes_[frame], shown);
        co_await host.idle(GAP);
        note(host, number, frame, outcome, shown, begin);
        co_return outcome;
    }

    void note(const Host& host, int trial, int frame, int outcome, const Shown& shown, int64_t begin) {
        // Few frames differ from all before.
        std::string key(reinterpret_cast<const char*>(&shown.gates), sizeof(shown.gates));
        auto add = [&](const auto& list) { key += std::string(reinterpret_cast<const char*>(list.data()), list.size() * sizeof(list[0])) + '/'; };
        for (const auto& beats : shown.beats) add(beats);
        add(shown.lasers);
        auto [found, added] = numbers_.try_emplace(std::move(key), int(shown_.size()));
        if (added) shown_.push_back(std::make_unique<Shown>(shown));
        rows_.push_back({trial, frame, outcome, found->second, host.upset_write(), int32_t(host.edges() - begin)});
    }

    // A clock edge of all lanes.
    void pass(std::span<Host> hosts) {
        slice_.pass();
        for (Host& host : hosts) host.edge();
        slice_.settle();
    }

    static W only(int lane) {
        W lanes = ZEROS;
        reinterpret_cast<uint64_t*>(&lanes)[lane / 64] = uint64_t(1) << (lane % 64);
        return lanes;
    }

    Slice slice_;
    std::vector<Recipe> recipes_;
    std::vector<uint64_t> start_;  // the lane's words
    std::vector<Row> rows_;
    std::vector<std::unique_ptr<Shown>> shown_;
    std::map<std::string, int> numbers_;
};

}  // namespace

extern "C" {
Lanes* lanes_new() { return new Lanes(); }
void lanes_delete(Lanes* lanes) { delete lanes; }
void lanes_recipe(Lanes* lanes, int64_t settings, const Access* accesses, int64_t edges, const int64_t* cycle, const int64_t* subgroup, const int64_t* bit,
                  int64_t ready_cycles, const uint8_t* ready, int64_t frame_cycles, int64_t limit) {
    Recipe recipe{{accesses, accesses + settings}, {}, {ready, ready + ready_cycles}, frame_cycles, limit};
    for (int64_t k = 0; k < edges; k++) recipe.edges.push_back({cycle[k], int32_t(subgroup[k]), int32_t(bit[k])});
    lanes->recipe(std::move(recipe));
}
void lanes_warm_up(Lanes* lanes) { lanes->warm_up(); }
void lanes_run(Lanes* lanes, const Upset* upsets, int n) { lanes->run(upsets, n); }
int64_t lanes_rows(Lanes* lanes, const Row** rows) {
    *rows = lanes->rows().data();
    return int64_t(lanes->rows().size());
}
void lanes_forget(Lanes* lanes) { lanes->rows().clear(); }
int64_t lanes_beats(Lanes* lanes, int shown, int stream, const Beat** beats) {
    const auto& found = lanes->shown(shown).beats[stream];
    *beats = found.data();
    return int64_t(found.size());
}
int64_t lanes_lasers(Lanes* lanes, int shown, const int64_t** lasers) {
    const auto& found = lanes->shown(shown).lasers;
    *lasers = found.data();
    return int64_t(found.size());
}
uint64_t lanes_gates(Lanes* lanes, int shown) { return lanes->shown(shown).gates; }
}
