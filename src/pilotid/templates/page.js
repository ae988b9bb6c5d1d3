"use strict";
// Tables sort by a click on a heading: down, up, and back to the order they came in.
const number = text => parseFloat(text.replace(/\u2212/g, "-").replace(/^\+/, ""));
for (const table of document.querySelectorAll("table")) {
  const body = table.tBodies[0], rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
  const began = rows.map(row => row.className);
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const now = head.getAttribute("aria-sort");
      const next = now === "ascending" ? "descending" : now === "descending" ? null : "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      if (next) head.setAttribute("aria-sort", next);
      const sign = next === "descending" ? -1 : 1;
      const words = head.classList.contains("t");
      const key = row => row.cells[column].textContent.trim();
      const sorted = !next ? rows : [...rows].sort((a, b) => {
        if (words) return sign * key(a).localeCompare(key(b), "en", { numeric: true });
        const x = number(key(a)), y = number(key(b));
        // What is no number comes last, whichever way.
        return isNaN(x) || isNaN(y) ? isNaN(x) - isNaN(y) : sign * (x - y);
      });
      rows.forEach((row, i) => { row.className = next ? "" : began[i]; });
      body.append(...sorted);
    });
  });
}
// A link to a folded section opens it; what is open is printed.
const unfold = () => {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  const part = target && target.querySelector("details");
  if (part) { part.open = true; target.scrollIntoView(); }
};
addEventListener("hashchange", unfold);
unfold();
