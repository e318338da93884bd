// Start, pause, and who operates. A second page may look while one operates; it takes over when the
// first has gone. Every page can stop.

import { $, store } from "./store.js";

export function connectControl(send, lookBack) {
  $("start").addEventListener("click", () => send({ command: "start", realtime: $("pace").value === "realtime" }));
  $("pause").addEventListener("click", () => send({ command: asked() ? "resume" : "pause" }));
  $("take").addEventListener("click", () => send({ command: "take" }));
  $("open-record").addEventListener("click", lookBack);
  $("question").addEventListener("submit", (event) => {
    event.preventDefault();
    send({ command: "answer", text: $("answer").value });
    $("answer").value = "";
  });
}

// Whether the run waits between stages, or will.
const asked = () => store.last.state?.paused || store.page?.pausing;

export function drawControl(lost) {
  const { page, last } = store;
  const live = page?.mode === "live" && !page.ended;
  const operates = !!page?.operator && !lost;
  $("start").hidden = !(page?.start && !live);
  $("start").disabled = !operates || page?.starting;
  $("pace-row").hidden = $("start").hidden || !page?.start?.virtual;
  $("pause").hidden = !live;
  $("pause").disabled = !operates;
  $("pause").textContent = last.state?.paused ? "Go on" : page?.pausing ? "Do not pause" : "Pause after this stage";
  $("take").hidden = !page || page.operator || page.mode === "record";
  $("take").disabled = lost || !!page?.operated;
  $("take").textContent = page?.operated ? "Another page operates" : "Take control";
  $("open-record").hidden = !(page?.ended && page.mode === "live" && page.run?.folder);
  $("viewers").textContent = page?.viewers > 1 ? `${page.viewers} pages look at this robot.` : "";
  const question = page?.question ?? "";
  const fresh = question && $("question").hidden;
  $("question").hidden = !question;
  if ($("question-text").textContent !== question) $("question-text").textContent = question;
  $("answer").disabled = !operates;
  if (fresh && operates) $("answer").focus();
}
