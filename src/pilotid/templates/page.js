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
// Tables that ask for it have their rows chosen: by the entries of some columns, by a word, as CSV.
for (const table of document.querySelectorAll("table[data-filters]")) {
  const rows = [...table.tBodies[0].rows], heads = [...table.tHead.rows[0].cells];
  const text = cell => cell.textContent.trim();
  const form = document.createElement("form");
  form.className = "filters";
  const labelled = (name, control) => {
    const label = document.createElement("label");
    label.append(name, control);
    form.append(label);
    return control;
  };
  const chosen = table.dataset.filters.split(" ").map(Number).map(column => {
    const select = labelled(text(heads[column]), document.createElement("select"));
    select.append(new Option("all", ""));
    for (const value of new Set(rows.map(row => text(row.cells[column])))) select.append(new Option(value, value));
    return [select, column];
  });
  const word = labelled("word", document.createElement("input"));
  word.type = "search";
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = "these rows as CSV";
  const told = document.createElement("output");
  form.append(button, told);
  const show = () => {
    for (const row of rows) {
      const right = chosen.every(([select, column]) => !select.value || text(row.cells[column]) === select.value);
      row.hidden = !right || !row.textContent.toLowerCase().includes(word.value.toLowerCase());
    }
    told.textContent = `${rows.filter(row => !row.hidden).length} of ${rows.length} rows`;
  };
  form.addEventListener("input", show);
  form.addEventListener("submit", event => event.preventDefault());
  button.addEventListener("click", () => {
    const quoted = cell => `"${text(cell).replace(/"/g, '""')}"`;
    const shown = [table.tHead.rows[0], ...table.tBodies[0].rows].filter(row => !row.hidden);
    const lines = shown.map(row => [...row.cells].map(quoted).join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([lines.join("\n") + "\n"], { type: "text/csv" }));
    link.download = "rows.csv";
    link.click();
    URL.revokeObjectURL(link.href);
  });
  table.closest(".scroll").before(form);
  show();
}
// A link to a folded section opens it; what is open is printed.
const unfold = () => {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  const part = target && target.querySelector("details");
  if (part) { part.open = true; target.scrollIntoView(); }
};
addEventListener("hashchange", unfold);
unfold();
