// The list of finished runs: find one, open it, or lay it over what is shown, in the room and in the
// signals, with both runs' contacts beside each other.

import { read } from "./feed.js";
import { readRecord } from "./player.js";
import { runAt, runName } from "./result.js";
import { $, element, store } from "./store.js";
import { minus, rounded } from "./svg.js";

let loadingRun = null; // the run that is about to be laid over
let runs = [], listedFor = null, compared = "", redraw = () => {};

export function connectRuns(open, changed) {
  redraw = changed;
  $("runs-find").addEventListener("input", drawRows);
  $("runs-clear").addEventListener("click", () => overlay(null));
  $("run-rows").addEventListener("click", (event) => {
    const { run, job } = event.target.dataset;
    if (job === "open") open(run);
    if (job === "overlay") overlay(store.overlay?.run === run ? null : run);
  });
}

const shownRun = () => store.page?.run?.folder ? runName(store.page.run.folder) : "";
const moves = () => store.page?.mode === "live" && !store.page.ended;

// The list is asked for again whenever a run has begun or ended.
export function drawRuns() {
  const key = `${store.page?.run?.id} ${moves()}`;
  if (key === listedFor) return compare();
  listedFor = key;
  read("runs.json").then((list) => {
    if (!list || list.problem) return;
    runs = list.runs;
    $("runs-folder").textContent = list.folder;
    drawRows();
    compare();
  });
}

function drawRows() {
  const words = $("runs-find").value.toLowerCase();
  const matches = runs.filter((run) => JSON.stringify(Object.values(run)).toLowerCase().includes(words));
  $("runs-count").textContent = runs.length ? `${matches.length} of ${runs.length}` : "";
  $("runs-empty").hidden = matches.length > 0;
  $("runs-empty").textContent = runs.length ? "No run has this text." : "No run yet.";
  $("runs-table").hidden = !matches.length;
  $("run-rows").replaceChildren(...matches.map(row));
}

function row({ run, problem, started, effort, outcome, contacts, robot_time_s, error_cm }) {
  const cells = problem ? [problem, "", "", "", ""] : [
    outcome, effort, contacts, `${rounded(robot_time_s, 0)} s`,
    error_cm === null ? "" : `${rounded(error_cm, 1)} cm`,
  ];
  const overlaid = store.overlay?.run === run, isShown = shownRun() === run;
  const button = (job, text, off) => {
    const control = element("button", { type: "button", "data-run": run, "data-job": job, "aria-label": `${text} ${run}` }, text);
    control.disabled = !!off;
    return control;
  };
  const lay = button("overlay", loadingRun === run ? "Reading …" : overlaid ? "Take off" : "Overlay", problem || isShown || loadingRun === run);
  lay.setAttribute("aria-pressed", String(overlaid));
  const opens = button("open", isShown ? "Shown" : "Open", problem || isShown || moves());
  if (moves()) opens.title = "A run is under way; open this one when it has ended.";
  return element("tr", isShown ? { class: "here" } : {},
    element("td", {}, element("b", {}, run), element("div", { class: "muted" }, (started ?? "").replace("T", " ").slice(0, 16))),
    ...cells.map((cell) => element("td", {}, String(cell))),
    element("td", { class: "jobs" }, opens, lay));
}

async function overlay(run) {
  loadingRun = run;
  drawRows();
  const record = run && await loaded(run);
  if (loadingRun !== run) return; // another one was chosen meanwhile
  loadingRun = null;
  store.overlay = record;
  compared = "";
  $("compared").hidden = true;
  $("runs-clear").hidden = !store.overlay;
  drawRows();
  compare();
  redraw();
}

async function loaded(run) {
  const page = await read(`${runAt(run)}/page.json`), record = await readRecord(run);
  if (!page || page.problem || !record) return null;
  const { facts, columns } = record;
  const contacts = facts.messages.filter((message) => message.channel === "contacts").at(-1)?.contacts ?? [];
  return { run, body: page.body, columns, contacts };
}

// Both runs' contacts, paired as `thigmo runs` pairs them.
async function compare() {
  const shown = shownRun(), overlaid = store.overlay?.run;
  const key = overlaid && shown && !moves() ? `${shown} ${overlaid}` : "";
  if (key === compared) return;
  compared = key;
  $("compared").hidden = true;
  if (!key) return;
  const pairs = await read(`${runAt(shown)}/beside/${encodeURIComponent(overlaid)}.json`);
  if (!pairs || pairs.problem || key !== compared) return;
  $("compared-first").textContent = shown;
  $("compared-second").textContent = overlaid;
  $("compared-rows").replaceChildren(...pairs.map(({ first, second, distance_cm: apart }) => element("tr", {},
    element("td", {}, minus(first ?? "not found")), element("td", {}, minus(second ?? "not found")),
    element("td", {}, apart === null ? "" : `${rounded(apart, 1)} cm`))));
  $("compared").hidden = !pairs.length;
}
