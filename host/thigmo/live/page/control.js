// Start, pause, and who operates. The first page that asks for something operates until it has gone;
// others look. Every page can stop.

import { connectOperate, drawOperate, parameters } from "./operate.js";
import { $, element, store } from "./store.js";

export function connectControl(send, lookBack) {
  $("start").addEventListener("click", () => send({ command: "start", realtime: $("pace").value === "realtime", parameters: parameters() }));
  $("pause").addEventListener("click", () => send({ command: asked() ? "resume" : "pause" }));
  connectOperate(send);
  $("open-record").addEventListener("click", lookBack);
  $("choice").addEventListener("change", () => send({ command: "choose", pid: Number($("choice").value) }));
  $("question").addEventListener("submit", (event) => {
    event.preventDefault();
    const text = $("answer").value.trim(), missing = missingIn(text, store.last.question?.unit);
    $("answer-missing").textContent = missing;
    if (missing) return $("answer").focus();
    send({ command: "answer", text });
    $("answer").value = "";
  });
}

// Several runs may share a robot's address, where it is emulated, or none was given.
let listed = "";
function drawChoices(page, operates) {
  const choices = page?.choices ?? [];
  $("choice-row").hidden = !(choices.length > 1 && page.mode === "live");
  $("choice").disabled = !operates;
  const key = JSON.stringify([choices, page?.shown]);
  if (key === listed) return;
  listed = key;
  $("choice").replaceChildren(...choices.map(({ pid, name, url, folder }) => {
    const option = element("option", { value: pid, title: `${url}\n${folder}` }, `${name}, process ${pid}`);
    option.selected = pid === page.shown;
    return option;
  }));
}

// Whether the run waits between stages, or will.
const asked = () => store.last.state?.paused || store.page?.pausing;

export function drawControl(lost) {
  const { page, last } = store;
  const live = page?.mode === "live" && !page.ended;
  const moves = live && page.started?.runs && page.started.name !== "explore";
  const operates = !!page?.operates && !lost;
  $("start").hidden = !(page?.start && !live);
  $("start").disabled = !operates || page?.busy || page?.latched && !page.start?.virtual;
  $("pace-row").hidden = $("start").hidden || !page?.start?.virtual;
  $("pause").hidden = !live || moves;
  $("pause").disabled = !operates;
  $("pause").textContent = last.state?.paused ? "Go on" : page?.pausing ? "Do not pause" : "Pause after this stage";
  $("operated").hidden = !page || page.operates || page.mode === "record";
  $("open-record").hidden = !(page?.ended && page.mode === "live" && page.run?.folder);
  drawChoices(page, operates);
  $("viewers").textContent = page?.viewers > 1 ? `${page.viewers} pages look at this robot.` : "";
  drawOperate(!!page && !live && !page.busy && page.mode !== "record", operates);
  drawQuestion(question(), operates);
}

// What the run that is under way asks its operator: its text and the number's unit, or nothing.
export function question() {
  const { page, last } = store;
  return page?.mode === "live" && !page.ended && last.question?.text ? last.question : null;
}

// A number is typed in; what is only to be done takes a button.
let asks = null;
function drawQuestion(question, operates) {
  $("question").hidden = !question;
  $("answer").disabled = $("answer-send").disabled = !operates;
  if (question === asks) return;
  asks = question;
  if (!question) return;
  $("question-text").textContent = question.text;
  $("answer-missing").textContent = "";
  $("answer-field").hidden = !question.unit;
  $("answer-unit").textContent = question.unit;
  $("answer-send").textContent = question.unit ? "Answer" : "Done";
  if (operates) (question.unit ? $("answer") : $("answer-send")).focus();
}

// What an answer lacks; nothing if it has all.
function missingIn(text, unit) {
  if (!unit) return "";
  if (!text) return `The number is missing: type it in ${unit}, such as 20.5.`;
  const number = text.replace(unit, "").trim();
  return /^\d+([.,]\d*)?$/.test(number) ? "" : `“${text}” is not a number of ${unit}: type one such as 20.5.`;
}
