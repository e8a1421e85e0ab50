// On a phone a row of a table with three columns or more is shown as a list, see site.css.
document.addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("article table.docutils")) {
    const labels = [...table.querySelectorAll("thead th")].map(cell => cell.innerText.trim());
    if (labels.length < 3 || table.querySelector("[colspan], [rowspan]")) continue;
    table.classList.add("labelled");
    for (const row of table.querySelectorAll("tbody tr"))
      [...row.cells].forEach((cell, k) => {
        if (cell.querySelector("img") || cell.textContent.trim()) cell.dataset.label = k > 0 && labels[k] ? labels[k] + ": " : "";
      });
  }
});
