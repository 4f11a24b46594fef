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

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  const roots = window.Bokeh?.index?.roots ?? window.Bokeh?.index ?? {};
  for (const view of Object.values(roots)) { view.invalidate_layout?.(); view.request_repaint?.(); }
}
setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
document.addEventListener("click", (event) => {
  if (event.target.id === "theme") setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
});
