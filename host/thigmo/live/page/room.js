// The room from above: what was swept, what is occupied, the robot, and its contacts with what is
// known of their place. x runs along the straight robot, y to its left, in cm.

import { COST, arrange, box } from "./labels.js";
import { $, COLUMN, age, columns, css, density, latest, pointEstimate, posterior, shade, store, time } from "./store.js";
import { line, make, minus, sized, text, ticks } from "./svg.js";

const SIGMA_95 = 2.4477; // radius of the 95 % ellipse of a normal law in the plane
const RIBBON_CM = 3.5; // height of the posterior at its peak
const FRESH_S = .7; // for which a posterior of mid-sweep moves with the body
const PAD = { left: 40, right: 10, top: 8, bottom: 34 };
const NONE = { contacts: [], words: [] };
const svg = $("room");
const layers = {};
const clip = make("rect", {}, make("clipPath", { id: "room-clip" }, svg));
for (const name of ["grid", "map", "reach", "swept", "truth", "body", "posterior", "overlay", "contacts", "labels"]) {
  layers[name] = make("g", { "data-layer": name, ...name !== "grid" && { "clip-path": "url(#room-clip)" } }, svg);
}
let view = null; // what was zoomed to: the middle in cm, and how much larger; null shows the whole room
const LARGEST = 40;
const bounds = { x0: -8, x1: 60, y0: -28, y1: 28 };
let frame = "", scale = 1, left = 0, top = 0, drawn = {};
let labels = []; // of the contacts: each with its place beside the contact, once it has one

const X = (x) => left + (x - bounds.x0) * scale;
const Y = (y) => top + (bounds.y1 - y) * scale;

export function forget() {
  drawn = {};
  labels = [];
  look(null);
  Object.assign(bounds, { x0: -8, x1: 60, y0: -28, y1: 28 });
}

function look(next) {
  view = next;
  $("room-whole").hidden = !view;
}

function include(x, y, margin = 3) {
  bounds.x0 = Math.min(bounds.x0, Math.floor((x - margin) / 4) * 4);
  bounds.x1 = Math.max(bounds.x1, Math.ceil((x + margin) / 4) * 4);
  bounds.y0 = Math.min(bounds.y0, Math.floor((y - margin) / 4) * 4);
  bounds.y1 = Math.max(bounds.y1, Math.ceil((y + margin) / 4) * 4);
}

function fit() {
  const width = svg.clientWidth, height = svg.clientHeight;
  const room = { w: width - PAD.left - PAD.right, h: height - PAD.top - PAD.bottom };
  scale = Math.min(room.w / (bounds.x1 - bounds.x0), room.h / (bounds.y1 - bounds.y0));
  left = PAD.left + (room.w - scale * (bounds.x1 - bounds.x0)) / 2;
  top = PAD.top + (room.h - scale * (bounds.y1 - bounds.y0)) / 2;
  if (view) {
    scale *= view.larger;
    left = PAD.left + room.w / 2 - (view.x - bounds.x0) * scale;
    top = PAD.top + room.h / 2 - (bounds.y1 - view.y) * scale;
  }
  const key = [width, height, ...Object.values(bounds), ...Object.values(view ?? {})].join();
  if (key === frame) return;
  frame = key;
  drawn = {};
  for (const [name, value] of Object.entries({ x: PAD.left, y: PAD.top, width: Math.max(room.w, 0), height: Math.max(room.h, 0) })) clip.setAttribute(name, value);
  // The grid fills the card; its numbers stand at the edges.
  const layer = layers.grid;
  layer.replaceChildren();
  const x0 = bounds.x0 - (left - PAD.left) / scale, x1 = bounds.x1 + (width - PAD.right - X(bounds.x1)) / scale;
  const y1 = bounds.y1 + (top - PAD.top) / scale, y0 = bounds.y0 - (height - PAD.bottom - Y(bounds.y0)) / scale;
  const count = Math.max(4, Math.round(width / 90));
  const step = (n) => { const [a, b] = ticks(x0, x1, n); return b - a; };
  const spacing = step(count);
  for (let x = Math.ceil(x0 / spacing) * spacing; x <= x1; x += spacing) {
    make("line", { x1: X(x), x2: X(x), y1: PAD.top, y2: height - PAD.bottom, stroke: "var(--grid)" }, layer);
    text(layer, X(x), height - PAD.bottom + 15, minus(x), { "text-anchor": "middle", fill: "var(--faint)" });
  }
  for (let y = Math.ceil(y0 / spacing) * spacing; y <= y1; y += spacing) {
    make("line", { y1: Y(y), y2: Y(y), x1: PAD.left, x2: width - PAD.right, stroke: "var(--grid)" }, layer);
    text(layer, PAD.left - 7, Y(y) + 4, minus(y), { "text-anchor": "end", fill: "var(--faint)" });
  }
  text(layer, width - PAD.right, height - 5, "x, along the straight robot, cm", { "text-anchor": "end" });
  text(layer, 12, PAD.top, "y, to its left, cm", { transform: `rotate(-90 12 ${PAD.top})`, "text-anchor": "end" });
}

export function drawRoom() {
  const { last, page } = store;
  if (page?.body) include(page.body.length_cm, 0, 5);
  for (const contact of last.contacts?.contacts ?? []) include(contact.x_cm, contact.y_cm, 6);
  for (const peg of page?.truth ?? []) include(peg.x_cm, peg.y_cm, peg.radius_cm + 2);
  for (const poses of store.trail) include(...poses.at(-1).slice(0, 2), 3);
  for (const [x, y] of last.shape?.poses ?? []) include(x, y);
  if (last.grid) {
    const { origin: [x, y], width, height, resolution_cm: size } = last.grid;
    include(x, y, 0);
    include(x + width * size, y + height * size, 0);
  }
  for (const contact of store.overlay?.contacts ?? []) include(contact.x_cm, contact.y_cm, 6);
  $("overlay-legend").hidden = !store.overlay;
  $("overlay-name").textContent = store.overlay?.run ?? "";
  fit();
  changed("map", last.grid, drawMap);
  changed("overlay", store.overlay, drawOverlay);
  const redrawn = [changed("truth", page?.truth, drawTruth), changed("contacts", last.contacts ?? NONE, drawContacts)];
  const length = latest(COLUMN.length) ?? page?.length_cm ?? 0;
  changed("reach", page?.mode === "idle" && page.body, drawReach);
  const shape = last.shape ?? (length > 0.5 ? straight(length) : null);
  redrawn.push(changed("body", shape && (last.shape ?? length.toFixed(1)), () => drawBody(shape)));
  changed("swept", store.trail.length ? store.trail.at(-1) : null, drawTrail);
  const measured = posterior(), moves = measured?.sweeping && store.now - time(measured.t_s) < FRESH_S;
  const poses = moves ? last.shape?.poses : store.touched;
  redrawn.push(changed("posterior", measured && poses && [measured.t_s, measured.side, moves && last.shape.t_s].join(), () => drawPosterior(measured, poses, moves)));
  svg.classList.toggle("old", age() > 0);
  if (redrawn.some(Boolean)) drawLabels(shape?.poses ?? [], measured && poses || []);
}

// Draw a layer again if what it shows has changed; returns whether it has.
function changed(name, value, draw) {
  if (name in drawn && drawn[name] === value) return false;
  drawn[name] = value;
  layers[name].replaceChildren();
  if (value) draw(value);
  return true;
}

const straight = (length) => ({
  radius_cm: store.page?.body?.radius_cm ?? 2.4,
  poses: [[0, 0, 0], [length, 0, 0]],
});

// Before the first run: the base, and how far the body goes when it is all out.
function drawReach({ length_cm: length, radius_cm: radius }) {
  make("path", { d: tube([[0, 0, 0], [length, 0, 0]], radius), fill: "none", stroke: "var(--tube-edge)", "stroke-opacity": .6, "stroke-dasharray": "3 4" }, layers.reach);
  text(layers.reach, X(length) - 6, Y(radius) - 6, "not everted yet", { "text-anchor": "end" });
  drawBase(layers.reach, radius);
}

function drawMap(grid) {
  const canvas = document.createElement("canvas");
  canvas.width = grid.width;
  canvas.height = grid.height;
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(grid.width, grid.height);
  const colours = { 0: rgb("--free", 255), 100: rgb("--occupied", 150) };
  for (let row = 0; row < grid.height; row++) {
    for (let column = 0; column < grid.width; column++) {
      const colour = colours[grid.cells[row * grid.width + column]];
      if (colour) pixels.data.set(colour, 4 * ((grid.height - 1 - row) * grid.width + column));
    }
  }
  context.putImageData(pixels, 0, 0);
  const [x, y] = grid.origin, size = grid.resolution_cm;
  make("image", {
    href: canvas.toDataURL(), x: X(x), y: Y(y + grid.height * size),
    width: grid.width * size * scale, height: grid.height * size * scale, preserveAspectRatio: "none",
  }, layers.map);
}

const rgb = (name, alpha) => [...css(name).match(/\d+/g).map(Number), alpha];

// Contacts of another run: squares, with their intervals.
function drawOverlay({ run, contacts }) {
  for (const contact of contacts) {
    const x = X(contact.x_cm), y = Y(contact.y_cm), layer = layers.overlay;
    if (!pointEstimate(contact) && contact.track.length > 1) {
      make("path", { d: line(contact.track.map(([u, v]) => [X(u), Y(v)])), fill: "none", stroke: "var(--overlay)", "stroke-width": 4, "stroke-opacity": .4, "stroke-linecap": "round" }, layer);
    }
    const mark = make("rect", { x: x - 5, y: y - 5, width: 10, height: 10, fill: contact.status === "localized" ? "var(--overlay)" : "var(--card)", stroke: "var(--overlay)", "stroke-width": 2 }, layer);
    make("title", {}, mark).textContent = `${run}: x ${minus(contact.x_cm.toFixed(1))}, y ${minus(contact.y_cm.toFixed(1))} cm, ${contact.status}`;
  }
}

function drawTruth(pegs) {
  for (const peg of pegs) {
    make("circle", {
      cx: X(peg.x_cm), cy: Y(peg.y_cm), r: peg.radius_cm * scale,
      fill: "var(--truth)", "fill-opacity": .2, stroke: "var(--truth)", "stroke-width": 2,
    }, layers.truth);
  }
}

// Points at a distance from the centreline, positive to its left.
const beside = (poses, distance) => poses.map(([x, y, heading]) => [
  X(x - distance * Math.sin(heading)), Y(y + distance * Math.cos(heading)),
]);

function tube(poses, radius) {
  const out = beside(poses, radius), back = beside(poses, -radius).reverse(), r = (radius * scale).toFixed(1);
  const [tipX, tipY] = back[0];
  return `${line(out)}A${r} ${r} 0 0 1 ${tipX.toFixed(1)} ${tipY.toFixed(1)}${line(back).replace("M", "L")}Z`;
}

function drawTrail() {
  const radius = store.last.shape?.radius_cm ?? 2.4;
  const group = make("g", { opacity: .35 }, layers.swept);
  make("path", { d: store.trail.map((poses) => tube(poses, radius)).join(""), fill: "var(--trail)", "fill-rule": "nonzero" }, group);
}

function drawBody(shape) {
  const { poses, radius_cm: radius } = shape, layer = layers.body;
  make("path", { d: tube(poses, radius), fill: "var(--tube)", stroke: "var(--tube-edge)", "stroke-width": 1.6, "stroke-linejoin": "round" }, layer);
  make("path", { d: line(beside(poses, 0)), fill: "none", stroke: "var(--tube-edge)", "stroke-width": 1, "stroke-dasharray": "1 4", "stroke-linecap": "round", opacity: .6 }, layer);
  for (const column of columns()) {
    const sign = column.side === "left" ? 1 : -1;
    column.centers_cm.forEach((arc, n) => {
      const [start, end] = [arc - 3, arc + 3].map((place) => along(poses, place));
      const middle = along(poses, arc);
      if (!middle) return;
      const points = [start ?? middle, middle, end ?? middle];
      make("path", { d: line(beside(points, sign * radius * .72)), fill: "none", stroke: `var(${shade(column, n)})`, "stroke-width": 3.2, "stroke-linecap": "round" }, layer);
    });
  }
  drawBase(layer, radius);
}

function drawBase(layer, radius) {
  const r = Math.max(radius * 1.25, 3);
  make("rect", { x: X(-2.4), y: Y(r), width: 2.4 * scale, height: 2 * r * scale, rx: 3, fill: "var(--base)" }, layer);
}

// The pose at an arc length, or null beyond the tip.
function along(poses, arc) {
  let walked = 0;
  for (let n = 1; n < poses.length; n++) {
    const [x0, y0, h0] = poses[n - 1], [x1, y1, h1] = poses[n];
    const length = Math.hypot(x1 - x0, y1 - y0);
    if (arc <= walked + length + 1e-6) {
      const share = length ? Math.max(0, (arc - walked) / length) : 0;
      return [x0 + share * (x1 - x0), y0 + share * (y1 - y0), h0 + share * (h1 - h0)];
    }
    walked += length;
  }
  return null;
}

// The density along the body, as a ribbon on the skin that leads the bend.
function drawPosterior(posterior, poses, moves) {
  const { places_cm: places, side } = posterior, dense = density(posterior), most = Math.max(...dense);
  const radius = store.last.shape?.radius_cm ?? 2.4;
  // Where no muscle bends the body, the contact does.
  const sign = { left: 1, right: -1 }[side] ?? Math.sign(poses.at(-1)[2] - poses[0][2]);
  const skin = [], top = [];
  places.forEach((arc, n) => {
    const pose = along(poses, arc);
    if (!pose) return;
    skin.push(...beside([pose], sign * (radius + .25)));
    top.push(...beside([pose], sign * (radius + .25 + RIBBON_CM * dense[n] / most)));
  });
  if (skin.length < 2) return;
  const layer = layers.posterior;
  if (!moves) make("path", { d: tube(poses, radius), fill: "none", stroke: "var(--contact)", "stroke-opacity": .35, "stroke-dasharray": "3 3" }, layer);
  make("path", { d: `${line(top)}${line(skin.reverse()).replace("M", "L")}Z`, fill: "var(--contact)", "fill-opacity": .38 }, layer);
  make("path", { d: line(top), fill: "none", stroke: "var(--contact)", "stroke-width": 1.5 }, layer);
}

function drawContacts({ contacts, words }) {
  const layer = layers.contacts, previous = labels;
  layers.labels.replaceChildren();
  for (const [n, contact] of contacts.entries()) {
    if (contact.surface.length > 1) drawWall(layer, contact);
    const x = X(contact.x_cm), y = Y(contact.y_cm), localized = contact.status === "localized";
    if (!pointEstimate(contact) && contact.track.length > 1) {
      make("path", { d: line(contact.track.map(([u, v]) => [X(u), Y(v)])), fill: "none", stroke: "var(--contact)", "stroke-width": 6, "stroke-opacity": .38, "stroke-linecap": "round" }, layer);
    }
    const [[a, b], [, d]] = contact.covariance_cm2;
    const middle = (a + d) / 2, spread = Math.hypot((a - d) / 2, b);
    if (!pointEstimate(contact)) make("ellipse", {
      cx: x, cy: y, fill: localized ? "var(--contact-wash)" : "none", stroke: "var(--contact)", "stroke-width": 1.2, "stroke-dasharray": "5 3",
      rx: SIGMA_95 * Math.sqrt(Math.max(middle + spread, 0)) * scale,
      ry: SIGMA_95 * Math.sqrt(Math.max(middle - spread, 0)) * scale,
      transform: `rotate(${(-Math.atan2(2 * b, a - d) / 2 * 180 / Math.PI).toFixed(2)} ${x} ${y})`,
    }, layer);
    make("circle", { cx: x, cy: y, r: 5.5, fill: localized ? "var(--contact)" : "var(--card)", stroke: localized ? "var(--card)" : "var(--contact)", "stroke-width": 2 }, layer);
  }
  labels = contacts.map((contact, n) => label(contact, words[n], previous[n]?.place));
}

// The part of a wall's face that was touched; in dashes while its place is only a guess.
function drawWall(layer, { surface, status }) {
  const points = surface.map(([x, y]) => [X(x), Y(y)]);
  make("path", { d: line(points), fill: "none", stroke: "var(--ink)", "stroke-width": 3, ...status !== "localized" && { "stroke-dasharray": "7 5" } }, layer);
}

// Where a contact is along the body, in two lines, which `drawLabels` puts beside the contact.
function label(contact, words, place) {
  const range = pointEstimate(contact) ? words.interval : `95 %: ${minus(words.interval)}`;
  const group = make("g", {}, layers.labels);
  const leader = make("path", { fill: "none", stroke: "var(--contact)", "stroke-width": 1 }, group);
  const halo = { stroke: "var(--card)", "stroke-width": 4, "paint-order": "stroke", "stroke-linejoin": "round" };
  const lines = [
    text(group, 0, 0, `${words.kind}, ${minus(words.along)}`, { fill: "var(--contact)", "font-weight": 650, "font-size": 12, ...halo }),
    text(group, 0, 0, range, { fill: "var(--contact)", ...halo }),
  ];
  return {
    group, leader, lines, place, x: X(contact.x_cm), y: Y(contact.y_cm), away: contact.y_cm >= 0 ? -1 : 1,
    width: Math.max(...lines.map((row) => row.getComputedTextLength())),
  };
}

// Put the labels where they cover neither pegs nor the body, if there is room.
function drawLabels(poses, contactPoses) {
  const { last, page } = store;
  const radius = (last.shape?.radius_cm ?? 2.4) * scale;
  const circle = ([x, y], r, cost) => ({ x: X(x), y: Y(y), r, cost });
  const things = [
    ...poses.map((pose) => circle(pose, radius, COST.body)),
    ...contactPoses.map((pose) => circle(pose, radius, COST.faint)),
    ...(page?.truth ?? []).map((peg) => circle([peg.x_cm, peg.y_cm], peg.radius_cm * scale + 3, COST.named)),
  ];
  for (const { x_cm: x, y_cm: y, surface, track } of last.contacts?.contacts ?? []) {
    things.push(circle([x, y], 8, COST.named), ...[...surface, ...track].map((point) => circle(point, 4, COST.faint)));
  }
  arrange(labels, things, { x0: PAD.left, x1: svg.clientWidth - PAD.right, y0: PAD.top, y1: svg.clientHeight - PAD.bottom });
  for (const label of labels) {
    const { x, y, group, leader, lines, place: { side } } = label;
    const { near, foot } = box(label, label.place);
    group.setAttribute("text-anchor", side > 0 ? "start" : "end");
    lines.forEach((row, n) => {
      row.setAttribute("x", near);
      row.setAttribute("y", foot + 14 * n);
    });
    // It ends at an upright bar: a stroke that ends before a number is its minus sign.
    const bar = near - 6 * side, length = Math.hypot(bar - x, foot + 3 - y);
    const tail = [x + 7 * (bar - x) / length, y + 7 * (foot + 3 - y) / length];
    leader.setAttribute("d", `M${tail}L${bar} ${foot + 3}M${bar} ${foot - 9}V${foot + 16}`);
  }
}

$("room-legend").innerHTML = `
  <span><i class="area" style="background:var(--free)"></i>free</span>
  <span><i class="area" style="background:var(--trail);opacity:.35"></i>swept at this stage</span>
  <span><i class="area" style="background:var(--contact);opacity:.45"></i>where a contact may be</span>
  <span><i class="dot" style="background:var(--contact)"></i>contact</span>
  <span><i style="border-top-width:3px;color:var(--ink)"></i>wall, dashed: a guess</span>
  <span style="color:var(--contact)"><i class="ring"></i><span class="muted">95 % in the plane</span></span>
  <span id="overlay-legend" style="color:var(--overlay)" hidden><i class="area" style="width:10px;background:currentColor"></i><span class="muted" id="overlay-name"></span></span>
  <span id="truth-legend" style="color:var(--truth)" hidden><i class="ring" style="border-style:solid"></i><span class="muted">peg (the emulator’s truth)</span></span>`;

// A point of the room under the pointer, cm.
function under(event) {
  const box = svg.getBoundingClientRect();
  return [bounds.x0 + (event.clientX - box.left - left) / scale, bounds.y1 - (event.clientY - box.top - top) / scale];
}

const middle = () => {
  const w = svg.clientWidth - PAD.left - PAD.right, h = svg.clientHeight - PAD.top - PAD.bottom;
  return view ?? { x: bounds.x0 + (PAD.left + w / 2 - left) / scale, y: bounds.y1 - (PAD.top + h / 2 - top) / scale, larger: 1 };
};

svg.addEventListener("wheel", (event) => {
  event.preventDefault();
  const current = middle(), [x, y] = under(event);
  const larger = Math.min(current.larger * Math.exp(-Math.max(-.5, Math.min(.5, event.deltaY / 240))), LARGEST);
  const shrinkage = current.larger / larger; // what is under the pointer stays there
  look(larger <= 1 ? null : { x: x + shrinkage * (current.x - x), y: y + shrinkage * (current.y - y), larger });
  drawRoom();
}, { passive: false });
svg.addEventListener("pointerdown", (event) => {
  if (event.button !== 0 || !view) return;
  svg.setPointerCapture(event.pointerId);
  const { x, y, larger } = view, start = [event.clientX, event.clientY];
  svg.onpointermove = (move) => {
    look({ x: x - (move.clientX - start[0]) / scale, y: y + (move.clientY - start[1]) / scale, larger });
    drawRoom();
  };
  svg.onpointerup = svg.onpointercancel = () => { svg.onpointermove = null; };
});
const whole = () => { look(null); drawRoom(); };
svg.addEventListener("dblclick", whole);
$("room-whole").addEventListener("click", whole);

sized(svg, () => { frame = ""; drawRoom(); });
