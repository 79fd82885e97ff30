// The tables of a move: today's decision, the sections of the domain, deltas, and fans over time.

import { capital, label, unit } from "./inputs.js";
import { bars, drawn, element, fan, tornado } from "./draw.js";
import { alike, error, shown, signed, unitWords } from "./numbers.js";
import { at, page } from "./page.js";

export function fact(name, value, note) {
  return element("div", {}, element("dt", {}, name), element("dd", {}, value, note ? element("span", { className: "quiet" }, ` ${note}`) : ""));
}

export function today(found) {
  at("today").hidden = false;
  at("today-words").textContent = found.description;
  at("today-facts").replaceChildren(...found.facts.map(([name, number, unit]) => fact(capital(name), shown(number), unitWords(unit))));
  const kind = (row, i) => (i && typeof row?.[i] === "string" ? "text" : "");
  const head = element("tr", {}, ...found.columns.map(([name, unit], i) => element("th", { scope: "col", className: kind(found.rows[0], i) }, headed(name, unit))));
  const each = found.columns.map((_, i) => alike(found.rows.map((row) => row[i])));
  const rows = found.rows.map((row) => element("tr", {}, ...row.map((cell, i) => element("td", { className: kind(row, i) }, typeof cell === "string" ? cell : each[i](cell)))));
  at("today-table").replaceChildren(head, ...rows);
  at("today-more").hidden = !rows.length;
}

const headed = (name, unit) => capital(unit ? `${name}, ${unitWords(unit)}` : name);

// The sections of the domain. A column of standard errors is shown in the column before it.
export function sections(found) {
  const text = (each) => (typeof each === "string" ? each : shown(each));
  at("sections").replaceChildren(...found.map(({ title, description, columns, rows, facts = [] }) => {
    const kept = columns.map((_, i) => i).filter((i) => !columns[i][0].startsWith("±"));
    const beside = (row, i) => (columns[i + 1]?.[0].startsWith("±") && row[i + 1] !== null ? element("span", { className: "quiet" }, ` ${error(row[i + 1])}`) : "");
    const kind = (row, i) => (typeof row?.[i] === "string" ? "text" : "");
    const head = element("tr", {}, ...kept.map((i) => element("th", { scope: "col", className: kind(rows[0], i) }, headed(...columns[i]))));
    const body = rows.map((row) => element("tr", {}, ...kept.map((i) => element("td", { className: kind(row, i) }, text(row[i]), beside(row, i)))));
    return element("section", { className: "card" }, element("h2", {}, title), description ? element("p", { className: "quiet" }, description) : "", facts.length ? element("dl", {}, ...facts.map(([name, number, unit]) => fact(capital(name), shown(number), unitWords(unit)))) : "", element("div", { className: "scroll" }, element("table", {}, head, ...body)));
  }));
}

export function choices() {
  const many = page.inputs.filter((input) => input.values.length > 1);
  const price = many.find((input) => input.group === "price") ?? many.find((input) => input.group === "curve") ?? many[0];
  at("delta-input").replaceChildren(...page.inputs.map((input) => element("option", { value: input.name, selected: input === price }, label(input))));
  const outputs = [...new Set(page.base.deltas.map((each) => each.of).filter(Boolean))];
  at("delta-of").replaceChildren(...outputs.map((name) => element("option", { value: name }, name)));
  at("delta-of-label").hidden = !outputs.length;
  const series = page.base.fans ?? [];
  const first = series.find((each) => page.units[each.name]) ?? series[0];
  at("fan-name").replaceChildren(...series.map((each, i) => element("option", { value: i, selected: each === first }, seriesName(each, series))));
}

// The name of a series for users, with its kind if a state and an output share the name.
const KINDS = { state: "state", action: "decision", outputs: "output of one step" };

function seriesName(each, series) {
  const name = page.names[each.name] ?? capital(each.name === "action" ? "decision" : each.name.replaceAll("_", " ").replaceAll(".", " ").replace(/^action /, "decision "));
  return series.filter((other) => other.name === each.name).length > 1 ? `${name} (${KINDS[each.kind]})` : name;
}

export function deltas(found) {
  at("deltas").hidden = false;
  const name = at("delta-input").value, input = page.inputs.find((each) => each.name === name), of = at("delta-of").value;
  const mine = found.filter((each) => !of || each.of === of);
  const scaled = (table) => table.find((each) => each.input === name && (!of || each.of === of)).rows.map((row) => ({ ...row, ...Object.fromEntries(["value", "low", "high"].map((key) => [key, row[key] === null ? null : row[key] / input.factor])) }));
  const rows = scaled(found), base = scaled(page.base.deltas), per = unit(input) || "1";
  drawn(at("delta-chart"), (width) => bars(width, rows, found === page.base.deltas ? null : base, `Deltas of ${label(input)}`));
  at("delta-note").textContent = of ? `${of}, ${mine[0].of_unit}, per ${per}, at the set point; outlines show the run's inputs.` : `${quotient(page.unit || "Value", per)}; lines show 95 % intervals (sampling and policy), outlines the deltas at the run's inputs.${reported(input)}`;
  const number = alike([...rows, ...base].map((row) => row.value));
  const head = element("tr", {}, ...["", "now", "low", "high", "in the run"].map((text) => element("th", { scope: "col" }, text)));
  at("delta-table").replaceChildren(head, ...rows.map((row, i) => element("tr", {}, ...[row.label || label(input), ...[row.value, row.low, row.high, base[i].value].map(number)].map((text) => element("td", {}, text)))));
  const effects = mine.map((each) => ({ each, input: page.inputs.find((i) => i.name === each.input) })).filter(({ each }) => each.effect);
  effects.sort((a, b) => Math.abs(b.each.effect) - Math.abs(a.each.effect));
  drawn(at("tornado"), (width) => tornado(width, effects.slice(0, 14).map(({ each, input }) => ({ name: `${label(input)}, ${by(input)}`, short: label(input), effect: each.effect, low: each.low, high: each.high, shown: signed(each.effect, 4) }))));
}

// The unit of a derivative: "MWh" for EUR per EUR/MWh.
const quotient = (top, per) => (per === "1" ? top : per.startsWith(`${top}/`) ? per.slice(top.length + 1) : `${top} per ${per}`);

// The source of an input's derivative, unless it is the derivative with the decisions held fixed.
const reported = (input) => ({
  "through the policy": " A bump contradicted the derivative with the decisions held fixed. At the run's inputs, the number shown is the result of the bump; at other inputs, it changes by as much as the derivative with the decisions held fixed.",
  "range": " At the run's inputs, an increase and a decrease of this input have different effects; the interval contains both.",
  "not known": " The derivative with respect to this input is not known.",
})[input.source] ?? "";

const by = (input) => (input.move === null ? "+1 %" : `${signed(input.move * input.factor, 3)} ${one(unit(input), input.move * input.factor)}`.trim());
const one = (words, amount) => (amount === 1 ? words.replace(/^points$/, "point") : words).replace(/^1\//, "per ");

export function fans(found) {
  at("fans").hidden = false;
  const i = Number(at("fan-name").value), series = found[i], name = series.name;
  const base = found === page.base.fans ? null : page.base.fans[i];
  const days = page.about.days, step = page.about.step;
  drawn(at("fan-chart"), (width) => fan(width, series, base, (at) => (days ? days[Math.min(at, days.length - 1)] : `${step} ${at}`)));
  const unit = unitWords(page.units[name] ?? "");
  at("fan-note").textContent = `${unit ? `${unit}; ` : ""}mean, and bands with 50 % and 90 % of the paths${base ? "; dashed: the mean at the run's inputs" : ""}.`;
}
