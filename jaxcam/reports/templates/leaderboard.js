"use strict";
// Sorts, filters and compares; without it the page is whole, against each board's first line.

function compare(one, other, down) {
  if (one === other) return 0;
  if (one === "") return 1; // what is not known comes last either way
  if (other === "") return -1;
  const [a, b] = [Number(one), Number(other)];
  const order = Number.isNaN(a) || Number.isNaN(b) ? one.localeCompare(other) : a - b;
  return down ? -order : order;
}

function sort(board, button) {
  const head = button.closest("th");
  const down = head.getAttribute("aria-sort") !== "descending";
  for (const other of board.querySelectorAll("th[aria-sort]")) other.setAttribute("aria-sort", "none");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const column = button.dataset.column;
  const lines = [...board.querySelectorAll("tbody tr")];
  lines.sort((a, b) => compare(a.dataset[column], b.dataset[column], down));
  board.querySelector("tbody").append(...lines);
}

function refer(board, number) {
  for (const line of board.querySelectorAll("tbody tr")) {
    const [points, basis, value, verdict] = JSON.parse(line.dataset.differences)[number];
    const cell = line.querySelector(".against");
    cell.className = `against ${verdict}`;
    cell.querySelector("b").textContent = points;
    cell.querySelector("span").textContent = basis;
    line.dataset.difference = value === null ? "" : value;
  }
  board.querySelector("[data-column=difference]").closest("th").setAttribute("aria-sort", "none");
}

for (const button of document.querySelectorAll("button[data-column]"))
  button.addEventListener("click", () => sort(button.closest("section"), button));
const boards = [...document.querySelectorAll(".board")];
for (const board of boards) {
  const reference = board.querySelector("select");
  reference.addEventListener("change", () => refer(board, Number(reference.value)));
}
const task = document.querySelector("#task");
if (task)
  task.addEventListener("change", () => {
    for (const board of boards)
      board.hidden = task.value !== "" && board.dataset.task !== task.value;
  });
document.body.classList.add("live");
