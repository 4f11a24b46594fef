// SPDX-License-Identifier: Apache-2.0
// The explorer's page: sends the controls' values to the server, and shows an answer only if it belongs to the current values.
// messages.py describes the fields of every message.
let link = null;        // the model that page and server share: the newest message of each kind
let asked = 0;          // number of the latest question; every keystroke in a control is a new one
let began = 0;          // when the latest question left
let waiting = 0;        // timer: a question leaves when typing pauses
const PAUSE_MS = 50, SLOW_MS = 300, PLAY_MS = 450, RETRY_MS = 1000, UPLOAD_BYTES_MAX = 32 << 20;
const $ = (selector) => document.querySelector(selector);
const all = (selector) => [...document.querySelectorAll(selector)];

const field = (name) => document.querySelector(`#controls [name="${name}"]`);
const read = (input) => input.type === "checkbox" ? String(input.checked) : input.value;
function write(name, value) {
  const input = field(name);
  if (input.type === "checkbox") input.checked = value; else input.value = value;
  const slider = document.querySelector(`[data-slides="${name}"]`);
  if (slider) slider.value = value;
}

// Fields without an effect under the present settings are disabled; their values stay.
function settle() {
  for (const control of all("[data-needs]")) {
    const met = ([name, legal]) => Array.isArray(legal) ? legal.includes(read(field(name))) : Number(read(field(name))) > legal;
    const off = !JSON.parse(control.dataset.needs).some((one) => Object.entries(one).every(met));
    control.classList.toggle("dormant", off);
    control.querySelectorAll("input, select").forEach((input) => { input.disabled = off; });
  }
}

function say(selector, text) {
  const place = $(selector);
  place.textContent = text;
  place.hidden = !text;
}

function state(name) {
  document.body.dataset.state = name;
  all("[data-do=rtl], [data-do=keep_a], #save").forEach((one) => { one.disabled = name !== "shown"; });
}

function ask() {
  const pause = document.body.dataset.state === "asked" ? PAUSE_MS : 0;  // the first change leaves at once
  asked += 1;
  settle();
  state("asked");
  for (const place of ["#rtl", "#said"]) say(place, "");
  $("#looked").textContent = "";
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    link.question = {number: asked, values: controlValues()};
    began = performance.now();
  }, pause);
}

let orders = 0;
function order(name, fields = {}) { link.order = {number: ++orders, name, fields}; }

function answered() {
  const {number, words} = link.answer;
  if (number !== asked) return;
  settled("");
  $("#status").textContent = words.status;
  tell(words);
  document.body.toggleAttribute("data-earlier", true);
  state("shown");
  remember(words);
}

// Every change is a step of the browser's history, so that Back undoes it; quick changes of one control are one step.
const STEP_MS = 1500;
let changed = "";       // name of the control that changed last; "" after Back and at the beginning
let stepped = {control: "", time: 0};  // the latest step
function remember(words) {
  const page = {values: controlValues(), uploads: words.uploads};
  const search = words.query ? "?" + words.query : "";
  const now = performance.now();
  const same = changed === stepped.control && now - stepped.time < STEP_MS;
  if (changed === "" || same || search === location.search) history.replaceState(page, "", search || location.pathname);
  else history.pushState(page, "", search || location.pathname);
  stepped = {control: changed, time: now};
}

function controlValues() {
  return Object.fromEntries(all("#controls [name]").map((input) => [input.name, read(input)]));
}

window.addEventListener("popstate", ({state: page}) => {
  if (!page) return;
  for (const [name, value] of Object.entries(page.values)) write(name, field(name).type === "checkbox" ? value === "true" : value);
  order("recall", {number: page.uploads});
  changed = "";
  ask();
});

function refused() {
  const {number, message, control} = link.refusal;
  if (number !== asked) return;
  settled(message);
  state("refused");
  $("#status").textContent = document.body.hasAttribute("data-earlier")
    ? "These settings are not possible. What is shown is the result of the settings before."
    : "Nothing is shown: these settings are not possible.";
  document.querySelector(`[data-control="${control}"]`)?.classList.add("illegal");
}

// The newest question has its answer: nothing is in progress. refusal: why there is no result; "" if there is one.
function settled(refusal) {
  all(".control.illegal").forEach((one) => one.classList.remove("illegal"));
  say("#refused", refusal);
  $("#progress").hidden = true;
}

function renewed() {
  const {number, words} = link.new_words;
  if (number === asked) tell(words);
}

function tell(words) {
  document.body.toggleAttribute("data-ab", words.ab);
  document.body.toggleAttribute("data-film", words.frames > 1);
  $("[data-do=drop_a]").hidden = !words.ab;
  $("#a-says").textContent = words.a_says;
  say("#notes", words.notes.join("\n"));
  renewOver();
  $("#story").textContent = words.story;
  $("#where").textContent = words.where;
  fillTable("objects", words.object_heads, words.objects);
  fillTable("numbers", words.number_heads, words.numbers);
  fillTable("meaning", [], words.meaning);
  $("#wastes").replaceChildren(...words.wastes.map((text) => Object.assign(document.createElement("li"), {textContent: text})));
  for (const [name, span] of Object.entries(words.spans)) $(`[data-control="${name}"] small`).textContent = span;
  for (const [name, value] of Object.entries(words.look)) {
    const input = document.querySelector(`[data-look="${name}"]`);
    if (input !== document.activeElement) input.value = value;
  }
}

function progressed() {
  const {number, stage, share} = link.progress;
  if (number !== asked) return;
  doing = stage;
  if (share > 0) $("#progress").value = share; else $("#progress").removeAttribute("value");
  if (performance.now() - began > SLOW_MS) $("#progress").hidden = false;
}

// What takes long says what it does and for how long; its progress moves where it can be told.
let doing = "";
setInterval(() => {
  const seconds = (performance.now() - began) / 1000;
  if (document.body.dataset.state !== "asked" || 1000 * seconds < SLOW_MS) return;
  $("#progress").hidden = false;
  $("#status").textContent = `computing: ${doing}, ${seconds.toFixed(0)} s. Any change overtakes it.`;
}, 250);

function checked() {
  const {number, text, bad} = link.rtl_check;
  if (number !== asked) return;
  say("#rtl", text);
  $("#rtl").classList.toggle("bad", bad);
}

function showCommand() {
  const {number, text} = link.command_line;
  if (number === asked) say("#said", text);
}

function lookRefused() {
  const {text} = link.look_refusal;
  $("#looked").textContent = text;
}

// The names of the file's parts are suggested where one of them is chosen.
function partsTold() {
  const {names} = link.parts;
  $("#parts").replaceChildren(...names.map((value) => Object.assign(document.createElement("option"), {value})));
}

function saved() {
  const {name, type, base64} = link.download;
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(new Blob([bytes], {type}));
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}

function upload(input) {
  const file = input.files[0];
  if (!file) return;
  const kind = input.dataset.kind;
  if (file.size > UPLOAD_BYTES_MAX) {
    refuse(`${file.name}: holds ${(file.size / 2 ** 20).toFixed(0)} MiB, must hold at most ${UPLOAD_BYTES_MAX / 2 ** 20}`);
    return;
  }
  const reader = new FileReader();
  reader.onload = () => {
    if (kind === "sun") write("sun", "picture");
    else if (kind === "pulse") write("pulse", "file");
    else write("scene", "upload");
    changed = `file ${kind} ${file.name}`;
    const content = reader.result.split(",")[1] ?? "";
    order("upload", {kind, name: file.name, content});
    ask();
  };
  reader.readAsDataURL(file);
}

function refuse(text) {
  asked += 1;
  clearTimeout(waiting);
  say("#refused", text);
  state("refused");
}

const playing = {};
function play(button) {
  const name = button.dataset.play;
  const on = !(name in playing);
  button.setAttribute("aria-pressed", on);
  if (on) playing[name] = setInterval(() => { if (document.body.dataset.state === "shown") order("step", {name}); }, PLAY_MS);
  else { clearInterval(playing[name]); delete playing[name]; }
}

function gone() {
  $("#gone").hidden = false;
  const retry = async () => {
    try { await fetch("metadata", {cache: "no-store"}); location.reload(); }
    catch { setTimeout(retry, RETRY_MS); }
  };
  setTimeout(retry, RETRY_MS);
}

// Called once Bokeh has drawn the page.
function explorer(model) {
  link = model;
  const {values, defaults, ignored} = link.opened;
  for (const [name, value] of Object.entries(values)) write(name, value);
  say("#ignored", ignored);
  const on = (name, call) => link.properties[name].change.connect(call);
  on("answer", answered);
  on("refusal", refused);
  on("new_words", renewed);
  on("progress", progressed);
  on("rtl_check", checked);
  on("command_line", showCommand);
  on("look_refusal", lookRefused);
  on("download", saved);
  on("parts", partsTold);
  partsTold();
  $("#controls").addEventListener("input", (event) => {
    const slides = event.target.dataset.slides;
    if (slides) field(slides).value = event.target.value;
    else if (event.target.name) write(event.target.name, event.target.type === "checkbox" ? event.target.checked : event.target.value);
    if (event.target.type === "file") return;
    changed = slides ?? event.target.name;
    ask();
  });
  for (const kind of ["focusin", "mouseover"]) {  // in a place of its own: nothing may move under the mouse
    $("#controls").addEventListener(kind, (event) => {
      const about = event.target.closest("[data-control]")?.querySelector(".about");
      if (about) $("#about").textContent = about.textContent;
    });
    for (const button of all("[data-says]")) button.addEventListener(kind, () => { $("#about").textContent = button.dataset.says; });
  }
  $("#fold").addEventListener("click", () => {
    $("#fold").setAttribute("aria-expanded", document.body.toggleAttribute("data-unfolded"));
  });
  $("#controls").addEventListener("submit", (event) => event.preventDefault());
  all("[data-kind]").forEach((input) => input.addEventListener("change", () => upload(input)));
  all("[data-do]").forEach((button) => button.addEventListener("click", () => {
    if (button.dataset.do === "reset") {
      for (const [name, value] of Object.entries(defaults)) write(name, value);
      all("[data-kind]").forEach((input) => { input.value = ""; });
      $("#tried").textContent = "";
      say("#ignored", "");
      order("forget");
      changed = "reset";
      ask();
    } else order(button.dataset.do);
  }));
  all("[data-try]").forEach((button) => button.addEventListener("click", () => {
    for (const [name, value] of Object.entries({...defaults, ...JSON.parse(button.dataset.try)})) write(name, value);
    $("#tried").textContent = button.dataset.says;
    changed = `try ${button.dataset.try}`;
    ask();
  }));
  all("[data-look]").forEach((input) => input.addEventListener("input", () => order("look", {name: input.dataset.look, value: input.value})));
  all("[data-play]").forEach((button) => button.addEventListener("click", () => play(button)));
  $("#save").addEventListener("change", (event) => { if (event.target.value) order("save", {kind: event.target.value}); event.target.value = ""; });
  setTheme(document.documentElement.dataset.theme);
  ask();
}
