// Calls for the operator who looks elsewhere: the tab's title says what a run wants, and a
// notification does if the browser may show one.

import { question } from "./control.js";
import { $, store } from "./store.js";

const CAN = "Notification" in window;
let lastWanted = null;

export function connectAttention() {
  $("notify").addEventListener("click", async () => {
    await Notification.requestPermission();
    drawAttention();
  });
}

// What a run wants or came to, in a few words; nothing while it goes on.
function wanted() {
  const { page, last } = store;
  if (!page?.run || page.mode !== "live") return "";
  if (page.latched) return "Stopped";
  if (question()) return "Asks you";
  if (page.ended) return "Ended";
  return last.state?.paused ? "Paused" : "";
}

export function drawAttention() {
  const { page } = store, name = page?.run?.name ?? "thigmo", want = wanted();
  document.title = [want, name].filter(Boolean).join(": ") + (page?.run ? " · thigmo" : "");
  $("notify").hidden = !(CAN && Notification.permission === "default" && page?.mode !== "record");
  // What was there when the page was opened is no news.
  const news = lastWanted !== null && want && want !== lastWanted;
  if (page) lastWanted = want;
  if (!news || !CAN || Notification.permission !== "granted" || document.hasFocus()) return;
  const text = question()?.text ?? store.last.state?.outcome ?? "";
  new Notification(`${want}: ${name}`, { body: text, tag: "thigmo" });
}
