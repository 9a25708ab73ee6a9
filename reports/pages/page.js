"use strict";
// Tables sort by the column whose heading is clicked.

const numberIn = (text) => {
  const found = text.replace("−", "-").match(/-?\d+(\.\d+)?(e[+-]?\d+)?/i);
  const scale = / ms\b/.test(text) ? 1e-3 : 1;
  return found ? scale * Number(found[0]) : NaN;
};

const compare = (one, other, numeric) => {
  if (!numeric) return one.localeCompare(other, "en", { numeric: true });
  const [a, b] = [numberIn(one), numberIn(other)];
  if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
  return a - b;
};

const sortBy = (heading) => {
  const table = heading.closest("table");
  const column = [...heading.parentElement.children].indexOf(heading);
  const descending = heading.getAttribute("aria-sort") === "ascending";
  const numeric = heading.classList.contains("number");
  const body = table.tBodies[0];
  const text = (row) => row.cells[column].textContent.trim();
  const rows = [...body.rows].sort((a, b) => compare(text(a), text(b), numeric));
  if (descending) {
    // What has no value stays at the end.
    const empty = numeric ? rows.filter((row) => Number.isNaN(numberIn(text(row)))) : [];
    const full = rows.filter((row) => !empty.includes(row)).reverse();
    rows.splice(0, rows.length, ...full, ...empty);
  }
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
  body.append(...rows);
};

for (const heading of document.querySelectorAll("table.sortable thead th")) {
  heading.tabIndex = 0;
  heading.title = "sort by this column";
  heading.addEventListener("click", () => sortBy(heading));
  heading.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      sortBy(heading);
    }
  });
}
