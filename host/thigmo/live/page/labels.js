// Where labels of two lines go beside what they name: where they cover as little as possible of what
// else is drawn, and as near as possible.

// What it costs to cover a thing, in px by which a label would rather be farther away.
export const COST = { named: 400, body: 100, faint: 20 };
const OUTSIDE = 2000;
const APART = 20; // px, from what is named to the label's near end
const ABOVE = 11, BELOW = 18; // px, about the foot of the upper line
const PLACES = [30, 0, 45, 65, 90, 120, 160, -30, -45, -65, -90, -120, -160].flatMap((rise) => (
  [0, 30, 60, 100].flatMap((across) => [1, -1].map((side) => ({ rise, across, side })))
));

// Gives each of `labels` its `place`. A label keeps the place that it has as long as it covers nothing
// that must be seen. A label has { x, y } of what it names, its width, and the direction of y in which
// it prefers to go: `away`, 1 or -1. It keeps clear of `things`: circles { x, y, r, cost }. All in px.
export function arrange(labels, things, frame) {
  const taken = [...things];
  for (const label of labels) {
    const covers = (where) => covered(box(label, where), taken, frame);
    if (!label.place || covers(label.place) >= COST.body) {
      const costs = PLACES.map((where) => covers(where) + distance(where));
      label.place = PLACES[costs.indexOf(Math.min(...costs))];
    }
    const { x0, x1, y0, y1 } = box(label, label.place);
    for (const share of [0, .25, .5, .75, 1]) {
      taken.push({ x: x0 + share * (x1 - x0), y: (y0 + y1) / 2, r: (y1 - y0) / 2, cost: COST.named });
    }
  }
}

// What a label covers at a place, its near end and the foot of its upper line.
export function box({ x, y, away, width }, { rise, across, side }) {
  const near = x + side * (APART + across), far = near + side * width, foot = y + away * rise;
  return { x0: Math.min(near, far), x1: Math.max(near, far), y0: foot - ABOVE, y1: foot + BELOW, near, foot };
}

const distance = ({ rise, across }) => Math.hypot(APART + across, rise) + (rise < 0 ? 10 : 0);

function covered({ x0, x1, y0, y1 }, things, frame) {
  const outside = x0 < frame.x0 || x1 > frame.x1 || y0 < frame.y0 || y1 > frame.y1;
  let sum = outside ? OUTSIDE : 0;
  for (const { x, y, r, cost } of things) {
    const nearest = [Math.min(Math.max(x, x0), x1), Math.min(Math.max(y, y0), y1)];
    if (Math.hypot(x - nearest[0], y - nearest[1]) < r) sum += cost;
  }
  return sum;
}
