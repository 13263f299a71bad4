// Tables that a click on a heading sorts: numbers as numbers, empty cells last. Those wider than the window say so.
"use strict";
for (const heading of document.querySelectorAll("table.sortable th")) {
  const sort = () => {
    const table = heading.closest("table"), body = table.tBodies[0], column = heading.cellIndex;
    const down = heading.getAttribute("aria-sort") === "ascending";
    const key = (row) => {
      const cell = row.cells[column], text = cell.dataset.value !== undefined ? cell.dataset.value : cell.textContent.trim();
      const number = text === "" ? NaN : Number(text);
      return { text, number };
    };
    const rows = Array.from(body.rows, (row) => [key(row), row]);
    rows.sort(([a], [b]) => {
      if (a.text === "" || b.text === "") return (a.text === "") - (b.text === "");
      const order = isNaN(a.number) || isNaN(b.number) ? a.text.localeCompare(b.text) : a.number - b.number;
      return down ? -order : order;
    });
    for (const other of table.querySelectorAll("th")) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    for (const [, row] of rows) body.append(row);
  };
  heading.tabIndex = 0;
  heading.addEventListener("click", sort);
  heading.addEventListener("keydown", (e) => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); sort(); } });
}
for (const box of document.querySelectorAll(".scroll")) {
  const look = () => box.classList.toggle("cut", box.scrollWidth > box.clientWidth + 1);
  new ResizeObserver(look).observe(box);
  for (const tick of document.querySelectorAll("#every")) tick.addEventListener("change", look);
  look();
}
