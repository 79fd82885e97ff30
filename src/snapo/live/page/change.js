// A change of the value: to first order while the user drags, and explained by input.

import { drawn, waterfall } from "./draw.js";
import { shown, signed } from "./numbers.js";
import { at, page } from "./page.js";

// The steps from the run's value to the value shown, one input at a time; `called`: its name for users.
export function explained(steps, called) {
  at("explained").hidden = false;
  const rows = steps.map(({ names, change, error }) => ({ name: names.map(called).join(", "), change, error, shown: signed(change, 4) }));
  const start = page.base.value.value;
  drawn(at("explained-chart"), (width) => waterfall(width, start, rows, (value) => shown(value, 6)));
}

// By how much the inputs shown differ to first order from the point `last` that was valued, with
// the derivatives there: at once, without asking anybody. Null where they are not known, or where
// choices or policy (`key`) differ.
export function firstOrder(last, key) {
  if (!last || last.key !== key) return null;
  let sum = 0;
  for (const input of page.inputs) {
    const from = last.values[input.name] ?? input.values;
    if (input.now.every((v, i) => v === from[i])) continue;
    if (!input.slope) return null;
    const rows = last.deltas?.find((each) => each.input === input.name && !each.of)?.rows;
    input.handles.forEach(({ at }, h) => (sum += along(input, from, at, rows?.[h]?.value)));
  }
  return sum;
}

// Along one handle: the derivative at the last point is that of numbers that move alike; others
// have the run's.
function along(input, from, at, slope) {
  const by = at.map((i) => input.now[i] - from[i]);
  const alike = by.every((x) => Math.abs(x - by[0]) <= 1e-9 * Math.abs(by[0]));
  if (alike && Number.isFinite(slope)) return slope * by[0];
  return at.reduce((sum, i, k) => sum + (by[k] ? input.slope[i] * by[k] : 0), 0);
}
