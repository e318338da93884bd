// Along the body: what the localizer believes of a contact's place, over what every sensor reads
// against what the free body would read there. Both share the axis, from the base to the tip.

import { $, COLUMN, SENSORS, columns, density, element, index, muscles, pointEstimate, posterior as shown, store } from "./store.js";
import { line, make, rounded, sized, text, ticks } from "./svg.js";

const svg = $("body");
const layer = make("g", {}, svg);
const PAD = { left: 56, right: 14, top: 22, bottom: 34, between: 30 };
const NARROW = 450; // px: a phone
let least = .02;
let drawn = "";

export function forget() { drawn = ""; least = .02; }

export function drawBodyChart() {
  const width = svg.clientWidth, height = svg.clientHeight;
  const row = index(), { last, page } = store;
  const values = row < 0 ? [] : Array.from({ length: 2 * SENSORS }, (_, n) => store.columns[COLUMN.curvature + n][row]);
  const key = JSON.stringify([width, height, row, shown()?.t_s, shown()?.side, last.contacts?.t_s, page?.body]);
  if (key === drawn || width < 10) return;
  drawn = key;
  layer.replaceChildren();
  const longest = page?.body?.length_cm ?? 60;
  const X = (arc) => PAD.left + arc / longest * (width - PAD.left - PAD.right);
  const upper = { y0: PAD.top, y1: PAD.top + (height - PAD.top - PAD.bottom - PAD.between) * .42 };
  const lower = { y0: upper.y1 + PAD.between, y1: height - PAD.bottom };
  for (const arc of ticks(0, longest, Math.max(4, width / 90))) {
    make("line", { x1: X(arc), x2: X(arc), y1: upper.y0, y2: lower.y1, stroke: "var(--grid)" }, layer);
    text(layer, X(arc), lower.y1 + 15, arc, { "text-anchor": "middle", fill: "var(--faint)" });
  }
  text(layer, width - PAD.right, height - 4, "arc length from the base, cm", { "text-anchor": "end" });
  const length = store.columns[COLUMN.length][row];
  if (length > 0 && length < longest) {
    make("rect", { x: X(length), y: upper.y0, width: X(longest) - X(length), height: lower.y1 - upper.y0, fill: "var(--paper)", opacity: .75 }, layer);
    make("line", { x1: X(length), x2: X(length), y1: upper.y0, y2: lower.y1, stroke: "var(--tube-edge)", "stroke-dasharray": "2 3" }, layer);
    const near = X(length) > width - 60;
    text(layer, X(length) + (near ? -5 : 5), upper.y0 + 9, "tip", { "text-anchor": near ? "end" : "start", fill: "var(--soft)" });
  }
  drawLegend();
  drawDensity(upper, X);
  drawCurvature(values, lower, X);
}

function drawDensity({ y0, y1 }, X) {
  const posterior = shown(), { contacts } = store.last;
  make("line", { x1: PAD.left, x2: X(store.page?.body?.length_cm ?? 60), y1: y1, y2: y1, stroke: "var(--line)" }, layer);
  text(layer, 14, (y0 + y1) / 2, "1/cm", { transform: `rotate(-90 14 ${(y0 + y1) / 2})`, "text-anchor": "middle" });
  let words = "no contact measured at this stage yet";
  if (posterior?.places_cm.length > 1) {
    const { places_cm: places, side } = posterior, dense = density(posterior);
    const most = Math.max(...dense), Y = (value) => y1 - value / most * (y1 - y0 - 12);
    const curve = places.map((arc, n) => [X(arc), Y(dense[n])]);
    make("path", { d: `${line([[X(places[0]), y1], ...curve, [X(places.at(-1)), y1]])}Z`, fill: "var(--contact)", "fill-opacity": .22 }, layer);
    make("path", { d: line(curve), fill: "none", stroke: "var(--contact)", "stroke-width": 1.6 }, layer);
    for (const value of ticks(0, most, 3).slice(1)) {
      text(layer, PAD.left - 8, Y(value) + 4, +value.toPrecision(3), { "text-anchor": "end", fill: "var(--faint)" });
    }
    const what = svg.clientWidth < NARROW ? "contact" : "probability density of a contact";
    const muscle = muscles().find((each) => each.side === side)?.name ?? side;
    words = `${what}, by ${posterior.sweeping ? "this sweep so far" : "the last sweep alone"}, ${muscle} muscle`;
  } else if (posterior) {
    words = `${posterior.sweeping ? "this sweep so far" : "the last sweep"}: ${posterior.status}`;
  }
  text(layer, PAD.left, y0 - 8, words, { fill: "var(--soft)" });
  for (const contact of contacts?.contacts ?? []) {
    const [low, high] = contact.interval_cm;
    if (!pointEstimate(contact)) make("line", { x1: X(low), x2: X(high), y1: y1 + 8, y2: y1 + 8, stroke: "var(--contact)", "stroke-width": 5, "stroke-opacity": .4, "stroke-linecap": "round" }, layer);
    make("circle", { cx: X(contact.arc_cm), cy: y1 + 8, r: 4, fill: "var(--contact)" }, layer);
  }
}

const has = Number.isFinite;

function drawCurvature(values, { y0, y1 }, X) {
  const known = values.filter((value, n) => has(value) && (n >= SENSORS || values[n + SENSORS] !== null));
  least = Math.max(least, ...known.map(Math.abs));
  const most = Math.ceil(least * 100) / 100, Y = (value) => (y0 + y1) / 2 - value / most * (y1 - y0) / 2;
  for (const value of [-most, 0, most]) {
    make("line", { x1: PAD.left, x2: X(store.page?.body?.length_cm ?? 60), y1: Y(value), y2: Y(value), stroke: value ? "var(--grid)" : "var(--line)" }, layer);
    text(layer, PAD.left - 8, Y(value) + 4, rounded(value, 2), { "text-anchor": "end", fill: "var(--faint)" });
  }
  text(layer, 14, (y0 + y1) / 2, "curvature, 1/cm", { transform: `rotate(-90 14 ${(y0 + y1) / 2})`, "text-anchor": "middle" });
  if (!values.length) return;
  for (const { side, inputs, centers_cm: centers } of columns()) {
    centers.forEach((arc, n) => {
      const read = values[inputs[n]], free = values[SENSORS + inputs[n]], colour = `var(--${side})`;
      const x = X(arc) + (side === "left" ? -5 : 5);
      if (has(read) && has(free)) make("line", { x1: x, x2: x, y1: Y(read), y2: Y(free), stroke: colour, "stroke-width": 1.5, "stroke-opacity": .45 }, layer);
      if (has(free)) make("line", { x1: x - 7, x2: x + 7, y1: Y(free), y2: Y(free), stroke: colour, "stroke-width": 2, "stroke-opacity": .75 }, layer);
      if (has(read)) {
        const opacity = has(free) ? 1 : .25; // the inflated side wrinkles
        if (side === "left") make("circle", { cx: x, cy: Y(read), r: 4.2, fill: colour, opacity, stroke: "var(--card)", "stroke-width": 1.2 }, layer);
        else make("rect", { x: x - 3.7, y: Y(read) - 3.7, width: 7.4, height: 7.4, fill: colour, opacity, stroke: "var(--card)", "stroke-width": 1.2, transform: `rotate(45 ${x} ${Y(read)})` }, layer);
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

sized(svg, () => { drawn = ""; drawBodyChart(); });
