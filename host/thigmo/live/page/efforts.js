// The choice before Start: how much robot time a run may take, with what each effort is expected to
// take on this robot and to give, by the study behind the project's figures.

import { read } from "./feed.js";
import { $, element } from "./store.js";
import { rounded } from "./svg.js";

const BUDGET = "budget";
const WAIT_MS = 300; // after a key, before a budget is worked out
const omitted = new Map(); // what each effort leaves out
let usual = "", waits = null;

export async function connectEfforts() {
  const efforts = await read("efforts.json");
  if (!efforts?.length) return;
  const kinds = efforts[0].measured;
  $("effort-kinds").replaceChildren(
    element("td", { colspan: 2 }),
    ...kinds.map((row) => element("th", { colspan: 2, scope: "colgroup" }, `${ROOMS[row.kind] ?? row.kind}, ${row.rooms} rooms`)),
  );
  $("effort-heads").replaceChildren(...["effort", "robot time", ...kinds.flatMap(() => ["error", "missed"])].map((head) => element("th", {}, head)));
  const budget = element("span", {}, element("input", { id: "budget", type: "number", min: 1, "aria-label": "budget of robot time, s" }), " s");
  $("effort-choices").replaceChildren(
    ...efforts.map((expected) => row(expected.effort, expected.usual, cells(expected))),
    row(BUDGET, false, [], budget),
  );
  usual = efforts.find((expected) => expected.usual).effort;
  $("budget").addEventListener("input", () => {
    document.querySelector(`input[name=effort][value=${BUDGET}]`).checked = true;
    drawSkips();
    clearTimeout(waits);
    waits = setTimeout(drawBudget, WAIT_MS);
  });
  for (const { effort: name, skips } of efforts) omitted.set(name, skips);
  $("effort-choices").addEventListener("change", drawSkips);
  drawSkips();
}

function row(name, checked, columns, extra = "") {
  const button = element("input", { type: "radio", name: "effort", value: name });
  button.checked = checked;
  return element("tr", { "data-effort": name }, element("td", {}, element("label", {}, button, name, extra)), ...columns);
}

// What is expected of an effort: its time on this robot, its errors in the study's rooms.
const cells = ({ robot_time_s: time, measured }) => [
  element("td", {}, `${rounded(time, 0)} s`),
  ...measured.flatMap((kind) => [
    element("td", {}, `${rounded(kind.error_cm, 1)} cm`), element("td", {}, `${rounded(100 * kind.missed, 0)} %`),
  ]),
];

const ROOMS = { "as calibrated": "one peg", "one to three pegs": "1 to 3 pegs", "walls, corners, gaps": "walls" };

const chosen = () => document.querySelector("input[name=effort]:checked")?.value;

function drawSkips() {
  const skips = omitted.get(chosen());
  $("effort-skips").textContent = skips ? `Leaves out: ${skips}.` : "";
}

async function drawBudget() {
  const time = $("budget").value, line = document.querySelector(`[data-effort=${BUDGET}]`);
  while (line.children.length > 1) line.lastElementChild.remove();
  omitted.delete(BUDGET);
  if (time) {
    const answer = await read(`efforts.json?time=${encodeURIComponent(time)}`);
    if (!answer || time !== $("budget").value) return;
    if (answer.problem) line.append(element("td", { colspan: 7 }, answer.problem));
    else {
      line.append(...cells(answer[0]));
      omitted.set(BUDGET, answer[0].skips);
      if (!answer[0].measured.length) line.append(element("td", { colspan: 6 }, "shorter than any budget that was measured"));
    }
  }
  drawSkips();
}

// The choice by the command line's flags; nothing for the usual one, which other options may rule out.
export function effort() {
  if (chosen() === BUDGET) return $("budget").value ? { "--time": $("budget").value } : {};
  return chosen() && chosen() !== usual ? { "--effort": chosen() } : {};
}
