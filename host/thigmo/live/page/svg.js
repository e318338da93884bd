// Small pieces of SVG drawing, shared by the room and the chart along the body.

const SPACE = "http://www.w3.org/2000/svg";

export function make(tag, attributes = {}, parent = null) {
  const node = document.createElementNS(SPACE, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent?.append(node);
  return node;
}

export function text(parent, x, y, words, attributes = {}) {
  const node = make("text", { x, y, "font-size": 11, fill: "var(--soft)", ...attributes }, parent);
  node.textContent = words;
  return node;
}

// Redraw when the element's size changes; the last size is on the element.
export function sized(svg, draw) {
  new ResizeObserver(() => {
    const { width, height } = svg.getBoundingClientRect();
    if (width < 10 || height < 10) return;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    draw();
  }).observe(svg);
}

export const line = (points) => points.map(([x, y], n) => `${n ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

// A number with a minus sign, which a hyphen is not.
export const minus = (value) => String(value).replaceAll("-", "−");

// Round steps for about `count` ticks between two values.
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const unit = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((n) => n * unit).find((n) => n >= raw);
  const values = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9; n++) values.push(+(n * step).toPrecision(10));
  return values;
}

// A number to its digits. What lies in the middle goes to the even digit, as in the terminal's and
// the map's words; such numbers are whole multiples of a power of two, and so are exact here.
export const rounded = (value, digits) => {
  const scaled = value * 10 ** digits;
  const middle = Number.isInteger(value * 2 ** (digits + 1)) && Math.abs(scaled % 1) === .5;
  return minus((middle ? 2 * Math.round(scaled / 2) / 10 ** digits : value).toFixed(digits));
};
