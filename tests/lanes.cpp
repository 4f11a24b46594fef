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
constexpr uint32_t RESET = 16;
constexpr int FRAMES = 3;           // of a trial
constexpr int STARTS = 3;           // of a trial, before a refused one counts as a frame
constexpr int AFTER = FRAMES;       // in a row: not a frame, but whether the settings read as they were written
enum Outcome { FINE = 0, BUS_WAITS, NEVER_DONE, REFUSED, NO_LASER, WITHOUT_LAST, NOISY };
enum Status : uint32_t { BUSY = 1, DONE = 2 };

struct Edge { int64_t cycle; int32_t subgroup, bit; };
// strobe: of the bytes to write; 0: it is a read; RESET: it is none, but the sensor is reset. skew: cycles by which the data come after the address, or before it if
// negative. hold: cycles until the answer is taken.
struct Access {
    uint32_t address, value, strobe;
    int32_t skew, hold;
};
// word: of the flip-flop; cycle: the edge after which it flips, or takes the value of the flip-flop `source`, if that is one.
struct Upset { int32_t word; int64_t cycle; int32_t source; };
struct Recipe {
    std::vector<Access> settings, during, after, beside;  // beside: those after, by the other host
    std::vector<Upset> upsets;
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
    // bus: another host, which accesses registers while a frame is running.
    Host(Slice& slice, int lane, W lanes, Host* bus = nullptr) : slice_(slice), lane_(lane), lanes_(lanes), bus_(bus) {}

    void begin(Task task) {
        task_ = std::move(task);
        next_ = task_.handle;
    }
    void resume() { if (!idle()) next_.resume(); }
    bool idle() const { return !task_.handle || task_.handle.done(); }

    Task reset() {
        put(IN_rst, 1);
        for (int i = 0; i < RESET_CYCLES; i++) co_await step();
        put(IN_rst, 0);
        for (int i = 0; i < RESET_CYCLES; i++) co_await step();
        co_return FINE;
    }

    Task write(uint32_t address, uint32_t value) { return access({address, value, 15, 0, 0}); }
    Task read(uint32_t address) { return access({address, 0, 0, 0, 0}); }

    Task access(Access of) {
        if (of.strobe == RESET) {
            was_reset_ = true;
            co_return co_await reset();
        }
        Busy writing(writing_, of.strobe);
        if (of.strobe) {
            put(IN_s_axi_awaddr, of.address);
            put(IN_s_axi_wdata, of.value);
            put(IN_s_axi_wstrb, of.strobe);
        } else put(IN_s_axi_araddr, of.address);
        bool address_waits = true, data_waits = of.strobe, answered = false;
        for (int cycle = 0; cycle < ANSWER_CYCLES; cycle++) {
            bool address_valid = address_waits && cycle >= -of.skew, data_valid = data_waits && cycle >= of.skew, ready = !answered && cycle >= of.hold;
            if (of.strobe) {
                put(IN_s_axi_awvalid, address_valid);
                put(IN_s_axi_wvalid, data_valid);
                put(IN_s_axi_bready, ready);
            } else {
                put(IN_s_axi_arvalid, address_valid);
                put(IN_s_axi_rready, ready);
            }
            if (answered && !address_waits && !data_waits) co_return FINE;
            bool answers = ready && get(of.strobe ? OUT_s_axi_bvalid : OUT_s_axi_rvalid);
            if (answers) {
                response_ = get(of.strobe ? OUT_s_axi_bresp : OUT_s_axi_rresp);
                if (!of.strobe) value_ = get(OUT_s_axi_rdata);
            }
            bool address_goes = address_valid && get(of.strobe ? OUT_s_axi_awready : OUT_s_axi_arready);
            bool data_goes = data_valid && get(OUT_s_axi_wready);
            co_await step();
            address_waits &= !address_goes;
            data_waits &= !data_goes;
            answered |= answers;
        }
        co_return BUS_WAITS;
    }

    Task accesses(const std::vector<Access>& all) {
        for (const Access& one : all)
            if (int broken = co_await access(one)) co_return broken;
        co_return FINE;
    }

    // Start a frame and take its output. If the sensor reports an error, the host clears it and writes all settings again.
    Task frame(const Recipe& of, Shown& shown) {
        if (int broken = co_await write(CONTROL, START)) co_return broken;
        if (response_) {
            if (int broken = co_await read(STATUS)) co_return broken;
            if (int broken = co_await write(STATUS, ~0u)) co_return broken;
            if (int broken = co_await accesses(of.settings)) co_return broken;
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
        if (bus_) {
            bus_->was_reset_ = false;
            bus_->begin(bus_->accesses(of.during));
        }
        bool ended[STREAMS] = {};
        size_t next = 0, dark = 0;
        bool all_ended = false;
        for (int64_t cycle = 0; !(all_ended && cycle >= of.frame_cycles) && cycle < of.limit && !outcome; cycle++) {
            if (bus_ && bus_->was_reset_) break;
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
        while (bus_ && !bus_->idle()) co_await step();
        if (outcome == NO_LASER) for (int s = 0; s < STREAMS; s++) put(TREADY[s], true);  // such a frame has to end, too
        // Then the status shows it.
        for (int64_t begin = edges_;;) {
            if (int broken = co_await read(STATUS)) co_return broken;
            if (!(value_ & BUSY)) break;
            if (edges_ - begin > of.limit) co_return NEVER_DONE;
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
            if (int broken = co_await accesses(of.settings)) co_return broken;
            if (!outcome) outcome = NOISY;
        } else if (int broken = co_await write(STATUS, DONE)) co_return broken;
        if (!outcome && (after || !(status & DONE))) outcome = NOISY;
        co_return outcome;
    }

    // Return whether every setting reads as it was written.
    Task check(const Recipe& of) {
        for (const Access& setting : of.settings) {
            if (int broken = co_await read(setting.address)) co_return broken;
            if (value_ != setting.value || response_) co_return NOISY;
        }
        co_return FINE;
    }

    Task idle(int64_t cycles) {
        for (int64_t i = 0; i < cycles; i++) co_await step();
        co_return FINE;
    }

    // After clock edges, counted from now on, registers flip.
    void upset(std::span<const Upset> upsets) {
        upsets_ = upsets;
        upset_write_ = false;
        edges_ = 0;
    }
    void edge() {
        for (; !upsets_.empty() && upsets_.front().cycle == edges_; upsets_ = upsets_.subspan(1)) {
            const Upset& one = upsets_.front();
            W& word = slice_.word(one.word);
            word = one.source < 0 ? word ^ lanes_ : (word & ~lanes_) | (slice_.word(one.source) & lanes_);
            upset_write_ = writing_;
        }
        edges_++;
    }
    bool upset_write() const { return upset_write_; }
    int64_t edges() const { return edges_; }

private:
    // Tells that something goes on, as long as it exists.
    struct Busy {
        bool& flag;
        Busy(bool& of, bool on) : flag(of) { flag = on; }
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
    Host* bus_;
    Task task_;
    std::coroutine_handle<> next_;
    uint32_t value_ = 0;
    int response_ = 0;
    bool writing_ = false, upset_write_ = false, was_reset_ = false;
    std::span<const Upset> upsets_;
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
                    host.upset({upsets + next, 1});
                    host.begin(trial(host, next++));
                }
                host.resume();
                busy |= !host.idle() || next < n;
            }
            pass(hosts);
        }
    }

    // Let one host play all lanes: every frame, and all accesses. watched: words of registers that count as outputs do.
    // differs[lane]: the recipe at which the lane begins to differ from lane 0, or -1.
    void together(const int32_t* watched, int n, int32_t* differs) {
        Host bus(slice_, 0, ONES), host(slice_, 0, ONES, &bus);
        host.begin(session(host, bus));
        slice_.settle();
        std::fill_n(differs, LANES, -1);
        while (!host.idle()) {
            host.resume();
            bus.resume();
            W now = unlike_outputs() | unlike(watched, n);
            if (any(now & ~different_)) {
                different_ |= now;
                for (int lane = 0; lane < LANES; lane++)
                    if (differs[lane] < 0 && any(now & only(lane))) differs[lane] = recipe_;
            }
            pass({&host, 1});
        }
    }
    W& word(int number) { return slice_.word(number); }

    std::vector<Row>& rows() { return rows_; }
    const Shown& shown(int number) const { return *shown_[number]; }

private:
    Task warmed_up(Host& host) {
        co_await host.reset();
        if (int broken = co_await host.accesses(recipes_[0].settings)) co_return broken;
        for (int frame : {0, 1, 2, 0}) co_await play(host, -1, frame);
        co_return FINE;
    }

    Task session(Host& host, Host& bus) {
        co_await host.reset();
        for (recipe_ = 0; recipe_ < int(recipes_.size()); recipe_++) {
            const Recipe& of = recipes_[recipe_];
            co_await host.accesses(of.settings);
            host.upset(of.upsets);
            int outcome = co_await play(host, recipe_, recipe_);
            bool broken = outcome == BUS_WAITS || outcome == NEVER_DONE;
            bus.begin(bus.accesses(of.beside));
            if (!broken) broken = co_await host.accesses(of.after);
            while (!bus.idle()) co_await host.idle(1);
            if (broken) co_await host.reset();
        }
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

    // Lanes that show something else than lane 0, where it counts.
    W unlike_outputs() {
        W found = unlike(OUT_laser) | unlike(OUT_spad_gate) | unlike(OUT_s_axi_bvalid) | unlike(OUT_s_axi_rvalid);
        found |= unlike(OUT_s_axi_awready) | unlike(OUT_s_axi_wready) | unlike(OUT_s_axi_arready);
        if (slice_.get(OUT_s_axi_bvalid[0], 0)) found |= unlike(OUT_s_axi_bresp);
        if (slice_.get(OUT_s_axi_rvalid[0], 0)) found |= unlike(OUT_s_axi_rdata) | unlike(OUT_s_axi_rresp);
        for (int s = 0; s < STREAMS; s++) {
            found |= unlike(&TVALID[s], 1);
            if (slice_.get(TVALID[s], 0)) found |= unlike(&TLAST[s], 1) | unlike(TDATA[s], 64);
        }
        return found;
    }
    W unlike(const int* words, int n) {
        W found = ZEROS;
        for (int k = 0; k < n; k++) found |= slice_.word(words[k]) ^ (slice_.get(words[k], 0) ? ONES : ZEROS);
        return found;
    }
    template <int N> W unlike(const int (&words)[N]) { return unlike(words, N); }

    static W only(int lane) {
        W lanes = ZEROS;
        reinterpret_cast<uint64_t*>(&lanes)[lane / 64] = uint64_t(1) << (lane % 64);
        return lanes;
    }

    Slice slice_;
    std::vector<Recipe> recipes_;
    int recipe_ = 0;
    W different_ = ZEROS;
    std::vector<uint64_t> start_;  // the lane's words
    std::vector<Row> rows_;
    std::vector<std::unique_ptr<Shown>> shown_;
    std::map<std::string, int> numbers_;
};

}  // namespace

extern "C" {
Lanes* lanes_new() { return new Lanes(); }
void lanes_delete(Lanes* lanes) { delete lanes; }
void lanes_recipe(Lanes* lanes, int64_t settings, const Access* setting, int64_t n_during, const Access* during, int64_t n_after, const Access* after, int64_t n_beside, const Access* beside, int64_t upsets, const Upset* upset,
                  int64_t edges, const int64_t* cycle, const int64_t* subgroup, const int64_t* bit, int64_t ready_cycles, const uint8_t* ready,
                  int64_t frame_cycles, int64_t limit) {
    Recipe recipe{{setting, setting + settings}, {during, during + n_during}, {after, after + n_after}, {beside, beside + n_beside}, {upset, upset + upsets}, {},
                  {ready, ready + ready_cycles}, frame_cycles, limit};
    for (int64_t k = 0; k < edges; k++) recipe.edges.push_back({cycle[k], int32_t(subgroup[k]), int32_t(bit[k])});
    lanes->recipe(std::move(recipe));
}
void lanes_warm_up(Lanes* lanes) { lanes->warm_up(); }
void lanes_run(Lanes* lanes, const Upset* upsets, int n) { lanes->run(upsets, n); }
void lanes_together(Lanes* lanes, int64_t n, const int32_t* watched, int32_t* differs) { lanes->together(watched, int(n), differs); }
W* lanes_word(Lanes* lanes, int number) { return &lanes->word(number); }
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
