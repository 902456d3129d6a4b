// The parameter table: sort by a column's head, filter by text and verdict.

function sortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, index) => {
    const button = head.querySelector("button");
    if (button) button.addEventListener("click", () => sortBy(table, heads, index));
  });
}

function sortBy(table, heads, index) {
  const rising = heads[index].getAttribute("aria-sort") !== "ascending";
  for (const head of heads) if (head.hasAttribute("aria-sort")) head.setAttribute("aria-sort", "none");
  heads[index].setAttribute("aria-sort", rising ? "ascending" : "descending");
  const body = table.tBodies[0];
  const rows = [...body.rows].map((row, place) => ({ row, place, key: row.cells[index].dataset.sort || "" }));
  rows.sort((a, b) => {
    if (a.key === "" || b.key === "") return (a.key === "") - (b.key === "") || a.place - b.place;
    const difference = compare(a.key, b.key);
    return (rising ? difference : -difference) || a.place - b.place;
  });
  body.append(...rows.map((entry) => entry.row));
}

function compare(a, b) {
  const x = Number(a), y = Number(b);
  return Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b, undefined, { numeric: true }) : x - y;
}

function filterable(table) {
  const search = document.getElementById("parameter-filter");
  const toggles = [...document.querySelectorAll("button.toggle")];
  const apply = () => {
    const wanted = search.value.trim().toLowerCase();
    const off = new Set(toggles.filter((t) => t.getAttribute("aria-pressed") === "false").map((t) => t.dataset.verdict));
    for (const row of table.tBodies[0].rows) {
      const found = row.cells[0].textContent.toLowerCase().includes(wanted);
      row.classList.toggle("hidden", !found || off.has(row.dataset.verdict));
    }
  };
  search.addEventListener("input", apply);
  for (const toggle of toggles) {
    toggle.addEventListener("click", () => {
      toggle.setAttribute("aria-pressed", String(toggle.getAttribute("aria-pressed") === "false"));
      apply();
    });
  }
}
