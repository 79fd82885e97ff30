// The controls: curves and tables are dragged or pasted, single numbers have a field and a slider.

import { below, drawn, element, frame, node } from "./draw.js";
import { column, field, parsed, shown, unitWords } from "./numbers.js";

const MOVES = 20; // of its standard moves that a slider reaches to either side
const SHARE = 0.01; // of a number that does not say its move

// Makes the controls of all inputs in `place`; `moved(done)` is called at every change, with
// whether the hand has left the control.
export function controls(place, inputs, moved) {
  const groups = new Map();
  for (const input of inputs) groups.set(input.group, [...(groups.get(input.group) ?? []), input]);
  place.replaceChildren();
  const first = ["price", "curve"], rank = (name) => (first.includes(name) ? 0 : 1);
  const ordered = [...groups].sort(([a], [b]) => rank(a) - rank(b));
  for (const [k, [name, members]] of ordered.entries()) {
    const mark = element("span", { className: "moved" });
    const box = element("details", { className: "group", open: groups.size < 4 || k === 0 }, element("summary", {}, groups.size === 1 && name === "other" ? "All inputs" : capital(name), mark));
    for (const input of members) {
      input.now = [...input.values];
      box.append(input.values.length > 1 ? table(input, moved) : single(input, moved));
    }
    place.append(box);
    for (const input of members) {
      const inner = input.show;
      input.show = () => {
        inner();
        input.box.classList.toggle("changed", changed(input));
        const count = members.filter(changed).length;
        mark.textContent = count ? `${count} moved` : "";
      };
      input.show();
    }
  }
}

export const changed = (input) => input.now.some((v, i) => v !== input.values[i]);
export const unit = (input) => unitWords(input.trade_unit || (input.unit === "1" ? "" : input.unit));

export const capital = (words) => words.replace(/^./, (c) => c.toUpperCase());

export function label(input) {
  return capital(input.name.replaceAll(/[_.]/g, " "));
}

// The size of one standard move of a number, in the unit of the case.
export function usual(input, i) {
  if (input.move !== null) return Math.abs(input.move);
  const largest = Math.max(...input.values.map(Math.abs)) || 1;
  return SHARE * (Math.abs(input.values[i]) || largest);
}

function titled(input, ...below) {
  input.box = element("div", { className: "input" },
    element("div", { className: "title" }, element("b", {}, label(input)), element("span", {}, input.words)), ...below);
  input.box.dataset.input = input.name;
  input.refuse = (words) => {
    input.box.querySelector(".bad")?.remove();
    if (words) input.box.append(element("p", { className: "bad", role: "alert" }, words));
  };
  return input.box;
}

// A field for a number; a text that is not a number is reported, and changes nothing.
function entry(input, name, read, write) {
  const box = element("input", { type: "text", inputMode: "decimal", ariaLabel: name });
  box.refresh = () => {
    box.value = field(read() * input.factor);
    box.removeAttribute("aria-invalid");
  };
  box.addEventListener("change", () => {
    const number = parsed(box.value);
    if (Number.isNaN(number)) {
      box.setAttribute("aria-invalid", "true");
      input.refuse(`"${box.value.slice(0, 40)}" is not a number.`);
      return;
    }
    input.refuse("");
    write(number / input.factor);
  });
  return box;
}

function single(input, moved) {
  const base = input.values[0], reach = MOVES * usual(input, 0);
  const set = (v, done) => {
    // The number of the run is restored exactly, without conversion through its unit.
    input.now = [field(v * input.factor) === field(base * input.factor) ? base : v];
    input.show();
    moved(done);
  };
  const low = base >= 0 ? Math.max(0, base - reach) : base - reach;
  const slider = element("input", { type: "range", min: "0", max: "400", step: "1", ariaLabel: `${label(input)}, slider` });
  const high = base + reach, step = (high - low) / 400;
  slider.addEventListener("input", () => set(rounded(low + step * Number(slider.value), step), false));
  slider.addEventListener("change", () => moved(true));
  const box = entry(input, label(input), () => input.now[0], (v) => set(v, true));
  const back = element("button", { type: "button", onclick: () => set(base, true), ariaLabel: `${label(input)}: back to the run's number` }, "↺");
  input.show = () => {
    box.refresh();
    slider.value = String(Math.round((input.now[0] - low) / step));
    slider.setAttribute("aria-valuetext", `${shown(input.now[0] * input.factor)} ${unit(input)}`);
    back.disabled = !changed(input);
  };
  const row = element("div", { className: "row" }, slider, box, element("span", { className: "in" }, unit(input)), back);
  return titled(input, row);
}

// Rounds to one digit below the step, so that a slider gives no numbers like 0.8500000000001.
function rounded(v, step) {
  const digits = Math.max(0, Math.min(15, 1 - Math.floor(Math.log10(step))));
  return Number(v.toFixed(digits));
}

// The number of a handle: the mean of those that it moves together.
const mean = (numbers, at) => at.reduce((sum, i) => sum + numbers[i], 0) / at.length;
const flat = (numbers, at) => at.every((i) => numbers[i] === numbers[at[0]]);
const level = (numbers, at) => (flat(numbers, at) ? numbers[at[0]] : mean(numbers, at));

// Puts a handle at a level: equal numbers stay equal, other numbers keep their shape.
function put(input, at, v) {
  const by = v - level(input.now, at), alike = flat(input.now, at);
  for (const i of at) input.now[i] = alike ? v : input.now[i] + by;
}

function table(input, moved) {
  const place = element("div", { className: "chart" });
  const boxes = [];
  const set = (h, v, done) => {
    put(input, input.handles[h].at, v);
    input.show();
    moved(done);
  };
  const paste = (first, text) => {
    const found = column(text), room = input.handles.length - first;
    if (found.bad !== undefined) return input.refuse(`Nothing was pasted: line ${found.line} holds ${JSON.stringify(found.bad)}, which is not a number.`);
    if (found.numbers.length > room) return input.refuse(`Nothing was pasted: the column has ${found.numbers.length} numbers, but from this row on there is room for only ${room}.`);
    input.refuse("");
    found.numbers.forEach((v, k) => put(input, input.handles[first + k].at, v / input.factor));
    input.show();
    moved(true);
  };
  const rows = input.handles.map((handle, h) => {
    const box = entry(input, `${label(input)}, ${handle.label}`, () => level(input.now, handle.at), (v) => set(h, v, true));
    box.addEventListener("paste", (event) => {
      const text = event.clipboardData.getData("text");
      if (!/[\n\t]/.test(text.trim())) return;
      event.preventDefault();
      paste(h, text);
    });
    boxes.push(box);
    return element("tr", {}, element("td", {}, handle.label), element("td", {}, box));
  });
  const all = element("input", { type: "text", inputMode: "decimal", ariaLabel: `${label(input)}: shift all by`, className: "short" });
  const shift = () => {
    const by = parsed(all.value);
    if (Number.isNaN(by)) return input.refuse(`"${all.value.slice(0, 40)}" is not a number.`);
    input.refuse("");
    input.now = input.now.map((v) => v + by / input.factor);
    input.show();
    moved(true);
  };
  all.addEventListener("keydown", (event) => event.key === "Enter" && shift());
  const back = element("button", { type: "button", onclick: () => { input.now = [...input.values]; input.refuse(""); input.show(); moved(true); } }, "Back to the run's numbers");
  const tools = element("div", { className: "tools" }, element("label", {}, "Shift all by ", all), element("span", {}, unit(input)), element("button", { type: "button", onclick: shift }, "Shift"), back);
  const numbers = element("details", {}, element("summary", {}, "Type numbers, or paste a column"), element("div", { className: "scroll tall" }, element("table", { className: "numbers" }, ...rows)));
  input.show = () => {
    boxes.forEach((box) => box.refresh());
    back.disabled = !changed(input);
    if (!place.held) drawn(place, (width) => editor(width, place, input, set));
  };
  const legend = element("p", { className: "legend" }, element("span", {}, element("i"), unit(input) || "number"), element("span", {}, element("i", { className: "b" }), "the run's"));
  return titled(input, place, legend, tools, numbers);
}

// A line through the handles, each of which is dragged, or moved by the arrow keys.
function editor(width, place, input, set) {
  const f = input.factor, now = input.handles.map((h) => level(input.now, h.at) * f), base = input.handles.map((h) => level(input.values, h.at) * f);
  const low = Math.min(...now, ...base), high = Math.max(...now, ...base);
  // If all numbers are 0, the chart has the range of a slider.
  const least = high === low && high === 0 ? MOVES * usual(input, 0) * f : 1e-12;
  const pad = Math.max((high - low) * 0.25, Math.abs(high) * 0.04, least);
  const chart = frame(width, 200, low - pad, high + pad, `${label(input)}: points to drag`);
  chart.svg.setAttribute("role", "group");
  const gap = (chart.right - chart.left) / now.length, x = (i) => chart.left + (i + 0.5) * gap;
  // Dates and numbers follow one another along a line; names stand apart, each on a stem.
  const apart = !input.handles.every((h) => /\d/.test(h.label));
  const foot = chart.y(Math.max(low - pad, Math.min(high + pad, 0)));
  const point = (v, i) => (apart ? `M${x(i).toFixed(1)} ${foot.toFixed(1)}` : i ? "" : "M") + `${apart || i ? "L" : ""}${x(i).toFixed(1)} ${chart.y(v).toFixed(1)}`;
  const line = (numbers) => numbers.map(point).join("");
  const marks = (numbers) => numbers.map((v, i) => `M${(x(i) - Math.min(16, gap / 3)).toFixed(1)} ${chart.y(v).toFixed(1)}h${(2 * Math.min(16, gap / 3)).toFixed(1)}`).join("");
  chart.svg.append(node("path", { class: "base", d: (apart ? marks : line)(base) }));
  const curve = node("path", { class: "now", d: line(now) });
  chart.svg.append(curve);
  below(chart.svg, input.handles.map((h) => h.label), x, chart.bottom, chart.right - chart.left);
  const scale = (high - low + 2 * pad) / (chart.bottom - chart.top);
  input.handles.forEach((handle, h) => {
    const dot = node("circle", { class: "handle", cx: x(h), cy: chart.y(now[h]), r: Math.min(7, Math.max(3.5, gap / 3)), tabindex: 0, role: "slider", "aria-label": `${label(input)}, ${handle.label}`, "aria-orientation": "vertical" });
    const say = () => {
      dot.setAttribute("aria-valuenow", field(now[h]));
      dot.setAttribute("aria-valuetext", `${shown(now[h])} ${unit(input)}`);
      dot.setAttribute("cy", chart.y(now[h]));
      curve.setAttribute("d", line(now));
    };
    const to = (v, done) => {
      now[h] = rounded(v, Math.max(scale, 1e-9));
      place.held = true;
      set(h, now[h] / f, done);
      say();
    };
    say();
    let from = null;
    dot.addEventListener("pointerdown", (event) => {
      dot.setPointerCapture(event.pointerId);
      from = { y: event.clientY, v: now[h] };
      event.preventDefault();
      dot.focus();
    });
    dot.addEventListener("pointermove", (event) => from && to(from.v - (event.clientY - from.y) * scale, false));
    const end = () => {
      if (!from) return;
      from = null;
      place.held = false;
      set(h, now[h] / f, true);
      refocus(place, h);
    };
    dot.addEventListener("pointerup", end);
    dot.addEventListener("pointercancel", end);
    dot.addEventListener("keydown", (event) => {
      const steps = { ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key];
      const walk = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (steps) {
        event.preventDefault();
        to(now[h] + steps * usual(input, handle.at[0]) * f, true);
        place.held = false;
        drawn(place, place.make);
        refocus(place, h);
      } else if (walk) {
        event.preventDefault();
        refocus(place, Math.max(0, Math.min(now.length - 1, h + walk)));
      }
    });
    chart.svg.append(dot);
  });
  return chart.svg;
}

const refocus = (place, h) => place.querySelectorAll(".handle")[h]?.focus();
