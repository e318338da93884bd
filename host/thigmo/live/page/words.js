// What is said in words: the header, banners, contacts and events.

import { question } from "./control.js";
import { pressedHere } from "./stop.js";
import { $, COLUMN, age, muscles, element, latest, store, time } from "./store.js";
import { minus, rounded } from "./svg.js";

const ICONS = {
  info: '<svg class="icon" viewBox="0 0 12 12" aria-label="info"><circle cx="6" cy="6" r="3" fill="var(--faint)"/></svg>',
  warning: '<svg class="icon" viewBox="0 0 12 12" aria-label="warning"><path d="M6 1.2 11.4 11H.6Z" fill="var(--warn)"/></svg>',
  fault: '<svg class="icon" viewBox="0 0 12 12" aria-label="fault"><path d="M3.6.8h4.8l2.8 2.8v4.8l-2.8 2.8H3.6L.8 8.4V3.6Z" fill="var(--fault)"/></svg>',
};
// Of each command that finishes the job: while it runs, once it has ended well, and its name.
const MOTIONS = {
  clear: ["Clearing the stop", "Cleared", "Clear"],
  retract: ["Retracting", "Retracted", "The retraction"],
  jog: ["Jogging", "Jogged", "The jog"],
};
const EMPTY_PSI = .5;
const SHOWN = 300;
let listed;

// `null` is nothing that comes: what was listed before goes also where no message follows.
export function forget() { listed = { events: null, count: 0, contacts: null, banners: null, technical: listed?.technical ?? false }; }
forget();

// As a sentence: events come as clauses.
const sentence = (words) => words && words[0].toUpperCase() + words.slice(1) + (/[.!?:]$/.test(words) ? "" : ".");
// Lines break after a semicolon and before a bracket only: a number stays with its unit.
const unbroken = (words) => minus(words).replaceAll(/(?<!;) (?!\()/g, "\u00a0");
const fixed = (value, digits) => Number.isFinite(value) ? rounded(value, digits) : "–";

export function drawWords(lost) {
  const { page, last, board } = store;
  const state = last.state;
  const run = page?.run;
  const title = run?.name ?? (page?.start ? "Ready" : "thigmo");
  $("run-name").textContent = title;
  $("run-url").textContent = run?.url ?? page?.start?.url ?? "";
  $("run-url").title = [run?.url, run?.folder].filter(Boolean).join("\n");
  $("doing").textContent = doing(lost);
  const done = rounded(100 * (state?.done ?? 0), 0);
  $("done").style.width = `${done}%`;
  $("done").parentElement.setAttribute("aria-valuenow", done);
  const hasReadings = store.columns[0].length > 0;
  $("clock").textContent = hasReadings ? fixed(store.now, 1) : "–";
  $("length").textContent = hasReadings ? fixed(latest(COLUMN.length), 1) : "–";
  $("phase").textContent = phase(board);
  const old = ago(age());
  $("age-fact").hidden = !old;
  $("age").textContent = old;
  $("room-age").textContent = old && `as read ${old}`;
  $("last-stop").textContent = lastStop();
  drawContactRows();
  drawEvents();
  drawBanners(lost);
}

// How empty the muscles are, as far as the board was heard after it had stopped.
function emptying() {
  const { board } = store;
  if (!board.faults.includes("stopped")) return "The board has not sent its pressures since.";
  const psi = muscles().map(({ output }) => Math.max(latest(COLUMN.pressure + output), 0)); // no -0.0
  const pressures = muscles().map(({ name }, n) => `${name} ${fixed(psi[n], 1)} psi`).join(", ");
  return `The muscles ${Math.max(...psi) < EMPTY_PSI ? "are empty" : "are emptying"}: ${pressures}.`;
}

// The board's state, by its last reading.
function phase({ state, faults }) {
  if (!state) return "–";
  return faults.length === 1 && faults[0] === "stopped" ? "stopped" : state.replaceAll("_", " ");
}

// Since when, in words; nothing for a moment ago.
function ago(seconds) {
  if (!seconds) return "";
  if (seconds < 100) return `${rounded(seconds, 0)} s ago`;
  return seconds < 5400 ? `${rounded(seconds / 60, 0)} min ago` : `${rounded(seconds / 3600, 0)} h ago`;
}

const clock = (at_s) => new Date(1000 * at_s).toLocaleTimeString("en-GB");

// Since when the robot is stopped, and from where, as far as it was on a page.
function stopped({ at_s, by }) {
  const place = at_s === pressedHere() ? " from this page" : by === "this computer" ? " from another page" : by && ` from ${by}`;
  return `Stopped${place}, ${clock(at_s)}`;
}

// Who stopped last, and what came of it: it stays shown, whatever runs next.
function lastStop() {
  const stop = store.page?.last_stop;
  if (!stop) return "";
  const came = stop.robots.map(({ robot, confirmed_by, failure }) =>
    failure ? `${robot} NOT confirmed: ${failure}` : `${robot} confirmed by ${confirmed_by}`);
  return `Last stop: ${clock(stop.at_s)}, pressed on ${stop.by}: ${came.join("; ")}.`;
}

function doing(lost) {
  const { page, last } = store;
  if (lost) return "No connection to the page’s server";
  if (!page) return "Connecting";
  const motion = MOTIONS[page.started?.name];
  if (motion && page.started.runs) return motion[0];
  if (page.starting) return "Starting";
  if (page.latched) return stopped(page.stopped);
  if (motion) return page.started.failure ? `${motion[2]} ended early` : motion[1];
  if (page.mode === "idle") {
    return page.start ? "Nothing runs yet" : "Waiting for a run: start one with thigmo explore";
  }
  if (question()) return "Waiting for your answer";
  const { state } = last;
  if (!state) return page.mode === "record" ? "Recorded run" : "Connected";
  if (state.outcome !== "running") return `Ended: ${state.outcome}`;
  if (page.ended && page.mode !== "record") return "Ended";
  return state.paused ? "Paused, vented" : state.doing;
}

function drawContactRows() {
  const { contacts } = store.last;
  if (listed.contacts === contacts) return;
  listed.contacts = contacts;
  const rows = contacts?.contacts ?? [];
  $("contacts-count").textContent = rows.length || "";
  $("contacts-empty").hidden = rows.length > 0;
  document.querySelector(".contacts table").hidden = !rows.length;
  $("contact-rows").replaceChildren(...rows.map((contact, n) => {
    const { place, along, interval, force, certainty } = contacts.words[n];
    const chip = element("span", { class: contact.status === "localized" ? "chip" : "chip ambiguous" }, unbroken(certainty));
    return element("tr", {},
      element("td", {}, element("b", {}, minus(place))),
      element("td", {}, element("b", {}, minus(along)), " ", element("span", { class: "muted" }, minus(interval))),
      element("td", {}, unbroken(force)),
      element("td", {}, chip, ...(contact.doubt ? [element("span", { class: "muted doubt" }, contact.doubt)] : [])));
  }));
}

function drawEvents() {
  const { events, page } = store;
  const list = $("events");
  if (listed.events !== events || listed.count > events.length) {
    list.replaceChildren();
    listed.events = events;
    listed.count = 0;
  }
  for (; listed.count < events.length; listed.count++) {
    list.prepend(entry(events[listed.count]));
    if (list.children.length > SHOWN) list.lastElementChild.remove();
  }
  // A board gets its configuration after it has missed it.
  for (const item of list.querySelectorAll('[data-name="bad_config"]')) {
    item.classList.toggle("detail", !store.board.faults.includes("bad_config"));
  }
  const operators = events.filter((event) => !technical(event)).length;
  $("events-empty").hidden = (listed.technical ? events.length : operators) > 0;
  $("events-count").textContent = listed.technical ? events.length || "" : operators || "";
  if (page?.mode === "record") {
    for (const item of list.children) item.classList.toggle("ahead", Number(item.dataset.t) > store.now);
  }
}

// What the board notes of a step that went as it should; and that it had no configuration before the
// run has sent it.
export const technical = ({ severity, name }) => severity === "info" && name !== "log" || name === "bad_config" && !store.board.faults.includes(name);

$("events-technical").addEventListener("click", () => {
  const shows = $("events").classList.toggle("technical");
  $("events-technical").setAttribute("aria-pressed", String(shows));
  listed.technical = shows;
  drawEvents();
});

function entry(event) {
  const body = element("div");
  // A hyphen before a number is its minus sign.
  body.append(element("span", { class: "what" }, sentence(event.message.replaceAll(/(?<=\s)-(?=\d)/g, "−"))));
  if (event.next) body.append(element("div", { class: "next" }, sentence(event.next)));
  const item = element("li", { class: `${event.severity}${technical(event) ? " detail" : ""}`, title: event.name });
  item.dataset.t = time(event.t_s);
  item.dataset.name = event.name;
  item.innerHTML = `<time>${fixed(time(event.t_s), 1)} s</time>${ICONS[event.severity] ?? ICONS.info}`;
  item.append(body);
  return item;
}

function drawBanners(lost) {
  const { page, board, events } = store;
  const banners = [];
  if (lost) {
    banners.push(["fault", "Stop not connected: use the e-stop.", "The page has lost its server. In a terminal, `thigmo stop` stops the robot as well."]);
  } else if (page?.mode === "live" && page.stop === "lost" && document.body.dataset.stop !== "stopped") {
    banners.push(["fault", "Stop not connected: use the e-stop.", page.stop_why_not]);
  }
  if (page?.mode === "live" && !lost && page.silent_s > 2 && !page.ended) {
    banners.push(["warning", `No reading for ${rounded(page.silent_s, 0)} s.`, "The run may hang. Stop works: the process that owns the port takes it."]);
  }
  const latched = page?.latched && !lost;
  if (latched) {
    banners.push(["note", `Valves off, motor braked. ${emptying()}`, page.robot
      ? "Look at the robot. Clear lets it move again; then Retract winds it in."
      : "This robot lives in its run and has ended with it. Start begins a new one."]);
  }
  for (const fault of board.faults) {
    if (fault === "stopped" && latched) continue;
    const event = events.findLast((candidate) => candidate.severity === "fault" && candidate.name === fault);
    banners.push(["fault", event?.message ?? `Fault: ${fault}.`, event?.next ?? ""]);
  }
  const { name, said: notice, failure } = page?.started ?? {};
  if (failure && !latched) banners.push(["fault", `${MOTIONS[name]?.[2] ?? "The run"} did not start, or ended early.`, failure]);
  else if (notice && name !== "explore") banners.push(["note", notice, ""]);
  if (store.dropped && performance.now() - store.droppedAt < 5000) {
    banners.push(["warning", `The charts of this page lack ${store.dropped} readings: this computer is busy.`, "The robot and its record miss none."]);
  }
  const key = JSON.stringify(banners);
  if (key === listed.banners) return;
  listed.banners = key;
  $("banners").replaceChildren(...banners.map(([kind, message, next]) => {
    const banner = element("div", { class: `banner ${kind}` }, element("b", {}, sentence(message)));
    if (next) banner.append(element("span", { class: "next" }, sentence(next)));
    return banner;
  }));
}
