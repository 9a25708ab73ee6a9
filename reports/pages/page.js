"use strict";
// Tables sort by the column whose heading is clicked; distributions tell the share of trials at the pointer.

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

const shareBelow = (curve, value) => {
  // The curve holds values at equal steps of the share of the solved trials.
  let below = 0;
  while (below < curve.values.length && curve.values[below] <= value) below += 1;
  return (100 * curve.solved * below) / (curve.values.length * curve.trials);
};

const three = (value) => Number(value.toPrecision(3)).toString();

for (const drawing of document.querySelectorAll("svg.distribution")) {
  const told = JSON.parse(drawing.querySelector("desc").textContent);
  const guide = drawing.querySelector(".guide");
  const readout = drawing.parentElement.querySelector(".readout");
  const [left, right] = told.across;
  const [low, high] = told.range;
  drawing.addEventListener("pointermove", (event) => {
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
    const x = Math.min(Math.max(place.x, left), right);
    const value = low * (high / low) ** ((x - left) / (right - left));
    guide.setAttribute("x1", x);
    guide.setAttribute("x2", x);
    guide.setAttribute("visibility", "visible");
    const shares = told.curves.map((curve) => `${curve.label} ${shareBelow(curve, value).toFixed(1)} %`);
    readout.textContent = `at most ${three(value)} ${told.unit}: ${shares.join(", ")} of all trials`;
  });
  drawing.addEventListener("pointerleave", () => {
    guide.setAttribute("visibility", "hidden");
    readout.textContent = "";
  });
}
