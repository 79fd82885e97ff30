// The page: what the server says is shown, and what the hand moves is sent.

import { capital, changed, controls, label, unit } from "./inputs.js";
import { menus } from "./menus.js";
import { bars, drawn, element, fan, tornado } from "./draw.js";
import { alike, error, nearness, shown, signed, unitWords } from "./numbers.js";
import { offer, scenarios } from "./scenarios.js";

const at = (id) => document.getElementById(id);
const MEMORY = "snapo moved"; // of this tab: a reload finds the moved numbers again
const CHOICES = "?"; // beside the moved inputs, in that memory
const QUIET = 220; // milliseconds without a further move, after which the exact value is asked for

const page = { about: null, inputs: [], menus: [], base: null, now: {}, n: 0, valued: -1, socket: null, timer: null, ready: false };

function connect() {
  const socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
  page.socket = socket;
  socket.addEventListener("message", (event) => heard(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    status("not connected", "lost");
    page.ready = false;
    setTimeout(connect, 1500);
  });
}

function send(order) {
  if (page.socket.readyState === WebSocket.OPEN) page.socket.send(JSON.stringify(order));
}

function status(words, kind = "") {
  at("status").textContent = words;
  at("status").className = kind;
}

function trouble(words) {
  at("trouble").textContent = words ?? "";
  at("trouble").hidden = !words;
}

function heard(message) {
  const stages = { about, starting, ready, failed, refused, done, scenarios: kept, written: () => {}, training, trained, cancelled, bounded };
  if (stages[message.stage]) return stages[message.stage](message);
  if (message.n !== page.n) return;
  page.now[message.stage] = message.table;
  if (message.stage === "value") page.valued = message.n;
  render(message.stage);
}

function about({ about, page: name }) {
  page.about = about;
  page.name = name;
  document.title = `${about.title} – snapo`;
  at("title").textContent = about.title;
  at("about").textContent = `${about.kind}, ${about.folder}`;
  if (about.meaning) at("value-head").textContent = about.meaning;
  if (!page.base) {
    at("figure").textContent = shown(about.result.value, 6);
    at("error").textContent = error(about.result.standard_error);
    at("changes").replaceChildren(fact("of the run", "as solve reported it"));
  }
}

function starting(message) {
  page.ready = false;
  idle("");
  status("starting", "busy");
  trouble(message.message);
}

function failed(message) {
  status("no calculation", "lost");
  trouble(message.message);
}

function ready(message) {
  const first = !page.base;
  page.base = message.base;
  page.ready = true;
  page.paths = message.counts.value;
  page.unit = message.unit;
  at("bound").hidden = !message.bounded;
  page.units = message.units;
  at("unit").textContent = page.unit;
  trouble("");
  if (first) {
    page.inputs = message.inputs;
    controls(at("groups"), page.inputs, moved);
    page.menus = menus(at("groups"), message.choices ?? [], moved);
    if (page.kept) kept(page.kept); // now that choices have names
    remembered();
    choices();
  }
  at("reset").disabled = false;
  at("take").hidden = false;
  if (anything()) ask();
  else home();
}

// Back at the run's own numbers: nothing to compute.
function home() {
  page.n += 1;
  page.now = { ...page.base };
  page.valued = page.n;
  for (const stage of Object.keys(page.now)) render(stage);
  status("the run's numbers");
  at("again").hidden = true;
  send({ do: "cancel" });
}

// Whether an input or a choice differs from the run's.
function anything() {
  return page.inputs.some(changed) || page.menus.some((menu) => menu.now !== menu.value);
}

function chosen() {
  return Object.fromEntries(page.menus.filter((menu) => menu.now !== menu.value).map((menu) => [menu.name, menu.now]));
}

function values() {
  return Object.fromEntries(page.inputs.filter(changed).map((input) => [input.name, input.now]));
}

function moved(done) {
  sessionStorage.setItem(MEMORY, JSON.stringify({ ...values(), [CHOICES]: chosen() }));
  trouble("");
  predict();
  clearTimeout(page.timer);
  if (done) ask();
  else page.timer = setTimeout(ask, QUIET);
}

function ask() {
  clearTimeout(page.timer);
  if (!page.ready) return;
  if (!anything()) return home();
  page.n += 1;
  page.sent = performance.now();
  page.fresh = new Set();
  status("revaluing", "busy");
  for (const id of ["value", "best"]) at(id).classList.add("pending");
  offer(false);
  send({ do: "move", n: page.n, values: values(), chosen: chosen() });
}

// To first order, from the sensitivities of the run: at once, without asking anybody. Null where
// none are known.
function predicted() {
  let sum = 0;
  if (Object.keys(chosen()).length || page.inputs.some((input) => changed(input) && !input.slope)) return null;
  for (const input of page.inputs.filter(changed)) input.now.forEach((v, i) => (sum += v === input.values[i] ? 0 : input.slope[i] * (v - input.values[i])));
  return sum;
}

function predict() {
  if (!page.base) return;
  const by = predicted();
  at("value").classList.add("pending");
  if (by === null) {
    at("error").textContent = "of other numbers";
    return;
  }
  at("figure").textContent = shown(page.base.value.value + by, 6);
  at("error").textContent = "to first order";
  facts(by, null);
}

function refused(message) {
  if (message.n !== page.n && message.n !== -1) return;
  status("refused", "lost");
  const words = message.message;
  // The longest name that the message holds is the input that it is about; as a key of the case it
  // may have points.
  const plain = (text) => text.replaceAll(/[_.]/g, " ");
  const named = page.inputs.filter((input) => changed(input) && plain(words).includes(plain(input.name))).sort((a, b) => b.name.length - a.name.length)[0];
  trouble(words);
  if (page.valued === page.n) { // a bound or a name was refused, and not the numbers
    at("bound").disabled = false;
    at("bounds").textContent = "";
  } else if (page.base) {
    at("figure").textContent = "–"; // not to first order either
    at("error").textContent = "";
    facts(null, null, "refused");
  }
  if (named) named.refuse(words);
}

function done(message) {
  if (message.n !== page.n) return;
  for (const input of page.inputs) input.refuse("");
  status(`revalued in ${shown(message.seconds, 2)} s`);
}

function training({ n, table }) {
  if (n !== page.n) return;
  at("train").disabled = true;
  at("cancel").hidden = at("progress").hidden = false;
  at("progress").max = table.of;
  at("progress").value = table.step;
  at("trained").textContent = `step ${table.step} of ${table.of}`;
}

function idle(words) {
  at("bound").disabled = false;
  at("train").disabled = false;
  at("cancel").hidden = at("progress").hidden = true;
  at("trained").textContent = words;
}

function trained({ n, table }) {
  if (n !== page.n) return;
  const after = `${shown(table.value, 6)} ${error(table.standard_error)}, a gain of ${shown(table.gain, 4)} ${error(table.gain_error)}`;
  idle(`After ${table.steps} more steps the value is ${after}. To have that policy, keep the scenario and solve its case.`);
}

function cancelled() {
  idle("Training was cancelled.");
}

function fact(name, value, note) {
  return element("div", {}, element("dt", {}, name), element("dd", {}, value, note ? element("span", { className: "quiet" }, ` ${note}`) : ""));
}

function facts(by, found, none = "…") {
  const base = page.base.value, rows = [fact("the run's inputs", shown(base.value, 6), error(base.standard_error))];
  const any = anything();
  if (any) {
    if (by !== null) rows.push(fact("change to first order", signed(by)));
    rows.push(fact("change, revalued", found ? signed(found.change) : none, found ? error(found.change_error) : ""));
  } else rows.push(fact("paths", shown(page.paths, 6)));
  at("changes").replaceChildren(...rows);
}

function render(stage) {
  const show = { value, sections, deltas, today, fans, health }[stage];
  if (show && page.now[stage]) show(page.now[stage]);
}

function value(found) {
  at("value").classList.remove("pending");
  at("figure").textContent = shown(found.value, 6);
  at("error").textContent = error(found.standard_error);
  facts(predicted(), found);
  offer(anything());
  const here = anything() ? `${page.name}-${page.valued}` : "run";
  for (const [id, address] of [["take-csv", `shown/${here}.csv`], ["take-zip", `case/${here}.zip`], ["take-xlsx", `case/${here}.xlsx`]]) at(id).href = address;
  at("again").hidden = !page.about.trains || !anything();
  at("bounds").textContent = "";
  idle("");
}

function health(found) {
  at("best").classList.remove("pending");
  const { far, words } = nearness(found);
  at("health").hidden = false;
  at("health").classList.toggle("far", far);
  at("health").textContent = words;
}

function bounded({ n, table }) {
  if (n !== page.n) return;
  at("bound").disabled = false;
  const { gap, upper } = table, share = Math.abs(gap.value / (upper.value || 1));
  const advice = share > 0.02 ? " Training again may gain a part of that." : " Training again can gain no more.";
  at("bounds").textContent = `No policy has a value above ${shown(upper.value, 6)} ${error(upper.standard_error)}: this one is at most ${shown(gap.value, 4)} ${error(gap.standard_error)} (${shown(100 * share, 2)} %) below the best.${advice}`;
}

function today(found) {
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

// The domain's own sections. A column of standard errors stands in the one before it.
function sections(found) {
  const text = (each) => (typeof each === "string" ? each : shown(each));
  at("sections").replaceChildren(...found.map(({ title, description, columns, rows }) => {
    const kept = columns.map((_, i) => i).filter((i) => !columns[i][0].startsWith("±"));
    const beside = (row, i) => (columns[i + 1]?.[0].startsWith("±") && row[i + 1] !== null ? element("span", { className: "quiet" }, ` ± ${shown(row[i + 1], 2)}`) : "");
    const kind = (row, i) => (typeof row?.[i] === "string" ? "text" : "");
    const head = element("tr", {}, ...kept.map((i) => element("th", { scope: "col", className: kind(rows[0], i) }, headed(...columns[i]))));
    const body = rows.map((row) => element("tr", {}, ...kept.map((i) => element("td", { className: kind(row, i) }, text(row[i]), beside(row, i)))));
    return element("section", { className: "card" }, element("h2", {}, title), description ? element("p", { className: "quiet" }, description) : "", element("div", { className: "scroll" }, element("table", {}, head, ...body)));
  }));
}

function choices() {
  const many = page.inputs.filter((input) => input.values.length > 1);
  const price = many.find((input) => input.group === "price") ?? many.find((input) => input.group === "curve") ?? many[0];
  at("delta-input").replaceChildren(...page.inputs.map((input) => element("option", { value: input.name, selected: input === price }, label(input))));
  const outputs = [...new Set(page.base.deltas.map((each) => each.of).filter(Boolean))];
  at("delta-of").replaceChildren(...outputs.map((name) => element("option", { value: name }, name)));
  at("delta-of-label").hidden = !outputs.length;
  const names = (page.base.fans ?? []).map((each) => each.name);
  const first = names.find((name) => page.units[name]) ?? names[0];
  at("fan-name").replaceChildren(...names.map((name) => element("option", { value: name, selected: name === first }, name.replaceAll("_", " ").replaceAll(".", " "))));
}

function deltas(found) {
  at("deltas").hidden = false;
  const name = at("delta-input").value, input = page.inputs.find((each) => each.name === name), of = at("delta-of").value;
  const mine = found.filter((each) => !of || each.of === of);
  const scaled = (table) => table.find((each) => each.input === name && (!of || each.of === of)).rows.map((row) => ({ ...row, ...Object.fromEntries(["value", "low", "high"].map((key) => [key, row[key] === null ? null : row[key] / input.factor])) }));
  const rows = scaled(found), base = scaled(page.base.deltas), per = unit(input) || "1";
  drawn(at("delta-chart"), (width) => bars(width, rows, found === page.base.deltas ? null : base, `Deltas of ${label(input)}`));
  at("delta-note").textContent = of ? `${of}, ${mine[0].of_unit}, per ${per}, at the set point; outlines: the run's inputs.` : `${page.unit || "Value"} per ${per}; lines: 95 % intervals of sampling and policy; outlines: the run's inputs.${reported(input)}`;
  const number = alike([...rows, ...base].map((row) => row.value));
  const head = element("tr", {}, ...["", "now", "low", "high", "the run's"].map((text) => element("th", { scope: "col" }, text)));
  at("delta-table").replaceChildren(head, ...rows.map((row, i) => element("tr", {}, ...[row.label || label(input), ...[row.value, row.low, row.high, base[i].value].map(number)].map((text) => element("td", {}, text)))));
  const effects = mine.map((each) => ({ each, input: page.inputs.find((i) => i.name === each.input) })).filter(({ each }) => each.effect);
  effects.sort((a, b) => Math.abs(b.each.effect) - Math.abs(a.each.effect));
  drawn(at("tornado"), (width) => tornado(width, effects.slice(0, 14).map(({ each, input }) => ({ name: `${label(input)}, ${by(input)}`, short: label(input), effect: each.effect, low: each.low, high: each.high, shown: signed(each.effect, 4) }))));
}

// Where the derivative of an input comes from, unless it is that with the decisions held.
const reported = (input) => ({
  "through the policy": " With the decisions held it was refuted by a bump: the run's is the bump, elsewhere it changes as the held one does.",
  "range": " More and less of this input differ at the run's inputs: the interval holds both.",
  "not known": " The derivative with respect to this input is not known.",
})[input.source] ?? "";

const by = (input) => (input.move === null ? "+1 %" : `${signed(input.move * input.factor, 3)} ${one(unit(input), input.move * input.factor)}`.trim());
const one = (words, amount) => (amount === 1 ? words.replace(/^points$/, "point") : words).replace(/^1\//, "per ");

function fans(found) {
  at("fans").hidden = false;
  const name = at("fan-name").value, series = found.find((each) => each.name === name);
  const base = found === page.base.fans ? null : page.base.fans.find((each) => each.name === name);
  const days = page.about.days, step = page.about.step;
  drawn(at("fan-chart"), (width) => fan(width, series, base, (i) => (days ? days[Math.min(i, days.length - 1)] : `${step} ${i}`)));
  const unit = unitWords(page.units[name] ?? "");
  at("fan-note").textContent = `${unit ? `${unit}; ` : ""}mean, and the bands that hold half and nine tenths of the paths${base ? "; dashed: the mean at the run's inputs" : ""}.`;
}

function load(numbers, choices = {}) {
  for (const menu of page.menus) menu.set(menu.name in choices ? choices[menu.name] : menu.value);
  for (const input of page.inputs) {
    const found = numbers[input.name];
    input.now = found && found.length === input.values.length ? [...found] : [...input.values];
    input.refuse("");
    input.show();
  }
  moved(true);
}

function remembered() {
  try {
    const found = JSON.parse(sessionStorage.getItem(MEMORY) ?? "{}"), words = found[CHOICES] ?? {};
    for (const menu of page.menus) if (menu.name in words) menu.set(words[menu.name]);
    for (const input of page.inputs) {
      const numbers = found[input.name];
      if (Array.isArray(numbers) && numbers.length === input.values.length && numbers.every(Number.isFinite)) {
        input.now = numbers;
        input.show();
      }
    }
  } catch {
    sessionStorage.removeItem(MEMORY);
  }
}

function kept(message) {
  page.kept = message;
  scenarios(message.scenarios, {
    load,
    keep: (name) => page.valued === page.n && send({ do: "keep", n: page.n, name }),
    forget: (id) => send({ do: "forget", id }),
    called: (name) => page.menus.find((menu) => menu.name === name)?.title ?? name.replaceAll(/[_.]/g, " "),
  });
}

at("train").addEventListener("click", () => page.valued === page.n && send({ do: "train", n: page.n }));
at("bound").addEventListener("click", () => {
  if (page.valued !== page.n) return;
  at("bound").disabled = true;
  at("bounds").textContent = "bounding; this takes some seconds";
  send({ do: "bound", n: page.n });
});
at("cancel").addEventListener("click", () => send({ do: "cancel" }));
at("reset").addEventListener("click", () => load({}));
for (const name of ["delta-input", "delta-of"]) at(name).addEventListener("change", () => page.now.deltas && deltas(page.now.deltas));
at("fan-name").addEventListener("change", () => page.now.fans && fans(page.now.fans));
connect();
