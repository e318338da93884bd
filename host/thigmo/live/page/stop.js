// Stop: without confirmation, by a press on the button, the space bar or Escape, wherever the focus
// is; where text is typed, Space is text and Escape alone stops. Each stop is a request of its own,
// beside the stream, so that a page that is behind with its drawing stops as fast as any. What the
// button says is what is known: whom a stop is for, that its board has confirmed it, that it has not,
// or why no stop would arrive.

import { $, store } from "./store.js";

const PRESSED = "stopped at"; // kept while this page is open, also when it is loaded again
const REPEAT_MS = 400; // of a stop that found no server
const PATIENCE_MS = 5000;
const button = $("stop");
const [word, says, robot] = button.children;
let state = "idle", pending = false, outcome = null;
let last_s = 0, stoppedRun = null; // when a stop was last answered, and of which run it was

// What one types into, and where a space is therefore no stop.
const TYPED = "textarea, [contenteditable], input:not([type=range], [type=checkbox], [type=radio], [type=button])";
export const typed = (target) => target instanceof Element && target.matches(TYPED);
// Whether what was stopped was emulated, and its program has ended.
const hasEnded = () => stopped().length > 0 && stopped().every((answer) => answer.confirmed_by.startsWith("the end"));
// What the last stop on a page came to, if it is the one that lasts: a robot may be stopped elsewhere.
function stopped() {
  const { page } = store;
  return page?.latched && page.stopped.at_s !== outcome?.at_s ? [] : outcome?.robots ?? [];
}
const keys = () => typed(document.activeElement) ? "Esc" : "Space or Esc";

const WORDS = {
  idle: ["Stop", keys],
  ready: ["Stop", keys],
  stopping: ["Stopping", "waiting for the board"],
  stopped: ["Stopped", () => hasEnded() ? "it has ended with its run" : "the board has confirmed"],
  unconfirmed: ["Not confirmed", "use the e-stop"],
  lost: ["Stop not connected:", "use the e-stop"],
};

function show(next) {
  state = next;
  button.dataset.state = { unconfirmed: "lost" }[next] ?? next;
  word.textContent = WORDS[next][0];
  document.body.dataset.stop = next;
  sayKeys();
  name();
}

// Whom the stop is or was for, or why there is nobody.
function name() {
  const { page } = store, robots = stopped();
  if (state === "stopped" && robots.length) {
    robot.textContent = robots.map((answer) => answer.robot).join(", ");
    button.title = robots.map((answer) => `${answer.robot}: confirmed by ${answer.confirmed_by}`).join("\n");
    return;
  }
  const nobody = state === "idle" || state === "lost";
  robot.textContent = (nobody && page?.stop_why_not) || (page ? page.stop_robot ?? "all robots in use" : "");
  button.title = state === "unconfirmed" ? outcome?.failed ?? "" : "";
}

// The keys that stop now: they depend on where the focus is.
function sayKeys() {
  const hint = WORDS[state][1];
  says.textContent = typeof hint === "string" ? hint : hint();
}
for (const kind of ["focusin", "focusout"]) document.addEventListener(kind, () => setTimeout(sayKeys));

// What is known of the way to the robot: "none" while nothing runs, "lost" where nobody owns its port
// any more, "offline" where this page has lost its server. What became of a stop is shown until the
// robot is let go, or something runs again.
export function stopReaches(way, page = null) {
  if (pending || page && (page.last_stop?.at_s ?? 0) < last_s) return; // it was sent before
  let next = { none: "idle", lost: "lost", offline: "lost" }[way] ?? "ready";
  if (page?.last_stop) outcome = page.last_stop;
  if (page?.latched) next = "stopped";
  else if (state === "unconfirmed" && page && page.run?.id === stoppedRun) return;
  if (state !== next) show(next);
  else {
    sayKeys(); // a field that is hidden loses the focus without an event
    name();
  }
}

// When this page last stopped a robot, by the server's clock.
export const pressedHere = () => Number(sessionStorage.getItem(PRESSED));

export async function stop() {
  if (document.body.dataset.mode === "record" || pending) return;
  pending = true;
  stoppedRun = store.page?.run?.id;
  show("stopping");
  const end = performance.now() + PATIENCE_MS;
  let next = "lost";
  while (performance.now() < end) {
    try {
      const answer = await fetch("stop", { method: "POST", keepalive: true, cache: "no-store" });
      outcome = await answer.json();
      if (outcome.robots.length) last_s = outcome.at_s;
      if (outcome.stopped.length) sessionStorage.setItem(PRESSED, last_s);
      next = outcome.failed ? "unconfirmed" : outcome.robots.length ? "stopped" : "idle";
      break;
    } catch {
      show("lost");
      await new Promise((go) => setTimeout(go, REPEAT_MS));
    }
  }
  pending = false;
  show(next);
}

button.addEventListener("pointerdown", (event) => { if (event.button === 0) stop(); });
button.addEventListener("click", stop); // assistive technology, and Enter

// Both the press and the release are taken: a browser clicks a focused button on either.
for (const kind of ["keydown", "keyup"]) {
  window.addEventListener(kind, (event) => {
    const space = event.code === "Space" || event.key === " ";
    if (event.key !== "Escape" && !(space && !typed(event.target))) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (kind === "keydown" && !event.repeat) stop();
  }, { capture: true });
}
