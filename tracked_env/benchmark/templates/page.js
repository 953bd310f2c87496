"use strict";
const root = document.documentElement;
const theme = document.getElementById("theme");
theme.hidden = false;
theme.addEventListener("click", () => {
  const dark = root.dataset.theme
    ? root.dataset.theme === "dark"
    : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
});

// Numbers by their value, cells without one last, texts by the alphabet.
function compare(a, b, sign) {
  if (a.dataset.sort !== undefined && b.dataset.sort !== undefined) {
    return sign * (Number(a.dataset.sort) - Number(b.dataset.sort));
  }
  if (a.dataset.sort !== undefined) return -1;
  if (b.dataset.sort !== undefined) return 1;
  return sign * a.textContent.localeCompare(b.textContent);
}

for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    heads.forEach((other) => other.setAttribute("aria-sort", "none"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rows = [...body.rows];
    rows.sort((a, b) => compare(a.cells[column], b.cells[column], down ? -1 : 1));
    body.append(...rows);
  }));
  const tools = table.parentElement.previousElementSibling;
  tools.hidden = false;
  const field = tools.querySelector("input");
  field.addEventListener("input", () => {
    const wanted = field.value.trim().toLowerCase();
    let shown = 0;
    for (const row of body.rows) {
      row.hidden = !row.textContent.toLowerCase().includes(wanted);
      shown += row.hidden ? 0 : 1;
    }
    tools.querySelector("output").textContent = wanted ? `${shown} of ${body.rows.length} rows` : "";
  });
}
