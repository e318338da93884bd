// A finished run: all of it is loaded, and the player moves the moment that is shown. The space bar
// stays the stop's, also here; P plays, the arrow keys go a second back and forth.

import { runAt, runName } from "./result.js";
import { $, BOARD, COLUMN, COLUMNS, SENSORS, add, hold, reset, store, time, until } from "./store.js";
import { make, rounded } from "./svg.js";
import { technical } from "./words.js";

const ONCE = ["event", "log"]; // listed; what else is recorded holds until the next of its kind
let messages = [], boards = [], end = 0, playing = null, loads = 0;

export const shown = () => document.body.dataset.mode === "record";

export async function loadRecord() {
  const mine = ++loads;
  end = 0;
  const record = await readRecord(runName(store.page.run.folder));
  if (!record) return; // its folder has gone, or the server
  const { facts, columns } = record;
  if (mine !== loads || !shown()) return;
  reset();
  store.origin = facts.origin_s;
  store.columns.forEach((_, n) => {
    store.columns[n] = Array.from(columns[n], (value) => Number.isNaN(value) ? null : value);
  });
  boards = facts.boards;
  messages = facts.messages.filter((message) => !ONCE.includes(message.channel));
  for (const message of facts.messages) if (ONCE.includes(message.channel)) add(message);
  end = Math.max(store.columns[0].at(-1) ?? 0, ...facts.messages.map((message) => time(message.t_s)));
  $("scrub").max = end;
  seek(end);
  drawMarks();
}

// A finished run's messages, and its readings as the store's columns with NaN for what is not known;
// nothing where it cannot be read.
export async function readRecord(name) {
  const answers = await Promise.all(["record.json", "record.f32"].map((part) => fetch(`${runAt(name)}/${part}`))).catch(() => []);
  if (!answers.length || !answers.every((answer) => answer.ok)) return null;
  const facts = await answers[0].json(), values = new Float32Array(await answers[1].arrayBuffer());
  const count = values.length / COLUMNS;
  const columns = Array.from({ length: COLUMNS }, (_, n) => values.subarray(n * count, (n + 1) * count));
  for (let n = 0; n < SENSORS; n++) {
    const expected = columns[COLUMN.expected + n];
    columns[COLUMN.telling + n] = columns[COLUMN.curvature + n].map((value, row) => Number.isNaN(expected[row]) ? NaN : value);
  }
  return { facts, columns };
}

export const loaded = () => end > 0;

const recorded = (channel) => messages.filter((message) => message.channel === channel);

export function seek(t) {
  store.now = Math.min(Math.max(t, 0), end);
  Object.assign(store, { last: {}, trail: [], touched: null });
  for (const message of messages) if (time(message.t_s) <= store.now + 1e-9) hold(message);
  store.board = boards[until(boards, store.now, (entry) => entry.t) - 1] ?? BOARD;
  $("scrub").value = store.now;
  $("scrub").setAttribute("aria-valuetext", `${rounded(store.now, 1)} s`);
  $("position").textContent = `${rounded(store.now, 1)} of ${rounded(end, 1)} s`;
}

// Stages as bands, events and contacts as marks.
function drawMarks() {
  const svg = $("marks");
  svg.setAttribute("viewBox", `0 0 ${end || 1} 36`);
  svg.replaceChildren();
  make("rect", { x: 0, y: 14, width: end, height: 8, fill: "var(--line)", rx: 0 }, svg);
  let stage = null, shade = 0;
  const states = recorded("state");
  for (const state of states) {
    if (state.stage_cm === stage) continue;
    stage = state.stage_cm;
    const next = states.find((later) => later.t_s > state.t_s && later.stage_cm !== stage);
    const start = time(state.t_s), stop = next ? time(next.t_s) : end;
    if (stage) make("rect", { x: start, y: 14, width: stop - start, height: 8, fill: "var(--accent)", opacity: [.3, .55][shade++ % 2] }, svg);
  }
  const tick = end / 500;
  for (const event of store.events) {
    if (event.severity === "info" || technical(event)) continue;
    make("rect", { x: time(event.t_s) - tick / 2, y: 8, width: tick, height: 20, fill: `var(--${event.severity === "fault" ? "fault" : "warn"})` }, svg);
  }
  let shownContacts = 0;
  for (const message of recorded("contacts")) {
    if (message.contacts.length > shownContacts) make("rect", { x: time(message.t_s) - tick, y: 6, width: 2 * tick, height: 24, fill: "var(--contact)" }, svg);
    shownContacts = message.contacts.length;
  }
}

export function connectPlayer(changed) {
  const show = (t) => { seek(t); changed(); };
  let before_ms = 0;
  function run(at_ms) {
    if (playing === null) return;
    if (!shown() || !loaded()) return halt();
    const moment = store.now + (at_ms - before_ms) / 1000 * Number($("speed").value);
    before_ms = at_ms;
    show(moment);
    if (moment >= end) return halt();
    playing = requestAnimationFrame(run);
  }
  function halt() {
    if (playing !== null) cancelAnimationFrame(playing);
    playing = null;
    $("play").textContent = "Play";
  }
  function toggle() {
    if (playing !== null) return halt();
    if (store.now >= end - .01) seek(0);
    before_ms = performance.now();
    playing = requestAnimationFrame(run);
    $("play").textContent = "Hold";
  }
  $("play").addEventListener("click", toggle);
  $("scrub").addEventListener("input", () => { show(Number($("scrub").value)); });
  window.addEventListener("keydown", (event) => {
    if (!shown() || !loaded() || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (event.key === "p" || event.key === "P") toggle();
    else if (event.key === "Home") show(0);
    else if (event.key === "End") show(end);
    else if (step && event.target.tagName !== "SELECT") show(store.now + step * (event.shiftKey ? 10 : 1));
    else return;
    event.preventDefault();
  });
}
