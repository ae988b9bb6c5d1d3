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
