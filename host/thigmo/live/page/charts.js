// Strip charts of the telemetry, drawn by uPlot from the store's columns. A dashed line is what was
// asked for, or what the free body would read; the solid one is what was measured.

import { $, COLUMN, columns, css, element, index, muscles, shade, store, until } from "./store.js";
import { minus, rounded } from "./svg.js";

const DASH = [5, 4];
const sensors = (column) => [
  ...column.inputs.map((input, n) => ({ column: COLUMN.curvature + input, colour: shade(column, n), width: 1, soft: true, alpha: .28 })),
  ...column.inputs.map((input, n) => ({ column: COLUMN.telling + input, colour: shade(column, n), width: 1.6, name: `${n}` })),
  ...column.inputs.map((input) => ({ column: COLUMN.expected + input, colour: "--ink", width: 1.1, dash: DASH, soft: true })),
];
const sides = (column, options = {}) => muscles().map(({ name, side, output }) => (
  { column: column + output, colour: `--${side}`, width: 1.8, name, ...options }
));
const curvatures = (column) => ({
  title: `Curvature, ${column.name} sensors`, unit: "1/cm", height: 136, least: [-.01, .01], digits: 4,
  series: sensors(column), many: true, note: "0: base; pale: inflated side", dashed: "the free body",
});
const charts = () => [
  {
    title: "Muscle pressure", unit: "psi", height: 132, least: [0, 4], digits: 2,
    series: [...sides(COLUMN.pressure), ...sides(COLUMN.demand, { colour: "--ink", dash: DASH, width: 1.1, soft: true })],
    dashed: "set point",
  },
  ...columns().map(curvatures),
  {
    title: "Valve current", unit: "mA", height: 92, least: [0, 8], digits: 1, series: sides(COLUMN.drive),
  },
  {
    title: "Everted length", unit: "cm", height: 92, least: [0, 10], digits: 1,
    series: [{ column: COLUMN.length, colour: "--ink", width: 1.8, name: "length" }],
  },
  {
    title: "Spool motor", unit: "share of full duty", axis: "share", height: 112, least: [-.2, .2], digits: 2, last: true,
    series: [{ column: COLUMN.motor, colour: "--ink", width: 1.4, name: "duty" }], note: "positive pays out",
  },
];
const sync = uPlot.sync("time");
const plots = [];
let shown = 30, drawn = "", built = null, builtOver = null;
let view = null; // the time that is looked at, { min, max }; null follows the run
const LEAST_S = .05;

// Which muscles and sensors a robot has; where they lie is calibrated.
const build = (body) => JSON.stringify([body?.muscles, body?.columns.map(({ name, inputs }) => [name, inputs])]);

// What is laid over a chart's lines: those of another run, if its robot has the same muscles and sensors.
function overlaid(chart) {
  const { overlay, page } = store;
  if (!overlay || build(overlay.body) !== build(page?.body)) return [];
  return chart.series.filter((line) => !line.soft).map((line) => ({ line, values: overlay.columns[line.column] }));
}

// Rows of another run from a time to another, one more at either end.
function rowsWithin(times, start, end) {
  const identity = (t) => t;
  return [Math.max(until(times, start, identity) - 1, 0), Math.min(until(times, end, identity) + 1, times.length)];
}

function drawOverlay(chart) {
  return (plot) => {
    const lines = overlaid(chart);
    if (!lines.length) return;
    const { ctx, bbox } = plot, times = store.overlay.columns[0];
    const [first, end] = rowsWithin(times, plot.scales.x.min, plot.scales.x.max);
    const step = Math.max(1, Math.floor((end - first) / bbox.width));
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.lineWidth = 1.6 * devicePixelRatio;
    for (const { line, values } of lines) {
      ctx.strokeStyle = chart.many ? css(line.colour) : css("--overlay");
      ctx.beginPath();
      let draws = false;
      for (let row = first; row < end; row += step) {
        if (Number.isNaN(values[row])) { draws = false; continue; }
        const x = plot.valToPos(times[row], "x", true), y = plot.valToPos(values[row], "y", true);
        if (draws) ctx.lineTo(x, y); else ctx.moveTo(x, y);
        draws = true;
      }
      ctx.stroke();
    }
    ctx.restore();
  };
}

// Least and greatest value of another run's lines in the time shown.
function overlayExtent(chart, plot) {
  let low = Infinity, high = -Infinity;
  for (const { values } of overlaid(chart)) {
    const [first, end] = rowsWithin(store.overlay.columns[0], plot.scales.x.min, plot.scales.x.max);
    for (let row = first; row < end; row++) {
      if (values[row] < low) low = values[row];
      if (values[row] > high) high = values[row];
    }
  }
  return [low, high];
}

// Range of y: as it was zoomed to; else the least one, and whatever is shown, with a little air.
function range(chart) {
  const [low, high] = chart.least;
  return (plot, lowest, highest) => {
    if (chart.zoomed) return chart.zoomed;
    const [overlayLow, overlayHigh] = overlayExtent(chart, plot);
    const least = Math.min(lowest ?? Infinity, overlayLow), greatest = Math.max(highest ?? -Infinity, overlayHigh);
    if (!Number.isFinite(least) || !Number.isFinite(greatest)) return [low, high];
    const bottom = Math.min(low, least), top = Math.max(high, greatest), air = .06 * (top - bottom);
    return [bottom < low ? bottom - air : bottom, top > high ? top + air : top];
  };
}

function makeCharts() {
  for (const { plot } of plots) plot.destroy();
  plots.length = 0;
  $("charts").replaceChildren();
  const grid = { stroke: css("--grid"), width: 1 }, faint = css("--faint"), soft = css("--soft");
  const font = '11px Inter, "Inter Variable", system-ui, sans-serif';
  built = store.page?.body;
  builtOver = store.overlay;
  for (const chart of charts()) {
    const legend = element("span", { class: "legend" });
    const values = [];
    for (const line of chart.series) {
      if (line.soft) continue;
      const key = element("i"), value = element("output");
      key.style.borderColor = `var(${line.colour})`;
      legend.append(element("span", {}, key, chart.series.length > 1 ? `${line.name} ` : "", value));
      values.push({ line, value });
    }
    if (chart.dashed) legend.append(element("span", {}, element("i", { class: "dash" }), chart.dashed));
    if (overlaid(chart).length) {
      const key = element("i", { class: "dotted" });
      if (!chart.many) key.style.borderColor = "var(--overlay)";
      legend.append(element("span", {}, key, store.overlay.run));
    }
    if (chart.note) legend.append(element("span", {}, chart.note));
    const head = element("h3", {}, element("span", {}, `${chart.title}, `, element("span", { class: "unit" }, chart.unit)), legend);
    const place = element("div", { class: "chart", role: "group", "aria-label": chart.title }, head);
    $("charts").append(place);
    const plot = new uPlot({
      width: place.clientWidth, height: chart.height, legend: { show: false }, pxAlign: 0,
      cursor: { sync: { key: sync.key }, drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: { x: { time: false, auto: false }, y: { range: range(chart) } },
      hooks: { draw: [drawOverlay(chart)] },
      axes: [
        {
          stroke: chart.last ? soft : faint, grid, ticks: { show: false }, font, size: chart.last ? 20 : 8, gap: 3,
          values: chart.last ? (_, splits) => splits.map(minus) : (_, splits) => splits.map(() => ""),
          label: chart.last ? "robot time, s" : undefined, labelSize: 15, labelGap: 0, labelFont: font,
        },
        {
          stroke: faint, grid, ticks: { show: false }, font, size: 46, gap: 5, space: 26,
          values: (_, splits) => splits.map((value) => minus(+value.toPrecision(6))), label: chart.axis ?? chart.unit, labelSize: 16, labelFont: font,
        },
      ],
      series: [{}, ...chart.series.map((line) => ({
        stroke: css(line.colour), width: line.width, dash: line.dash, points: { show: false }, spanGaps: false,
        alpha: line.alpha ?? (line.soft ? .75 : 1),
      }))],
    }, [[], ...chart.series.map(() => [])], place);
    plots.push({ chart, plot, place, values });
    listenTo(chart, plot);
  }
  drawn = "";
}

// The time that a chart shows.
function span() {
  if (view) return view;
  const { columns, now, page } = store, first = columns[0][0] ?? 0;
  if (shown === Infinity) return { min: first, max: Math.max(columns[0].at(-1) ?? 0, first + 1) };
  const right = page?.mode === "record" ? Math.max(now, shown) : Math.max(now, first + shown || shown);
  return { min: right - shown, max: right };
}

// Show a span of time, within what there is.
function look(min, max) {
  const { columns, overlay } = store;
  const first = columns[0][0] ?? 0, last = Math.max(columns[0].at(-1) ?? 1, overlay?.columns[0].at(-1) ?? 0, first + 1);
  const width = Math.min(Math.max(max - min, LEAST_S), last - first);
  const start = Math.min(Math.max(min, first), last - width);
  view = { min: start, max: start + width };
  drawWindow();
  drawCharts();
}

// Zoom all charts in time, about a moment: the one that is shown stays where it is.
export function zoom(factor, moment = null) {
  const { min, max } = span(), centre = moment ?? (min + max) / 2;
  look(centre - factor * (centre - min), centre + factor * (max - centre));
}

// The time that each chart shows.
export const spans = () => plots.map(({ plot }) => [plot.scales.x.min, plot.scales.x.max]);

// Follow the run again, and its values.
export function unzoom() {
  view = null;
  for (const { chart } of plots) chart.zoomed = null;
  drawWindow();
  drawn = "";
  drawCharts();
}

const factorOf = (event) => Math.exp(Math.max(-.5, Math.min(.5, (event.deltaY || event.deltaX) / 240)));

function listenTo(chart, plot) {
  const surface = plot.over;
  surface.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = surface.getBoundingClientRect();
    if (!event.shiftKey) return zoom(factorOf(event), plot.posToVal(event.clientX - box.left, "x"));
    const { min, max } = plot.scales.y, pivot = plot.posToVal(event.clientY - box.top, "y"), factor = factorOf(event);
    chart.zoomed = [pivot - factor * (pivot - min), pivot + factor * (max - pivot)];
    drawn = "";
    drawCharts();
  }, { passive: false });
  surface.addEventListener("dblclick", unzoom);
  surface.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    surface.setPointerCapture(event.pointerId);
    const { min, max } = span(), height = chart.zoomed, start = [event.clientX, event.clientY];
    const box = surface.getBoundingClientRect();
    surface.onpointermove = (move) => {
      const aside = (move.clientX - start[0]) / box.width * (max - min);
      if (height) {
        const up = (move.clientY - start[1]) / box.height * (height[1] - height[0]);
        chart.zoomed = height.map((value) => value + up);
        drawn = "";
      }
      if (aside || view) look(min - aside, max - aside);
    };
    surface.onpointerup = surface.onpointercancel = () => { surface.onpointermove = null; };
  });
}

export function drawCharts() {
  const { columns, now, page, overlay } = store;
  if (JSON.stringify(page?.body) !== JSON.stringify(built) || overlay !== builtOver) makeCharts();
  const { min, max } = span();
  const key = `${columns[0].length} ${now} ${min} ${max} ${columns[0][0]} ${overlay?.run}`;
  if (key === drawn) return;
  drawn = key;
  const hovered = plots[0]?.plot.cursor.idx;
  const row = hovered ?? index();
  for (const { chart, plot, values } of plots) {
    plot.batch(() => {
      plot.setData([columns[0], ...chart.series.map((line) => columns[line.column])], false);
      plot.setScale("x", { min, max });
    });
    for (const { line, value } of values) {
      const read = columns[line.column][row];
      value.textContent = chart.many || read === null || read === undefined ? "" : rounded(read, chart.digits);
    }
  }
}

export function redrawCharts() { makeCharts(); drawCharts(); }

new ResizeObserver(() => {
  for (const { chart, plot, place } of plots) plot.setSize({ width: place.clientWidth, height: chart.height });
}).observe($("charts"));

const seconds = (button) => button.dataset.s === "all" ? Infinity : Number(button.dataset.s);
function drawWindow() {
  for (const button of $("window").children) {
    button.setAttribute("aria-pressed", String(!view && seconds(button) === shown));
  }
}

for (const button of $("window").children) {
  button.addEventListener("click", () => {
    shown = seconds(button);
    unzoom();
  });
}
