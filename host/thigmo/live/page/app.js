// The page: takes the stream into the store and draws it, once a frame at most and never more often
// than this machine can.

import { drawBodyChart, forget as forgetBody } from "./body.js";
import { drawCharts, redrawCharts } from "./charts.js";
import { connectAttention, drawAttention } from "./attention.js";
import { connectControl, drawControl } from "./control.js";
import { listen, read } from "./feed.js";
import { connectKeys } from "./keys.js";
import { connectPlayer, loadRecord } from "./player.js";
import { drawResult, runAt, runName } from "./result.js";
import { drawRoom, forget as forgetRoom } from "./room.js";
import { connectRuns, drawRuns } from "./runs.js";
import { stopReaches } from "./stop.js";
import { $, add, addRows, reset, store } from "./store.js";
import { drawWords, forget as forgetWords } from "./words.js";

const AGES_MS = 1000; // a reading grows old also while nothing comes
let lost = false, asked = false, spent = 0;
let opened = null; // what the server says of the finished run that this page has opened
let retold = false; // the server is about to tell all of it once more
// For tests, pictures and the benchmark: what the page knows; how old the newest reading was each
// time that one was drawn, if they are to be kept; and whether the page is to stand still.
const hooks = (window.thigmo = { store, ages_s: [], keep: false, still: false });

function draw() {
  asked = false;
  if (hooks.still) return;
  const began = performance.now();
  const shownEpoch = store.epoch;
  drawWords(lost);
  drawControl(lost);
  drawAttention();
  drawResult();
  drawRuns();
  drawCharts();
  drawRoom();
  drawBodyChart();
  spent = performance.now() - began;
  if (hooks.keep && shownEpoch && shownEpoch !== store.drawnEpoch) {
    store.drawnEpoch = shownEpoch;
    hooks.ages_s.push(Date.now() / 1000 - shownEpoch);
  }
}

function ask() {
  if (asked) return;
  asked = true;
  // Half of the time is left for the messages that come meanwhile.
  const wait = Math.min(spent, 250);
  if (wait > 12) setTimeout(() => requestAnimationFrame(draw), wait);
  else requestAnimationFrame(draw);
}

function forget() { forgetBody(); forgetRoom(); forgetWords(); }

async function openRun(name) {
  const page = await read(`${runAt(name)}/page.json`);
  if (!page || page.problem) return; // its card tells why
  opened = page;
  takePage({ ...store.page });
  ask();
}

function takePage(message) {
  store.readAt = message.age_s === null || message.age_s === undefined ? null : performance.now() - 1000 * message.age_s;
  // A viewer of a robot that moves must be able to stop it: a run that begins is shown.
  if (message.mode === "live" && !message.ended) opened = null;
  if (opened) message = { ...message, ...opened, mode: "record" };
  const previous = store.page, same = previous?.run?.id === message.run?.id;
  store.page = message;
  document.body.dataset.mode = message.mode;
  $("player").hidden = message.mode !== "record";
  $("truth-legend").hidden = !message.truth?.length;
  const records = message.mode === "record";
  // A motion after a run that is looked back at adds to what is shown.
  if (!same || records && previous?.mode !== "record" || retold && message.mode === "live") {
    if (message.mode === "live" || records) {
      reset();
      store.origin = message.run?.t_s ?? null;
      forget();
    }
    if (records) loadRecord().then(ask);
  }
  retold = false;
  stopReaches(message.stop, message);
}

function batch(messages) {
  lost = false;
  for (const message of messages) {
    if (message.channel === "page") takePage(message);
    else if (message.channel === "telemetry") {
      store.readAt ??= performance.now();
      addRows(message);
    }
    else if (message.channel === "dropped") {
      store.dropped = message.count;
      store.droppedAt = performance.now();
    } else add(message);
  }
  ask();
}

const { send } = listen({
  opened: () => { retold = true; },
  batch,
  lost: () => { lost = true; if (store.page?.mode !== "record") stopReaches("offline"); ask(); },
});
setInterval(ask, AGES_MS);
connectControl(send, () => openRun(runName(store.page.run.folder)));
connectRuns(openRun, ask);
connectAttention();
connectKeys();
connectPlayer(ask);
redrawCharts();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { forgetRoom(); redrawCharts(); ask(); });
