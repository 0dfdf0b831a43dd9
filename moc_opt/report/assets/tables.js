// A click, Enter or Space on a heading sorts its table by this column: best first, then reversed.
(() => {
  "use strict";
  const key = (row, column) => {
    const cell = row.cells[column];
    return "sort" in cell.dataset ? cell.dataset.sort : null;
  };
  const number = (text) => {
    if (text === "inf") return Infinity;
    if (text === "-inf") return -Infinity;
    return text.trim() === "" ? NaN : Number(text);
  };
  // Numbers come first, in order of size. Texts follow in alphabetical order.
  const compare = (a, b) => {
    const x = number(a), y = number(b);
    if (Number.isNaN(x) !== Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
    if (Number.isNaN(x)) return a.localeCompare(b, undefined, { numeric: true });
    return x === y ? 0 : x < y ? -1 : 1;
  };
  const sort = (heading) => {
    const table = heading.closest("table"), body = table.tBodies[0], column = heading.cellIndex;
    const other = { ascending: "descending", descending: "ascending" };
    const order = other[heading.getAttribute("aria-sort")] || heading.dataset.first;
    const sign = order === "ascending" ? 1 : -1;
    const rows = [...body.rows].sort((one, two) => {
      const a = key(one, column), b = key(two, column);
      // Missing values stay at the end in either order.
      if (a === null || b === null) return (a === null) - (b === null);
      return sign * compare(a, b);
    });
    for (const each of table.tHead.rows[0].cells) each.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", order);
    body.append(...rows);
  };
  for (const button of document.querySelectorAll("figure.table th button")) {
    button.addEventListener("click", () => sort(button.closest("th")));
  }
})();
