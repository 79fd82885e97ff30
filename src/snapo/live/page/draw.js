// Charts as SVG, drawn anew whenever their numbers or their width change.

import { HALF, shown, ticks } from "./numbers.js";

const SVG = "http://www.w3.org/2000/svg";

export function node(name, attributes = {}, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key in made && key !== "list") made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// Draws into `place` now and at every width; `make(width)` gives the SVG.
export function drawn(place, make) {
  place.make = make;
  const draw = () => {
    if (place.clientWidth) place.replaceChildren(...[place.make(place.clientWidth)].flat());
  };
  if (!place.watch) {
    let last = 0;
    place.watch = new ResizeObserver(() => {
      if (place.clientWidth !== last) {
        last = place.clientWidth;
        if (place.clientWidth) place.replaceChildren(...[place.make(place.clientWidth)].flat());
      }
    });
    place.watch.observe(place);
  }
  draw();
}

// A frame with a vertical scale: { svg, x(i), y(v), left, right, top, bottom }.
export function frame(width, height, low, high, label) {
  const marks = ticks(low, high, 4), widest = Math.max(0, ...marks.map((tick) => shown(tick, 4).length));
  const left = Math.max(54, 6.4 * widest + 10), right = width - 8, top = 10, bottom = height - 24;
  const span = high - low || 1;
  const y = (v) => bottom - ((v - low) / span) * (bottom - top);
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": label });
  for (const tick of marks) {
    svg.append(node("line", { class: Math.abs(tick) < 1e-12 * span ? "zero" : "rule", x1: left, x2: right, y1: y(tick), y2: y(tick) }));
    svg.append(node("text", { x: left - 6, y: y(tick) + 4, "text-anchor": "end" }, shown(tick, 4)));
  }
  return { svg, y, left, right, top, bottom };
}

// Labels below the axis, as many as fit.
export function below(svg, labels, x, bottom, room) {
  const widest = Math.max(...labels.map((label) => label.length)) * 6.2 + 10;
  const every = Math.max(1, Math.ceil((labels.length * widest) / room));
  labels.forEach((label, i) => {
    if (i % every === 0) svg.append(node("text", { x: x(i), y: bottom + 16, "text-anchor": "middle" }, label));
  });
}

const path = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

// Bands and means over time, with the mean of the run.
export function fan(width, series, before, labels) {
  const all = [...series.p05, ...series.p95, ...(before ? before.mean : [])].filter(Number.isFinite);
  const low = Math.min(...all), high = Math.max(...all), pad = (high - low || Math.abs(high) || 1) * 0.04;
  const chart = frame(width, 240, low - pad, high + pad, `${series.name} over time`);
  const count = series.mean.length;
  const x = (i) => chart.left + (i / Math.max(1, count - 1)) * (chart.right - chart.left);
  const band = (a, b, name) => {
    const there = a.map((v, i) => [x(i), chart.y(v)]), back = b.map((v, i) => [x(i), chart.y(v)]).reverse();
    chart.svg.append(node("path", { class: name, d: path([...there, ...back]) + "Z" }));
  };
  band(series.p05, series.p95, "wide");
  band(series.p25, series.p75, "close");
  if (before) chart.svg.append(node("path", { class: "base", d: path(before.mean.map((v, i) => [x(i), chart.y(v)])) }));
  chart.svg.append(node("path", { class: "now", d: path(series.mean.map((v, i) => [x(i), chart.y(v)])) }));
  const room = chart.right - chart.left, steps = Math.max(1, Math.floor(room / 120));
  for (let k = 0; k <= steps; k++) {
    const i = Math.round((k / steps) * (count - 1));
    const anchor = k === 0 ? "start" : k === steps ? "end" : "middle";
    chart.svg.append(node("text", { x: x(i), y: chart.bottom + 16, "text-anchor": anchor }, labels(i)));
  }
  return chart.svg;
}

// A bar for each row, with its interval, and the bar of the run as an outline.
export function bars(width, rows, before, label) {
  const numbers = rows.flatMap((row, i) => [row.value ?? 0, row.low ?? 0, row.high ?? 0, before?.[i]?.value ?? 0]);
  const low = Math.min(0, ...numbers), high = Math.max(0, ...numbers), pad = (high - low || 1) * 0.03;
  const chart = frame(width, 230, low - (low < 0 ? pad : 0), high + (high > 0 ? pad : 0), label);
  const slot = (chart.right - chart.left) / rows.length, wide = Math.min(46, slot * 0.66);
  const x = (i) => chart.left + (i + 0.5) * slot;
  const bar = (v, i, name) => chart.svg.append(node("rect", { class: name, x: x(i) - wide / 2, width: wide, y: Math.min(chart.y(0), chart.y(v)), height: Math.max(0.5, Math.abs(chart.y(v) - chart.y(0))) }));
  rows.forEach((row, i) => {
    if (row.value !== null) bar(row.value, i, "bar");
    if (Number.isFinite(before?.[i]?.value)) bar(before[i].value, i, "ghost");
    if (row.low !== null) chart.svg.append(node("line", { class: "whisker", x1: x(i), x2: x(i), y1: chart.y(row.low), y2: chart.y(row.high) }));
  });
  below(chart.svg, rows.map((row) => row.label || ""), x, chart.bottom, chart.right - chart.left);
  return chart.svg;
}

// Effects side by side: a horizontal bar for each, the largest first.
export function tornado(width, rows) {
  // Where a name would be cut off, names stand above their bars.
  const side = Math.max(44, ...rows.map((row) => row.shown.length * 6.2 + 8)); // beside a bar: its number
  const up = rows.some((row) => row.effect > 0 || row.high > 0), down = rows.some((row) => row.effect < 0 || row.low < 0);
  const over = rows.some((row) => row.short.length > Math.floor((width * 0.5) / 6.1)) || width * 0.5 < (up && down ? 2 : 1) * side + 24;
  const line = over ? 40 : 24, drop = over ? 16 : 0, most = Math.max(1e-300, ...rows.flatMap((row) => [row.effect, row.low ?? 0, row.high ?? 0].map(Math.abs)));
  const names = over ? 0 : width * 0.5, room = width - names - 8;
  const middle = names + (up && down ? room / 2 : down ? room : 4);
  const half = (up && down ? room / 2 : room - 4) - side;
  const svg = node("svg", { viewBox: `0 0 ${width} ${rows.length * line + 4}`, height: rows.length * line + 4, role: "img", "aria-label": "Effect of moving each input" });
  const zero = (top, bottom) => svg.append(node("line", { class: "zero", x1: middle, x2: middle, y1: top, y2: bottom }));
  if (!over) zero(0, rows.length * line);
  const letters = Math.floor((over ? width : names) / 6.1);
  rows.forEach((row, i) => {
    const y = i * line + 4 + drop, length = Math.max(0.5, (Math.abs(row.effect) / most) * Math.max(6, half));
    if (over) zero(y - 1, y + 16); // not through the names
    const fits = [row.name, row.short].find((each) => each.length <= letters);
    const name = fits ?? row.short.slice(0, letters - 1) + "…";
    const text = node("text", { x: 0, y: over ? y - 4 : y + 12 }, name);
    text.append(node("title", {}, row.name));
    svg.append(text);
    svg.append(node("rect", { class: "bar", x: row.effect < 0 ? middle - length : middle, width: length, y, height: 15 }));
    const reach = (effect) => middle + (effect / most) * Math.max(6, half);
    if (row.low !== null) svg.append(node("line", { class: "whisker", x1: reach(row.low), x2: reach(row.high), y1: y + 7.5, y2: y + 7.5 }));
    const after = row.effect < 0 ? Math.min(middle - length, reach(row.low ?? 0)) - 5 : Math.max(middle + length, reach(row.high ?? 0)) + 5;
    svg.append(node("text", { x: after, y: y + 12, "text-anchor": row.effect < 0 ? "end" : "start" }, row.shown));
  });
  return svg;
}

// Steps from one level to another: a bar for each, which begins where the previous bar ends.
export function waterfall(width, start, rows, write) {
  const LINE = 40, levels = [start];
  for (const row of rows) levels.push(levels.at(-1) + (row.change ?? 0));
  const ends = rows.flatMap((row, i) => [levels[i + 1] - HALF * (row.error ?? 0), levels[i + 1] + HALF * (row.error ?? 0)]);
  const low = Math.min(...levels, ...ends), high = Math.max(...levels, ...ends), side = 90;
  const x = (v) => 4 + ((v - low) / (high - low || 1)) * (width - side - 8);
  const all = [{ name: "The run", shown: write(start) }, ...rows, { name: "Here", shown: write(levels.at(-1)) }];
  const height = all.length * LINE + 4;
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": "The change by input" });
  all.forEach((row, k) => {
    const from = levels[Math.max(0, Math.min(k - 1, levels.length - 1))], to = levels[Math.min(k, levels.length - 1)];
    const top = k * LINE + 18, change = k > 0 && k < all.length - 1;
    const ends = change ? [x(from), x(to)] : [x(to) - 1, x(to) + 1];
    svg.append(node("text", { x: 0, y: top - 4 }, row.name));
    svg.append(node("rect", { class: !change ? "end" : to < from ? "fall" : "bar", x: Math.min(...ends), width: Math.max(1, Math.abs(ends[1] - ends[0])), y: top, height: 14 }));
    const reach = change ? HALF * (row.error ?? 0) : 0;
    if (reach) svg.append(node("line", { class: "whisker", x1: x(to - reach), x2: x(to + reach), y1: top + 7, y2: top + 7 }));
    if (k < all.length - 1) svg.append(node("line", { class: "rule", x1: x(to), x2: x(to), y1: top + 14, y2: top + LINE }));
    svg.append(node("text", { x: Math.max(...ends, x(to + reach)) + 6, y: top + 11 }, row.shown));
  });
  return svg;
}
