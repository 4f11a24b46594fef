// SPDX-License-Identifier: Apache-2.0
// Tables of numbers and the theme: the same in the explorer and in report.html.
function fillTable(id, heads, rows) {
  const table = document.getElementById(id);
  const line = (cells, head) => {
    const tr = document.createElement("tr");
    cells.forEach((text, i) => {
      const cell = document.createElement(head || i === 0 ? "th" : "td");
      cell.scope = head ? "col" : "row";
      cell.textContent = text;
      tr.append(cell);
    });
    return tr;
  };
  table.tHead.replaceChildren(line(heads, true));
  table.tBodies[0].replaceChildren(...rows.map((row) => line(row, false)));
}

// Numbers of the pixel under the mouse or the finger, below the maps: nothing covers a map. source: of the maps.
let over = null;  // the pixel whose numbers are shown, and the source they come from
function overMap(source, {x, y}) {
  over = {source, x, y};
  const columns = source.data;
  const row = Math.round(y), col = Math.round(x), {dw, dh} = columns;
  if (row < 0 || col < 0 || row >= dh[0] || col >= dw[0]) return;
  const at = (name) => columns[name][0][row * dw[0] + col];
  const told = (name, digits, unit = "") => Number.isNaN(at(name)) ? "none" : at(name).toFixed(digits) + unit;
  document.getElementById("pixel").textContent = [
    `row ${row}, column ${col}, subgroup ${at("subgroup")}`,
    `truth ${told("truth_m", 2, " m")}`, `depth ${told("depth_m", 2, " m")}`, `error ${told("error_m", 3, " m")}`,
    `confidence ${told("confidence", 2)} (${columns.sentences[0].split("|")[at("reason")]})`, `threshold ${told("threshold", 0, " pixels")}`, `drops of the subgroup ${told("drops", 0)}`,
    `reflectivity ${told("reflectivity", 2)}`, `signal ${told("signal", 3)} and background ${told("background", 3)} photons per pulse`,
    `estimated signal ${told("estimated", 3)} ± ${told("estimated_error", 3)}`,
    `lowest possible error ${told("bound_mm", 1, " mm")}`,
  ].join(" · ");
}

// The maps show something else: the numbers below them follow.
function renewOver() {
  if (over) overMap(over.source, over);
}

// A notebook shows the page in a frame, which becomes as high as its content.
if (location.href === "about:srcdoc" && window.frameElement) {
  const fitted = new ResizeObserver(() => {
    window.frameElement.style.height = `${document.documentElement.scrollHeight}px`;
  });
  addEventListener("load", () => [document.documentElement, ...document.body.children].forEach((part) => fitted.observe(part)));
}

const THEME = "coincid-theme";  // where the browser keeps the chosen theme
function keptTheme() {
  try { return localStorage.getItem(THEME); } catch { return null; }  // some frames and files may keep nothing
}

function keepTheme(name) {
  try { localStorage.setItem(THEME, name); } catch { /* it counts for this page alone */ }
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  const roots = window.Bokeh?.index?.roots ?? window.Bokeh?.index ?? {};
  const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
  for (const model of window.Bokeh?.documents?.[0]?._all_models?.values() ?? []) {  // what takes no colour from the page's style
    if (model.type === "Legend") model.label_text_color = ink;
    if (model.type === "ColorBar") model.major_label_text_color = ink;
  }
  for (const view of Object.values(roots)) { view.invalidate_layout?.(); view.request_repaint?.(); }
}
setTheme(keptTheme() ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
document.addEventListener("click", (event) => {
  if (event.target.id !== "theme") return;
  setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  keepTheme(document.documentElement.dataset.theme);
});
