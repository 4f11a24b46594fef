// SPDX-License-Identifier: Apache-2.0
// report.html: looks up the data for a click or a field in the tables of the report (report.py).
let all = null;
const PLAY_MS = 450;
const place = (name) => document.querySelector(`[data-look="${name}"]`);
const looked = (name) => {
  const input = place(name);
  const most = input.max ? Number(input.max) : Infinity;
  return Math.max(0, Math.min(Math.round(Number(input.value) || 0), most));
};

function report(given) {
  all = given;
  document.querySelectorAll("[data-look]").forEach((input) => input.addEventListener("input", () => show(input.dataset.look === "frame")));
  let timer = null;
  document.getElementById("play").addEventListener("click", (event) => {
    event.target.setAttribute("aria-pressed", timer === null);
    if (timer !== null) { clearInterval(timer); timer = null; return; }
    timer = setInterval(() => { place("pulse").value = (looked("pulse") + 1) % all.sensor.pulses; show(false); }, PLAY_MS);
  });
  setTheme(document.documentElement.dataset.theme);
  show(true);
}

function picked(row, col) {
  if (row < 0 || col < 0 || row >= all.sensor.rows || col >= all.sensor.cols) return;
  place("row").value = row;
  place("col").value = col;
  show(false);
}

function show(frameChanged) {
  const row = looked("row"), col = looked("col"), pulse = looked("pulse"), {sensor} = all;
  const frame = all.frames[looked("frame")];
  if (frameChanged) {
    all.pictures.data = frame.pictures.data;
    const words = JSON.parse(all.words[looked("frame")]);
    document.getElementById("story").textContent = words.story;
    fillTable("objects", words.object_heads, words.objects);
    fillTable("numbers", words.heads, words.numbers);
    renewOver();
  }
  const pixel = row * sensor.cols + col;
  const subgroup = all.inside.data.subgroup[pixel];
  const top = row - row % sensor.height, left = col - col % sensor.width;
  all.cursor.data = {x: [col], y: [row], w: [1], h: [1]};
  all.around.data = {x: [left + (sensor.width - 1) / 2], y: [top + (sensor.height - 1) / 2], w: [sensor.width], h: [sensor.height]};
  showHistogram(frame, pixel, subgroup, row, col);
  showPeriod(frame, subgroup, pulse);
}

const said = (value, what) => Number.isNaN(value) ? `no ${what}` : `${what} ${value.toFixed(2)} m`;

function showHistogram(frame, pixel, subgroup, row, col) {
  const {sensor, histogram} = all;
  const inside = all.inside.data.inside[pixel];
  const of = {pixel: new Array(sensor.bins).fill(0), subgroup: new Array(sensor.bins).fill(0)};
  const bounds = frame.subgroups.data.events, bin = frame.events.data.bin, word = frame.hits.data.word;
  for (let e = bounds[subgroup]; e < bounds[subgroup + 1]; e++) {
    of.subgroup[bin[e]] += 1;
    if (word[e * sensor.words + (inside >> 5)] >>> (inside & 31) & 1) of.pixel[bin[e]] += 1;
  }
  const left = of.pixel.map((_, i) => i * sensor.bin_m);
  histogram.bars.data = {left, right: left.map((x) => x + sensor.bin_m), ...of};
  const count = frame.returns.data.at_m.length / (sensor.rows * sensor.cols);
  const returns = {x: [], confidence: [], colour: [], marker: [], what: []};
  for (let k = 0; k < count; k++) {
    const at = frame.returns.data.at_m[pixel * count + k], second = k > 0 ? 1 : 0;
    if (Number.isNaN(at)) continue;
    returns.x.push(at);
    returns.confidence.push(frame.returns.data.confidence[pixel * count + k]);
    returns.colour.push(all.choice.colours[second]);
    returns.marker.push(all.choice.marks[second]);
    returns.what.push(second ? "also possible" : "chosen");
  }
  histogram.returns.data = returns;
  const truth = frame.pictures.data.truth_m[0][pixel], depth = frame.pictures.data.depth_m[0][pixel];
  histogram.truth.data = {x: Number.isNaN(truth) ? [] : [truth]};
  histogram.figure.title.text = `row ${row}, column ${col}: ${said(truth, "truth")}, ${said(depth, "depth")}`;
  for (const [range, values] of [[histogram.figure.y_range, of.pixel], [histogram.subgroup_range, of.subgroup]]) {
    const most = Math.max(3, ...values);
    range.setv({start: -0.12 * most, end: 1.15 * most});
  }
}

function showPeriod(frame, subgroup, pulse) {
  const {sensor, timeline, fates, verdicts} = all;
  const k = subgroup * sensor.pulses + pulse;
  const [from, to] = [frame.bounds.data.edges[k], frame.bounds.data.edges[k + 1]];
  const fate = [...frame.edges.data.fate.slice(from, to)].map((f) => fates[f]);
  timeline.edges.data = {
    x: [...frame.edges.data.tick.slice(from, to)].map((t) => (t + 0.5) * sensor.tick_ns),
    y: [...frame.edges.data.pixel.slice(from, to)],
    colour: fate.map((f) => f[0]), marker: fate.map((f) => f[1]), fate: fate.map((f) => f[2]),
  };
  const [first, end] = [frame.bounds.data.windows[k], frame.bounds.data.windows[k + 1]];
  const part = (name, factor) => [...frame.windows.data[name].slice(first, end)].map((x) => x * factor);
  const verdict = part("verdict", 1).map((v) => verdicts[v]);
  const left = part("start", sensor.tick_ns), right = part("end", sensor.tick_ns);
  timeline.windows.data = {
    left, right, middle: left.map((x, i) => (x + right[i]) / 2), top: left.map(() => sensor.pixels - 0.5), count: part("count", 1),
    colour: verdict.map((v) => v[0]), hatch: verdict.map((v) => v[1]), verdict: verdict.map((v) => v[2]),
    commit: part("commit", sensor.cycle_ns), commit_mark: verdict.map((v) => v[3]),
  };
  const opens = frame.gates.data.first[k] * sensor.cycle_ns, closes = frame.gates.data.end[k] * sensor.cycle_ns;
  timeline.gate.data = {left: [0, closes], right: [opens, sensor.period * sensor.cycle_ns]};
  const bounds = frame.subgroups.data.fill, {cycle, fill} = frame.fill.data, start = frame.starts[pulse];
  const x = [0], level = [0];
  for (let i = bounds[subgroup]; i < bounds[subgroup + 1] && cycle[i] < start + sensor.period; i++) {
    if (cycle[i] <= start) { level[0] = fill[i]; continue; }
    x.push((cycle[i] - start) * sensor.cycle_ns);
    level.push(fill[i]);
  }
  timeline.fill.data = {x: [...x, sensor.period * sensor.cycle_ns], fill: [...level, level.at(-1)]};
  const light = {x: [], y: []};
  frame.pictures.data.truth_m[0].forEach((truth, pixel) => {
    if (all.inside.data.subgroup[pixel] !== subgroup || Number.isNaN(truth)) return;
    light.x.push(truth * sensor.ns_per_m);
    light.y.push(all.inside.data.inside[pixel]);
  });
  timeline.light.data = light;
  const pixels = frame.threshold[subgroup];
  timeline.figure.title.text = `subgroup ${subgroup}, pulse ${pulse}: a window needs ${pixels} pixel${pixels > 1 ? "s" : ""}`;
}
