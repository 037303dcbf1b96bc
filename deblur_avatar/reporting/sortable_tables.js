// Sortable tables: a heading becomes a button that orders the rows by its column.
//
// The first press puts the best first (the heading's arrow says which way that is; words from A to Z), the second the
// worst, the third brings the written order back. Rows without a number are last either way.

const NEXT = { written: "best", best: "worst", worst: "written" };

for (const table of document.querySelectorAll("table")) {
  const [body] = table.tBodies;
  const written = [...body.rows];
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.onclick = () => {
      const order = NEXT[heading.dataset.order ?? "written"];
      for (const other of headings) {
        delete other.dataset.order;
        other.removeAttribute("aria-sort");
      }
      if (order === "written") return body.append(...written);
      const values = new Map(written.map((row) => [row, valueOf(row.cells[column])]));
      const numeric = [...values.values()].some((value) => typeof value === "number");
      const best = numeric && button.querySelector(".arrow")?.textContent === "↑" ? -1 : 1;
      const sign = order === "best" ? best : -best;
      heading.dataset.order = order;
      heading.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      body.append(...[...written].sort((a, b) => compared(values.get(a), values.get(b), numeric, sign)));
    };
  });
}

// A number as it is shown ("7 494", "−0.16", "25.00 ± 1.00"); words where there is none, and in names of rows.
function valueOf(cell) {
  const text = cell.textContent.trim();
  const number = Number.parseFloat(text.replace(/\s/g, "").replace("−", "-"));
  return cell.tagName === "TD" && Number.isFinite(number) ? number : text;
}

function compared(a, b, numeric, sign) {
  if (!numeric) return sign * a.localeCompare(b);
  const [withoutA, withoutB] = [a, b].map((value) => typeof value !== "number");
  return withoutA || withoutB ? withoutA - withoutB : sign * (a - b);
}
