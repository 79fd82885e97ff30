// The policy's distance from its best at these inputs: its gradient, a bound, and further training.

import { error, nearness, shown } from "./numbers.js";
import { at, page } from "./page.js";

export function health(found) {
  const { far, words } = nearness(found, page.about.result);
  at("health").hidden = false;
  at("health").classList.toggle("far", far);
  at("health").textContent = words;
}

// Nothing is known about these inputs yet.
export function rest() {
  at("bounds").textContent = "";
}

// No calculation is running except the moves; `words`: the result of the last calculation.
export function idle(words) {
  page.busy = "";
  at("cancel").hidden = at("progress").hidden = at("adopt").hidden = true;
  at("trained").textContent = words;
}

export function training({ table }) {
  at("cancel").hidden = at("progress").hidden = false;
  at("progress").max = table.of;
  at("progress").value = table.step;
  at("trained").textContent = `step ${table.step} of ${table.of}`;
}

export function trained({ table }) {
  const after = `${shown(table.value, 6)} ${error(table.standard_error)}, a gain of ${shown(table.gain, 4)} ${error(table.gain_error)}`;
  idle(`After ${table.steps} more steps the value is ${after}.`);
  page.trained = table.policy;
  at("adopt").hidden = false;
}

export function cancelled() {
  idle("Training was cancelled.");
}

export function bounded({ table }) {
  idle("");
  const { gap, upper } = table, share = Math.abs(gap.high / (upper.value || 1));
  const advice = share > 0.02 ? " Further training may gain a part of that." : " Further training cannot gain more than that.";
  at("bounds").textContent = `The optimum is at most ${shown(upper.high, 6)} (95 %): this policy is at most ${shown(gap.high, 4)} (${shown(100 * share, 2)} %) below it.${advice}`;
}
