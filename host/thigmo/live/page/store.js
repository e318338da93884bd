// What the page knows: the run's messages as they came, and what of them holds at the moment shown.
// Live, that moment is the last reading; in a finished run the player moves it. All times are the
// robot's, in seconds; `now` and what is drawn count from the start of the run.

// Columns of a telemetry row, as live/page_data.py makes them.
export const COLUMN = {
  t: 0, pressure: 1, demand: 5, drive: 9, curvature: 13, expected: 29, length: 45, motor: 46,
};
export const COLUMNS = 47;
export const SENSORS = 16;
// Beside them: curvature where it tells something, which is where the free body's is known. The
// sensors of an inflated side wrinkle.
COLUMN.telling = COLUMNS;
// The robot's muscles and columns of sensors, as robot.toml names them.
export const muscles = () => store.page?.body?.muscles ?? [];
export const columns = () => store.page?.body?.columns ?? [];
const SHADES = 5;
// The colour of a column's sensor, from dark at the base to pale: a name in style.css.
export const shade = ({ side, inputs }, n) => (
  `--${side}-${1 + Math.round(n * Math.min(1, (SHADES - 1) / Math.max(inputs.length - 1, 1)))}`
);
const KEPT = 40_000; // rows: more than three minutes of full telemetry
const TRAIL = 400; // shapes of a stage
const SWEEPING = ["SWEEP", "REST", "PRESS", "MEASURE", "LOCALIZE"];

export const BOARD = { state: "", activity: "", faults: [] };
// What is known of a run before its first message.
const nothing = () => ({
  last: {}, // message of each slow channel that holds now
  events: [],
  trail: [],
  touched: null, // the shape on which the posterior lies
  board: BOARD,
  origin: null, // robot time at the start of the run
  now: 0,
  dropped: 0,
  result: null, // of a run that has ended
});
export const store = {
  readAt: null, // when the last reading came, by performance.now()
  page: null, // what the server says of itself and of the run
  columns: Array.from({ length: COLUMNS + SENSORS }, () => []),
  drawnEpoch: 0,
  overlay: null, // a finished run that lies over what is shown
  ...nothing(),
};

export function reset() {
  for (const column of store.columns) column.length = 0;
  Object.assign(store, nothing());
}

export function addRows(message) {
  const { columns } = store;
  for (const row of message.rows) {
    const t = row[0];
    store.origin ??= t;
    // The board or its emulator restarted: what was before lies on another clock.
    if (columns[0].length && t - store.origin < columns[0].at(-1)) {
      if (columns[0].at(-1) - (t - store.origin) < 0.5) continue;
      for (const column of columns) column.length = 0;
      store.origin = t;
    }
    columns[0].push(t - store.origin);
    for (let n = 1; n < COLUMNS; n++) columns[n].push(row[n]);
    for (let n = 0; n < SENSORS; n++) {
      columns[COLUMN.telling + n].push(row[COLUMN.expected + n] === null ? null : row[COLUMN.curvature + n]);
    }
  }
  if (columns[0].length > KEPT * 1.25) {
    const excess = columns[0].length - KEPT;
    for (const column of columns) column.splice(0, excess);
  }
  store.board = message.board;
  store.now = columns[0].at(-1) ?? store.now;
  store.epoch = message.epoch_s;
}

export function add(message) {
  const { channel, level: severity, text } = message;
  if (channel === "event") store.events.push(message);
  else if (channel === "log") store.events.push({ ...message, severity, message: text, next: "", name: "log" });
  else hold(message);
}

// A message of a slow channel holds until the next one.
export function hold(message) {
  const { last } = store;
  if (message.channel === "state" && last.state && message.stage_cm !== last.state.stage_cm) store.trail = [];
  if (message.channel === "shape") {
    store.trail.push(message.poses);
    if (store.trail.length > TRAIL) store.trail = store.trail.filter((_, n) => n % 2);
  }
  if (message.channel === "posterior") store.touched = under(message, store.trail);
  last[message.channel] = message;
}

// The posterior that is shown: what was measured stays in view until the next stage is swept.
export function posterior() {
  const { posterior, state } = store.last;
  const outdated = SWEEPING.includes(state?.state) && Math.abs(posterior?.length_cm - state.stage_cm) > .5;
  return outdated ? null : posterior;
}

// A posterior's density, 1/cm, at the middle of each of its cells: they lie end to end from the base.
export function density({ places_cm: places, probability }) {
  let edge = 0;
  return places.map((middle, n) => {
    const width = 2 * (middle - edge);
    edge += width;
    return probability[n] / width;
  });
}

// The shape on which a posterior lies: the last one while the sweep goes on, else the one measured.
function under({ places_cm, side, sweeping }, shapes) {
  if (!places_cm.length) return null;
  return sweeping ? shapes.at(-1) ?? null : mostBent(shapes, side);
}

// The last shape of a stage in which the body was bent the most to a side: there it was measured.
function mostBent(shapes, side) {
  const sign = side === "right" ? -1 : 1;
  let shape = null, most = .05;
  for (let n = shapes.length - 1; n >= 0; n--) {
    const bent = sign * shapes[n].at(-1)[2];
    if (bent > most) [shape, most] = [shapes[n], bent];
    else if (shape && bent < most / 2) break; // that was another sweep
  }
  return shape;
}

const OLD_S = 2;
// How old the last reading is, s; 0 while it is fresh, of a run that is over, or where there is none.
export function age() {
  const { page, readAt } = store;
  if (page?.mode !== "live" || readAt === null) return 0;
  const seconds = (performance.now() - readAt) / 1000;
  return seconds < OLD_S ? 0 : seconds;
}

// A contact of a method that knows no error: nothing of it is drawn but its place.
export const pointEstimate = (contact) => contact.status === "point estimate";
export const time = (t_s) => t_s - (store.origin ?? 0);
export const latest = (column) => store.columns[column][index()];

// How many entries of a list, in the order of their times, are of a time or before it.
export function until(list, t, timeOf) {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(list[middle]) <= t + 1e-9) low = middle + 1; else high = middle;
  }
  return low;
}

// Row that is shown: the last one up to now.
export const index = () => until(store.columns[0], store.now, (t) => t) - 1;

export const $ = (id) => document.getElementById(id);
export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}
const probe = document.body.appendChild(element("i", { hidden: "" }));
// A colour of style.css as it is now, light or dark: rgb(...).
export function css(name) {
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color;
}
