// Along the body: what the localizer believes of a contact's place, over what every sensor reads
// against what the free body would read there. Both share the axis, from the base to the tip.

import { $, COLUMN, SENSORS, columns, density, element, index, muscles, pointEstimate, posterior as shown, store } from "./store.js";
import { line, make, rounded, sized, text, ticks } from "./svg.js";

const svg = $("body");
const clip = make("rect", {}, make("clipPath", { id: "body-clip" }, svg));
const marks = make("g", { "clip-path": "url(#body-clip)" }, svg);
const layer = make("g", {}, svg); // what is written beside them
const PAD = { left: 56, right: 14, top: 22, bottom: 34, between: 30 };
const NARROW = 450; // px: a phone
const NARROWEST_CM = 2; // part of the body that is still shown
let least = .02;
let drawn = "";
let view = null; // the part of the body that was zoomed to, cm; null shows all of it

export function forget() { drawn = ""; least = .02; view = null; }

const longest = () => store.page?.body?.length_cm ?? 60;
const span = () => view ?? [0, longest()];
const plotWidth = () => svg.clientWidth - PAD.left - PAD.right;

// Show the body from an arc on, and so much of it, as far as there is a body.
function look(low, wide) {
  const width = Math.max(wide, NARROWEST_CM), start = Math.max(0, Math.min(low, longest() - width));
  view = width >= longest() ? null : [start, start + width];
  drawn = "";
  drawBodyChart();
}

export function drawBodyChart() {
  const width = svg.clientWidth, height = svg.clientHeight;
  const row = index(), { last, page } = store;
  const values = row < 0 ? [] : Array.from({ length: 2 * SENSORS }, (_, n) => store.columns[COLUMN.curvature + n][row]);
  const [low, high] = span();
  const key = JSON.stringify([width, height, row, low, high, shown()?.t_s, shown()?.side, last.contacts?.t_s, page?.body]);
  if (key === drawn || width < 10) return;
  drawn = key;
  layer.replaceChildren();
  marks.replaceChildren();
  const X = (arc) => PAD.left + (arc - low) / (high - low) * plotWidth();
  for (const [name, value] of Object.entries({ x: PAD.left, y: 0, width: Math.max(plotWidth(), 0), height })) clip.setAttribute(name, value);
  const upper = { y0: PAD.top, y1: PAD.top + (height - PAD.top - PAD.bottom - PAD.between) * .42 };
  const lower = { y0: upper.y1 + PAD.between, y1: height - PAD.bottom };
  for (const arc of ticks(low, high, Math.max(4, width / 90))) {
    make("line", { x1: X(arc), x2: X(arc), y1: upper.y0, y2: lower.y1, stroke: "var(--grid)" }, marks);
    text(layer, X(arc), lower.y1 + 15, +arc.toFixed(2), { "text-anchor": "middle", fill: "var(--faint)" });
  }
  text(layer, width - PAD.right, height - 4, "arc length from the base, cm", { "text-anchor": "end" });
  const length = store.columns[COLUMN.length][row];
  if (length > 0 && length < longest()) {
    make("rect", { x: X(length), y: upper.y0, width: X(longest()) - X(length), height: lower.y1 - upper.y0, fill: "var(--paper)", opacity: .75 }, marks);
    make("line", { x1: X(length), x2: X(length), y1: upper.y0, y2: lower.y1, stroke: "var(--tube-edge)", "stroke-dasharray": "2 3" }, marks);
    const near = X(length) > width - 60;
    text(marks, X(length) + (near ? -5 : 5), upper.y0 + 9, "tip", { "text-anchor": near ? "end" : "start", fill: "var(--soft)" });
  }
  drawLegend();
  drawDensity(upper, X);
  drawCurvature(values, lower, X);
}

function drawDensity({ y0, y1 }, X) {
  const posterior = shown(), { contacts } = store.last;
  make("line", { x1: PAD.left, x2: PAD.left + plotWidth(), y1: y1, y2: y1, stroke: "var(--line)" }, marks);
  text(layer, 14, (y0 + y1) / 2, "1/cm", { transform: `rotate(-90 14 ${(y0 + y1) / 2})`, "text-anchor": "middle" });
  let words = "no contact measured at this stage yet";
  if (posterior?.places_cm.length > 1) {
    const { places_cm: places, side } = posterior, dense = density(posterior);
    const most = Math.max(...dense), Y = (value) => y1 - value / most * (y1 - y0 - 12);
    const curve = places.map((arc, n) => [X(arc), Y(dense[n])]);
    make("path", { d: `${line([[X(places[0]), y1], ...curve, [X(places.at(-1)), y1]])}Z`, fill: "var(--contact)", "fill-opacity": .22 }, marks);
    make("path", { d: line(curve), fill: "none", stroke: "var(--contact)", "stroke-width": 1.6 }, marks);
    for (const value of ticks(0, most, 3).slice(1)) {
      text(layer, PAD.left - 8, Y(value) + 4, +value.toPrecision(3), { "text-anchor": "end", fill: "var(--faint)" });
    }
    const quantity = svg.clientWidth < NARROW ? "contact" : "probability density of a contact";
    const muscle = muscles().find((candidate) => candidate.side === side)?.name ?? side;
    words = `${quantity}, by ${posterior.sweeping ? "the sweeps so far" : "all its sweeps"}, ${muscle} muscle`;
  } else if (posterior) {
    words = `${posterior.sweeping ? "the sweeps so far" : "all sweeps of this side"}: ${posterior.status}`;
  }
  text(layer, PAD.left, y0 - 8, words, { fill: "var(--soft)" });
  for (const contact of contacts?.contacts ?? []) {
    const [low, high] = contact.interval_cm;
    if (!pointEstimate(contact)) make("line", { x1: X(low), x2: X(high), y1: y1 + 8, y2: y1 + 8, stroke: "var(--contact)", "stroke-width": 5, "stroke-opacity": .4, "stroke-linecap": "round" }, marks);
    make("circle", { cx: X(contact.arc_cm), cy: y1 + 8, r: 4, fill: "var(--contact)" }, marks);
  }
}

const has = Number.isFinite;

function drawCurvature(values, { y0, y1 }, X) {
  const measured = values.filter((value, n) => has(value) && (n >= SENSORS || values[n + SENSORS] !== null));
  least = Math.max(least, ...measured.map(Math.abs));
  const most = Math.ceil(least * 100) / 100, Y = (value) => (y0 + y1) / 2 - value / most * (y1 - y0) / 2;
  for (const value of [-most, 0, most]) {
    make("line", { x1: PAD.left, x2: PAD.left + plotWidth(), y1: Y(value), y2: Y(value), stroke: value ? "var(--grid)" : "var(--line)" }, marks);
    text(layer, PAD.left - 8, Y(value) + 4, rounded(value, 2), { "text-anchor": "end", fill: "var(--faint)" });
  }
  text(layer, 14, (y0 + y1) / 2, "curvature, 1/cm", { transform: `rotate(-90 14 ${(y0 + y1) / 2})`, "text-anchor": "middle" });
  if (!values.length) return;
  for (const { side, inputs, centers_cm: centers } of columns()) {
    centers.forEach((arc, n) => {
      const read = values[inputs[n]], free = values[SENSORS + inputs[n]], colour = `var(--${side})`;
      const x = X(arc) + (side === "left" ? -5 : 5);
      if (has(read) && has(free)) make("line", { x1: x, x2: x, y1: Y(read), y2: Y(free), stroke: colour, "stroke-width": 1.5, "stroke-opacity": .45 }, marks);
      if (has(free)) make("line", { x1: x - 7, x2: x + 7, y1: Y(free), y2: Y(free), stroke: colour, "stroke-width": 2, "stroke-opacity": .75 }, marks);
      if (has(read)) {
        const opacity = has(free) ? 1 : .25; // the inflated side wrinkles
        if (side === "left") make("circle", { cx: x, cy: Y(read), r: 4.2, fill: colour, opacity, stroke: "var(--card)", "stroke-width": 1.2 }, marks);
        else make("rect", { x: x - 3.7, y: Y(read) - 3.7, width: 7.4, height: 7.4, fill: colour, opacity, stroke: "var(--card)", "stroke-width": 1.2, transform: `rotate(45 ${x} ${Y(read)})` }, marks);
      }
    });
  }
}

function drawLegend() {
  const key = columns().map(({ name, side }) => {
    const shape = side === "left" ? "" : ";border-radius:1px;transform:rotate(45deg)";
    return element("span", {}, element("i", { class: "dot", style: `background:var(--${side})${shape}` }), `${name} sensor`);
  });
  $("body-legend").replaceChildren(
    ...key, element("span", {}, "pale: inflated side"), element("span", {}, element("i"), "what the free body would read"),
    element("span", {}, element("i", { class: "bar" }), "contact, 95 %"),
  );
}

svg.addEventListener("wheel", (event) => {
  event.preventDefault();
  const [low, high] = span(), share = (event.clientX - svg.getBoundingClientRect().left - PAD.left) / plotWidth();
  const wide = (high - low) * Math.exp(Math.max(-.5, Math.min(.5, event.deltaY / 240)));
  look(low + share * (high - low - wide), wide); // what is under the pointer stays there
}, { passive: false });
svg.addEventListener("pointerdown", (event) => {
  if (event.button !== 0 || !view) return;
  svg.setPointerCapture(event.pointerId);
  const [low, high] = view, start = event.clientX;
  svg.onpointermove = (move) => look(low - (move.clientX - start) / plotWidth() * (high - low), high - low);
  svg.onpointerup = svg.onpointercancel = () => { svg.onpointermove = null; };
});
svg.addEventListener("dblclick", () => look(0, longest()));

sized(svg, () => { drawn = ""; drawBodyChart(); });
