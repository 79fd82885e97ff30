// Named scenarios: saved, compared, downloaded.

import { element } from "./draw.js";
import { unit } from "./inputs.js";
import { error, shown, signed } from "./numbers.js";
import { at, page } from "./page.js";

// The move of an input as text: from one number to another, one shift or factor for all, or some numbers.
export function movedBy(input, numbers) {
  const f = input.factor, old = input.values, by = numbers.map((v, i) => (v - old[i]) * f);
  const name = unit(input), alike = (xs) => xs.every((x) => Math.abs(x - xs[0]) <= 1e-9 * Math.abs(xs[0]));
  if (old.length === 1) return `${shown(old[0] * f)} to ${shown(numbers[0] * f)} ${name}`.trim();
  if (alike(by)) return `all ${signed(by[0])} ${name}`.trim();
  if (old.every(Boolean) && alike(numbers.map((v, i) => v / old[i]))) return `all ${signed(100 * (numbers[0] / old[0] - 1), 4)} %`;
  const some = by.filter(Boolean);
  return `${some.length} of ${old.length}: ${signed(Math.min(...some))} to ${signed(Math.max(...some))} ${name}`.trim();
}

// The moves of a scenario: [name, move] for every input and choice.
function moves(each, called) {
  const inputs = Object.entries(each.values).map(([name, numbers]) => {
    const input = page.inputs.find((found) => found.name === name && found.values.length === numbers.length);
    return [called(name), input ? movedBy(input, numbers) : ""];
  });
  const choices = Object.entries(each.chosen ?? {}).map(([name, value]) => [called(name), String(value)]);
  return [...choices, ...inputs, ...(each.policy ? [["Policy", "trained on the page"]] : [])];
}

// All scenarios in columns: their values, and every input that any of them moved.
function beside(found, called) {
  const all = found.map((each) => new Map(moves(each, called))), names = [...new Set(all.flatMap((map) => [...map.keys()]))];
  const cells = (name, texts, kind = "") => element("tr", {}, element("th", { scope: "row" }, name), ...texts.map((text) => element("td", { className: kind }, text)));
  const head = element("tr", {}, ...["", ...found.map((each) => each.name)].map((text) => element("th", { scope: "col" }, text)));
  const number = (key, more, write) => found.map((each) => `${write(each.value?.[key])} ${error(each.value?.[more])}`);
  at("beside-table").replaceChildren(head,
    cells("Value", number("value", "standard_error", (x) => shown(x, 6))), cells("Change", number("change", "change_error", signed)),
    ...names.map((name) => cells(name, all.map((map) => map.get(name) ?? "as in the run"))));
}

export function scenarios(found, { load, keep, forget, called }) {
  at("keep").onsubmit = (event) => {
    event.preventDefault();
    const name = at("keep-name").value.trim();
    if (!name) return;
    keep(name);
    at("keep-name").value = "";
  };
  at("none-kept").hidden = found.length > 0;
  at("scenarios-csv").hidden = found.length === 0;
  at("beside").hidden = found.length < 2 || !page.inputs.length;
  beside(found, called);
  if (!found.length) return at("kept").replaceChildren();
  const head = element("tr", {}, ...["Scenario", "Value", "", "Change", "", "Moved", ""].map((text) => element("th", { scope: "col" }, text)));
  at("kept").replaceChildren(head, ...found.map((each) => row(each, load, forget, called)));
}

function row(each, load, forget, called) {
  const value = each.value ?? {}, moved = moves(each, called).map(([name, how]) => `${name} ${how}`.trim()).join("; ");
  const tools = element("td", {},
    element("button", { type: "button", onclick: () => load(each.values, each.chosen ?? {}, each.policy ? each.id : 0), ariaLabel: `Show ${each.name}` }, "Show"), " ",
    element("a", { href: `scenario/${each.id}.csv`, download: "" }, "CSV"), " ",
    each.case ? element("a", { href: `scenario/${each.id}.zip`, download: "" }, "Case") : "", " ",
    element("button", { type: "button", onclick: () => forget(each.id), ariaLabel: `Forget ${each.name}` }, "Forget"));
  const text = (content, kind = "") => element("td", { className: kind }, content);
  return element("tr", {}, text(each.name, "name"), text(shown(value.value, 6)), text(error(value.standard_error)), text(signed(value.change)), text(error(value.change_error)), text(moved, "name"), tools);
}
