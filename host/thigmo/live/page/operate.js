// What finishes the job on a robot that has stopped: clear, retract and jog; and the parameters of
// the next exploration. A motion goes on only while somebody can see this page: signs of life go to
// the server, which hands them on to the command that moves the robot.

import { connectEfforts, effort } from "./efforts.js";
import { read } from "./feed.js";
import { $, COLUMN, element, latest, store } from "./store.js";

const SIGN_MS = 250;
const ASKED = {
  clear: ["The robot was stopped. Look at it: is nothing caught, and is nobody near? Then it may move again.", "Clear the stop"],
  retract: ["The muscles are emptied first, then the robot is wound in. It goes on while this page is open and in view.", "Retract"],
};
let pendingCommand = null; // what is to be confirmed

export function connectOperate(send) {
  for (const name of Object.keys(ASKED)) $(name).addEventListener("click", () => ask(pendingCommand === name ? null : name));
  $("sure-no").addEventListener("click", () => ask(null));
  $("sure").addEventListener("submit", (event) => {
    event.preventDefault();
    send({ command: pendingCommand, length: $("length-now").value, to: $("length-to").value });
    ask(null);
  });
  $("jog").addEventListener("submit", (event) => {
    event.preventDefault();
    send({ command: "jog", way: event.submitter.value, cm: $("jog-cm").value });
  });
  setInterval(() => {
    const { page } = store;
    if (page?.started?.held && page.started.runs && page.operates && !document.hidden) send({ command: "hold" });
  }, SIGN_MS);
  read("parameters.json").then((parameters) => parameters && drawParameters(parameters));
  connectEfforts();
}

function ask(command) {
  pendingCommand = command;
  $("sure").hidden = !command;
  if (!command) return;
  const retracts = command === "retract", length = latest(COLUMN.length);
  [$("sure-text").textContent, $("sure-yes").textContent] = ASKED[command];
  $("sure-lengths").hidden = !retracts;
  $("length-now").required = $("length-to").required = retracts;
  $("length-now").value = Number.isFinite(length) ? length.toFixed(1) : "";
  (retracts ? $("length-now") : $("sure-yes")).focus();
}

const EFFORT = ["--effort", "--time"]; // chosen above the other parameters, with what to expect

function drawParameters(parameters) {
  const fields = parameters.filter(({ flag }) => !EFFORT.includes(flag));
  $("parameter-fields").replaceChildren(...fields.map(({ flag, label, help, choices, number }) => {
    const field = choices.length
      ? element("select", {}, element("option", { value: "" }, "as usual"), ...choices.map((choice) => element("option", {}, choice)))
      : element("input", number ? { type: "number", min: 0 } : { autocomplete: "off" });
    field.dataset.flag = flag;
    const words = element("label", {}, label, field);
    return element("div", {}, words, element("p", { class: "muted" }, help));
  }));
}

// What the operator has given, by the command line's flags.
export const parameters = () => ({ ...effort(), ...Object.fromEntries(
  [...$("parameter-fields").querySelectorAll("[data-flag]")].map((field) => [field.dataset.flag, field.value]).filter(([, value]) => value),
) });

export function drawOperate(rests, operates) {
  const { page } = store;
  const parametrized = rests && !!page?.start && $("parameter-fields").children.length > 0;
  const finishes = rests && !!page?.robot;
  $("operate").hidden = !parametrized && !finishes;
  $("parameters").hidden = !parametrized;
  $("efforts").hidden = !parametrized || !$("effort-choices").children.length;
  $("finish").hidden = !finishes;
  if (!finishes || !operates) { if (pendingCommand) ask(null); }
  $("finish-robot").textContent = page?.robot ?? "";
  $("clear").disabled = !operates;
  $("jog-cm").max = page?.jog_cm ?? 0;
  for (const button of [$("retract"), ...$("jog").querySelectorAll("button")]) button.disabled = !operates || page?.latched;
}
