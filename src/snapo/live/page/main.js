// The page: it shows what the server sends, and sends what the user moves.

import { bounded, cancelled, health, idle, rest, trained, training } from "./best.js";
import { explained, firstOrder } from "./change.js";
import { downloads } from "./downloads.js";
import { capital, controls } from "./inputs.js";
import { menus } from "./menus.js";
import { error, shown, signed } from "./numbers.js";
import { anything, at, chosen, dim, page, values, withhold } from "./page.js";
import { choices, deltas, fact, fans, sections, today } from "./results.js";
import { scenarios } from "./scenarios.js";
import { restore, Steps, written } from "./state.js";

const QUIET = 220; // milliseconds without a further move, after which the exact value is asked for
const LONG = 2; // seconds after which a move shows its progress
const STAGES = ["value", "health", "today", "sections", "deltas", "fans"];

const steps = new Steps();
const stale = new Set(); // stages whose numbers are not of the inputs shown
let [socket, timer, sent, refusal, tries, lost] = [null, null, 0, "", 0, ""];
let compiled = new Set(); // choices for which the worker has code

function connect() {
  socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws").replace(/#.*/, "")));
  socket.addEventListener("message", (event) => heard(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    status("not connected", "lost");
    page.ready = false;
    tries += 1;
    if (tries > 1) trouble(`The server of this page has ended. ${page.about?.restart ?? ""}`);
    expect();
    setTimeout(connect, 1500);
  });
}

function send(order) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(order));
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
  const stages = { about, starting, ready, failed, refused, done, scenarios: kept, written: () => {} };
  if (stages[message.stage]) return stages[message.stage](message);
  if (message.n !== page.n) return;
  const answers = { training, trained, cancelled, bounded, explained: ({ table }) => { idle(""); explained(table, called); } };
  if (answers[message.stage]) {
    answers[message.stage](message);
    return buttons();
  }
  page.now[message.stage] = message.table;
  if (message.stage === "value") page.valued = message.n;
  render(message.stage);
}

function about({ about, page: name }) {
  tries = 0;
  page.about = about;
  page.name = name;
  document.title = `${about.title} – snapo`;
  at("title").textContent = about.title;
  at("about").textContent = `${about.kind}, ${about.folder}`;
  if (about.meaning) at("value-head").textContent = about.meaning;
  if (!page.base && !about.follows) {
    at("figure").textContent = shown(about.result.value, 6);
    at("error").textContent = error(about.result.standard_error);
    at("changes").replaceChildren(fact("value of the run", "as reported by snapo solve"));
  }
}

function starting(message) {
  page.ready = false;
  compiled = new Set();
  idle("");
  status("starting", "busy");
  lost = typeof page.policy === "number" && page.policy > 0 ? " The policy that was trained on this page is lost; the policy of the run is used." : "";
  if (lost) page.policy = 0;
  trouble(message.message && message.message + lost);
  expect();
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
  page.bounded = message.bounded;
  page.units = message.units;
  page.names = message.names ?? {};
  at("unit").textContent = page.unit;
  if (message.meaning) at("value-head").textContent = message.meaning;
  trouble("");
  if (first) {
    page.inputs = message.inputs;
    controls(at("groups"), page.inputs, moved);
    page.menus = menus(at("groups"), message.choices ?? [], moved);
    if (page.kept) kept(page.kept); // now that choices have names
    choices();
    restore(location.hash.slice(1)); // a reload, or an address that was sent on
    steps.here = written();
  }
  at("reset").disabled = false;
  at("take").hidden = false;
  offered(first);
  if (anything()) moved(true);
  else home();
  if (lost) trouble(lost);
}

// A restarted server offers the inputs that the last page of the previous server showed.
function offered(first) {
  const last = page.about.last;
  if (!first || !last || anything()) return;
  const count = Object.keys({ ...last.values, ...last.chosen }).length;
  at("offer").hidden = !count;
  at("offer-words").textContent = `When this page was last open, ${count === 1 ? "one input or choice" : `${count} inputs or choices`} had other values.`;
  at("offer-take").onclick = () => load(last.values, last.chosen);
}

// Back at the run's numbers: nothing has to be computed.
function home() {
  page.n += 1;
  page.now = { ...page.base };
  page.valued = page.n;
  sent = 0;
  stale.clear();
  dim("");
  for (const stage of Object.keys(page.now)) render(stage);
  status("the run's numbers");
  send({ do: "cancel" });
  buttons();
}

// An input or a choice was moved; `done`: whether the user has released its control.
function moved(done) {
  page.n += 1; // what is on its way is of other inputs
  refusal = "";
  trouble("");
  at("offer").hidden = at("explained").hidden = true;
  clearTimeout(timer);
  if (done) {
    steps.record(written());
    address();
  }
  for (const stage of STAGES) stale.add(stage);
  idle("");
  expect();
  if (done) ask();
  else timer = setTimeout(ask, QUIET);
}

// The address contains the state, so that a reload or another page of this server shows it.
function address() {
  history.replaceState(null, "", steps.here ? `#${steps.here}` : location.pathname);
}

function ask() {
  clearTimeout(timer);
  if (!page.ready) return;
  if (!anything()) return home();
  page.n += 1;
  sent = performance.now();
  send({ do: "move", n: page.n, values: values(), chosen: chosen(), policy: page.policy });
  expect();
}

const key = () => JSON.stringify([chosen(), page.policy]);
const seconds = () => (sent ? Math.floor((performance.now() - sent) / 1000) : 0);
const isCompiled = () => !Object.keys(chosen()).length || compiled.has(JSON.stringify(chosen()));

// The reason why the numbers on the page do not belong to its inputs.
function reason() {
  if (refusal) return "for the previous inputs; the present inputs are refused";
  if (!page.ready) return "for the previous inputs; the calculation is starting";
  if (page.valued === page.n) return "for the previous inputs; the present inputs are valued next";
  const time = seconds() >= LONG ? `, ${seconds()} s` : "";
  return isCompiled() ? `for the previous inputs; the present inputs are being valued${time}` : `for the previous inputs; code for this choice is being compiled, once${time}`;
}

// Dims every stale number; the value is shown to first order if it can be.
function expect() {
  if (!page.base) return;
  const waits = stale.has("value"), by = waits && !refusal ? firstOrder(page.last, key()) : null;
  const dimmed = [...stale].filter((stage) => stage !== "value" || by === null);
  if (stale.size) dim(reason(), dimmed);
  if (by !== null) dim("", ["value"]);
  at("value").classList.toggle("pending", waits);
  const long = waits && !refusal && page.ready && sent && (seconds() >= LONG || !isCompiled());
  at("working").hidden = !long;
  for (const menu of page.menus) menu.busy(long && !isCompiled() && menu.now !== menu.value ? `code for this choice is being compiled, once; this may take a minute (${seconds()} s so far)` : "");
  if (waits && !refusal && page.ready) status(seconds() >= LONG ? `revaluing, ${seconds()} s` : "revaluing", "busy");
  if (by !== null) {
    at("figure").textContent = shown(page.last.value + by, 6);
    at("error").textContent = "to first order";
    facts(page.last.value + by - page.base.value.value, null);
  } else if (waits) facts(null, null, refusal ? "refused" : "…");
  buttons();
}

// Disables buttons that cannot work, and shows the reason.
function buttons() {
  const why = refusal ? "These inputs are refused, so nothing can be computed."
    : !page.ready ? "The calculation is starting."
    : page.valued !== page.n ? "These inputs are being valued; please wait." : "";
  at("again").hidden = !page.about || !anything();
  at("train").hidden = !page.about?.trains;
  at("bound").hidden = !page.bounded;
  at("run-policy").hidden = !page.policy;
  withhold(why || page.busy || "", [at("train"), at("bound"), at("explain")], at("again-why"));
  withhold(why || (anything() ? "" : "These are the inputs of the run; move an input first."), [at("keep-now")], at("keep-why"));
  at("undo").disabled = !steps.past.length;
  at("redo").disabled = !steps.future.length;
  at("undo").title = steps.past.length ? "Ctrl+Z" : "no input has been moved yet";
  at("redo").title = steps.future.length ? "Ctrl+Shift+Z" : "nothing was undone";
}

function refused(message) {
  if (message.n !== page.n && message.n !== -1) return;
  const words = message.message;
  status("refused", "lost");
  trouble(words);
  if (page.valued === page.n) { // a bound or a name was refused, and not the numbers
    idle("");
    return buttons();
  }
  refusal = words;
  sent = 0;
  // The longest name that the message holds is the input that it is about; as a key of the case it
  // may have points.
  const plain = (text) => text.replaceAll(/[_.]/g, " ");
  const named = page.inputs.filter((input) => input.name in values() && plain(words).includes(plain(input.name))).sort((a, b) => b.name.length - a.name.length)[0];
  if (page.base) {
    at("figure").textContent = "–"; // not to first order either
    at("error").textContent = "";
  }
  expect();
  if (named) named.refuse(words);
}

function done(message) {
  if (message.n !== page.n) return;
  sent = 0;
  for (const input of page.inputs) input.refuse("");
  status(`revalued in ${shown(message.seconds, 2)} s`);
}

function facts(by, found, none = "…") {
  const base = page.base.value, rows = [fact(`the run's inputs, on the ${shown(page.paths, 6)} paths of this page`, shown(base.value, 6), error(base.standard_error))];
  if (anything()) {
    if (by !== null) rows.push(fact("change to first order", signed(by)));
    rows.push(fact("change, revalued", found ? signed(found.change) : none, found ? error(found.change_error) : ""));
  }
  if (page.policy) rows.push(fact("policy", typeof page.policy === "string" ? "from the scenario" : "trained again here"));
  at("changes").replaceChildren(...rows);
}

function render(stage) {
  const show = { value, sections, deltas, today, fans, health }[stage];
  if (!show || !page.now[stage]) return;
  show(page.now[stage]);
  if (stage === "deltas") page.last.deltas = page.now.deltas;
  stale.delete(stage);
  dim("", [stage]);
  expect();
}

function value(found) {
  compiled.add(JSON.stringify(chosen()));
  stale.delete("value");
  // At the run's inputs the value is the one that the run reports, from all of its paths.
  const about = page.about, same = about && !about.follows && Number.isFinite(about.result.value);
  const first = anything() || !same ? found : about.result;
  page.last = { value: first.value, values: structuredClone(values()), key: key(), deltas: null };
  at("value").classList.remove("pending");
  at("figure").textContent = shown(first.value, 6);
  at("error").textContent = error(first.standard_error);
  facts(Object.keys(chosen()).length ? null : found.predicted ?? null, found);
  const here = anything() ? `${page.name}-${page.valued}` : "run";
  for (const [id, address] of [["take-csv", `shown/${here}.csv`], ["take-zip", `case/${here}.zip`], ["take-xlsx", `case/${here}.xlsx`]]) at(id).href = address;
  rest();
  idle("");
}

function load(numbers, choices = {}, policy = 0) {
  page.policy = policy;
  for (const menu of page.menus) menu.set(menu.name in choices ? choices[menu.name] : menu.value);
  for (const input of page.inputs) {
    const found = numbers[input.name];
    input.now = found && found.length === input.values.length ? [...found] : [...input.values];
    input.refuse("");
    input.show();
  }
  moved(true);
}

// Another policy at the same inputs.
function use(policy) {
  page.policy = policy;
  moved(true);
}

// A step back or forward, or an address that was typed.
function jump(text) {
  if (text === null || !page.base) return;
  restore(text);
  steps.here = written();
  moved(true);
}

const called = (name) => page.menus.find((menu) => menu.name === name)?.title ?? capital(name.replaceAll(/[_.]/g, " "));

function kept(message) {
  page.kept = message;
  scenarios(message.scenarios, {
    load,
    keep: (name) => page.valued === page.n && send({ do: "keep", n: page.n, name }),
    forget: (id) => send({ do: "forget", id }),
    called,
  });
}

const work = (id, order, words) => at(id).addEventListener("click", () => {
  if (page.valued !== page.n) return;
  idle(words);
  page.busy = "Another calculation is running; only one can run at a time.";
  send({ do: order, n: page.n });
  buttons();
});
work("train", "train", "training starts");
work("explain", "explain", "the inputs are moved and valued one after another");
work("bound", "bound", "the bound is being computed, which takes some seconds");
at("cancel").addEventListener("click", () => send({ do: "cancel" }));
at("adopt").addEventListener("click", () => use(page.trained));
at("run-policy").addEventListener("click", () => use(0));
at("reset").addEventListener("click", () => load({}));
at("undo").addEventListener("click", () => jump(steps.back()));
at("redo").addEventListener("click", () => jump(steps.forth()));
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.matches("input[type=text], input:not([type])")) return;
  event.preventDefault();
  jump(event.shiftKey ? steps.forth() : steps.back());
});
addEventListener("hashchange", () => {
  const text = location.hash.slice(1);
  if (page.base && text !== steps.here) {
    restore(text);
    moved(true);
  }
});
setInterval(() => stale.size && expect(), 1000);
for (const name of ["delta-input", "delta-of"]) at(name).addEventListener("change", () => page.now.deltas && deltas(page.now.deltas));
at("fan-name").addEventListener("change", () => page.now.fans && fans(page.now.fans));
downloads(at("download-trouble"));
connect();
