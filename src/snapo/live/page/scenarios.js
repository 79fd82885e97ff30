// Named scenarios: kept, compared, taken away.

import { element } from "./draw.js";
import { error, shown, signed } from "./numbers.js";

const at = (id) => document.getElementById(id);

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
  if (!found.length) return at("kept").replaceChildren();
  const head = element("tr", {}, ...["Scenario", "Value", "", "Change", "", "Moved", ""].map((text) => element("th", { scope: "col" }, text)));
  at("kept").replaceChildren(head, ...found.map((each) => row(each, load, forget, called)));
}

function row(each, load, forget, called) {
  const value = each.value ?? {}, names = [...Object.keys(each.values), ...Object.keys(each.chosen ?? {})].map(called);
  const tools = element("td", {},
    element("button", { type: "button", onclick: () => load(each.values, each.chosen ?? {}, each.policy ? each.id : 0), ariaLabel: `Show ${each.name}` }, "Show"), " ",
    element("a", { href: `scenario/${each.id}.csv`, download: "" }, "CSV"), " ",
    each.case ? element("a", { href: `scenario/${each.id}.zip`, download: "" }, "Case") : "", " ",
    element("button", { type: "button", onclick: () => forget(each.id), ariaLabel: `Forget ${each.name}` }, "Forget"));
  const text = (content, kind = "") => element("td", { className: kind }, content);
  return element("tr", {}, text(each.name, "name"), text(shown(value.value, 6)), text(error(value.standard_error)), text(signed(value.change)), text(error(value.change_error)), text(names.join(", "), "name"), tools);
}
