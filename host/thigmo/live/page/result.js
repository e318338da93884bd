// What a run came to, as a card: once it has ended, and for a run that is looked back at.

import { read } from "./feed.js";
import { $, element, store } from "./store.js";
import { rounded } from "./svg.js";

const MAP_MS = 1000; // a run draws its map after its end, so the page asks for it again,
const MAP_TRIES = 30; // so often
let drawn = null, asked = "";

export const runName = (folder) => folder.split(/[/\\]/).at(-1);
export const runAt = (name) => `runs/${encodeURIComponent(name)}`;

export function drawResult() {
  const { page } = store;
  const live = page?.mode === "live" && page.ended && page.run?.folder;
  if (live && asked !== page.run.id) {
    asked = page.run.id;
    ask(page.run);
  }
  const result = page?.result ?? (live && store.result?.id === page.run.id ? store.result : null);
  const card = result && page.run && { ...result, folder: page.run.folder };
  const key = JSON.stringify(card);
  if (key === drawn) return;
  drawn = key;
  $("result").hidden = !card;
  if (card) fill(card);
}

async function ask({ id, folder }, tries = MAP_TRIES) {
  const page = await read(`${runAt(runName(folder))}/page.json`);
  if (asked !== id) return;
  store.result = page && (page.problem ? { id, problem: page.problem } : { ...page.result, id });
  drawResult();
  if (tries && page?.result && !page.result.map) setTimeout(() => ask({ id, folder }, tries - 1), MAP_MS);
}

function fill({ outcome, effort, skips, robot_time_s, length_cm, contacts, error_cm, missed, false: wrong, map, folder, problem }) {
  $("result-title").textContent = problem ? "The record cannot be read" : `Result: ${outcome}`;
  const facts = problem ? [] : [
    ["contacts", contacts],
    ["robot time", `${rounded(robot_time_s, 0)} s`],
    ["everted", `${rounded(length_cm, 1)} cm`],
    ["effort", effort || "–"],
  ];
  // Only the emulator knows the truth.
  if (error_cm !== null && error_cm !== undefined) facts.push(["error against the emulator’s truth", `${rounded(error_cm, 1)} cm`]);
  if (Number.isInteger(missed)) facts.push(["missed", missed]);
  if (Number.isInteger(wrong)) facts.push(["false", wrong]);
  $("result-facts").replaceChildren(...facts.map(([term, value]) => (
    element("div", {}, element("dt", {}, term), element("dd", {}, String(value)))
  )));
  $("result-skips").textContent = problem ?? (skips && `Left out: ${skips}.`);
  $("result-folder").textContent = folder;
  $("result-map").hidden = !map;
  $("result-map").href = `${runAt(runName(folder))}/map.png`;
}

$("result-copy").addEventListener("click", async () => {
  await navigator.clipboard.writeText($("result-folder").textContent);
  $("result-copy").textContent = "Copied";
});
