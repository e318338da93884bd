// Strip charts of the telemetry, drawn by uPlot from the store's columns. A dashed line is what was
// asked for, or what the free body would read; the solid one is what was measured.

import { $, COLUMN, columns, css, element, index, muscles, shade, store } from "./store.js";
import { minus, rounded } from "./svg.js";

const DASH = [5, 4];
const sensors = (of) => [
  ...of.inputs.map((input, n) => ({ column: COLUMN.curvature + input, colour: shade(of, n), width: 1, soft: true, alpha: .28 })),
  ...of.inputs.map((input, n) => ({ column: COLUMN.telling + input, colour: shade(of, n), width: 1.6, name: `${n}` })),
  ...of.inputs.map((input) => ({ column: COLUMN.expected + input, colour: "--ink", width: 1.1, dash: DASH, soft: true })),
];
const sides = (column, options = {}) => muscles().map(({ name, side, output }) => (
  { column: column + output, colour: `--${side}`, width: 1.8, name, ...options }
));
const curvatures = (of) => ({
  title: `Curvature, ${of.name} sensors`, unit: "1/cm", height: 136, least: [-.01, .01], digits: 4,
  series: sensors(of), many: true, note: "0: base; pale: inflated side", dashed: "the free body",
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
let shown = 30, drawn = "", built = null;

// Range of y: the least one, and whatever is shown, with a little air.
function range([low, high]) {
  return (plot, from, to) => {
    if (from === null || to === null || !Number.isFinite(from) || !Number.isFinite(to)) return [low, high];
    const bottom = Math.min(low, from), top = Math.max(high, to), air = .06 * (top - bottom);
    return [bottom < low ? bottom - air : bottom, top > high ? top + air : top];
  };
}

function build() {
  for (const { plot } of plots) plot.destroy();
  plots.length = 0;
  $("charts").replaceChildren();
  const grid = { stroke: css("--grid"), width: 1 }, faint = css("--faint"), soft = css("--soft");
  const font = '11px Inter, "Inter Variable", system-ui, sans-serif';
  built = store.page?.body;
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
    if (chart.note) legend.append(element("span", {}, chart.note));
    const head = element("h3", {}, element("span", {}, `${chart.title}, `, element("span", { class: "unit" }, chart.unit)), legend);
    const place = element("div", { class: "chart" }, head);
    $("charts").append(place);
    const plot = new uPlot({
      width: place.clientWidth, height: chart.height, legend: { show: false }, pxAlign: 0,
      cursor: { sync: { key: sync.key }, drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: { x: { time: false, auto: false }, y: { range: range(chart.least) } },
      axes: [
        {
          stroke: chart.last ? soft : faint, grid, ticks: { show: false }, font, size: chart.last ? 20 : 8, gap: 3,
          values: chart.last ? (_, at) => at.map(minus) : (_, at) => at.map(() => ""),
          label: chart.last ? "robot time, s" : undefined, labelSize: 15, labelGap: 0, labelFont: font,
        },
        {
          stroke: faint, grid, ticks: { show: false }, font, size: 46, gap: 5, space: 26,
          values: (_, at) => at.map((value) => minus(+value.toPrecision(6))), label: chart.axis ?? chart.unit, labelSize: 16, labelFont: font,
        },
      ],
      series: [{}, ...chart.series.map((line) => ({
        stroke: css(line.colour), width: line.width, dash: line.dash, points: { show: false }, spanGaps: false,
        alpha: line.alpha ?? (line.soft ? .75 : 1),
      }))],
    }, [[], ...chart.series.map(() => [])], place);
    plots.push({ chart, plot, place, values });
  }
  drawn = "";
}

export function drawCharts() {
  const { columns, now, page } = store;
  if (JSON.stringify(page?.body) !== JSON.stringify(built)) build();
  const key = `${columns[0].length} ${now} ${shown} ${columns[0][0]}`;
  if (key === drawn) return;
  drawn = key;
  const right = page?.mode === "record" ? Math.max(now, shown) : Math.max(now, columns[0][0] + shown || shown);
  const hovered = plots[0]?.plot.cursor.idx;
  const row = hovered ?? index();
  for (const { chart, plot, values } of plots) {
    plot.batch(() => {
      plot.setData([columns[0], ...chart.series.map((line) => columns[line.column])], false);
      plot.setScale("x", { min: right - shown, max: right });
    });
    for (const { line, value } of values) {
      const read = columns[line.column][row];
      value.textContent = chart.many || read === null || read === undefined ? "" : rounded(read, chart.digits);
    }
  }
}

export function redrawCharts() { build(); drawCharts(); }

new ResizeObserver(() => {
  for (const { chart, plot, place } of plots) plot.setSize({ width: place.clientWidth, height: chart.height });
}).observe($("charts"));

for (const button of $("window").children) {
  button.addEventListener("click", () => {
    shown = Number(button.dataset.s);
    for (const each of $("window").children) each.setAttribute("aria-pressed", String(each === button));
    drawn = "";
    drawCharts();
  });
}
