// What every part of the page shares: its state, and the cards with their reasons.

import { element } from "./draw.js";
import { changed } from "./inputs.js";

export const at = (id) => document.getElementById(id);

// - `base`: the tables of the run; `now`: those shown; `last`: the point that was valued last.
// - `n`: of the newest move; `valued`: of the newest one with a value.
export const page = { about: null, inputs: [], menus: [], base: null, now: {}, last: null, n: 0, valued: -1, ready: false, policy: 0 };

export const chosen = () => Object.fromEntries(page.menus.filter((menu) => menu.now !== menu.value).map((menu) => [menu.name, menu.now]));

export const values = () => Object.fromEntries(page.inputs.filter(changed).map((input) => [input.name, input.now]));

// Whether anything that decides the value differs from the run's.
export const anything = () => page.inputs.some(changed) || page.menus.some((menu) => menu.now !== menu.value) || Boolean(page.policy);

// The cards of the tables, by stage.
const CARDS = { value: ["value"], health: ["best"], today: ["today"], sections: ["sections"], deltas: ["deltas"], fans: ["fans"] };

// Dims the numbers of some cards, which are not of the inputs shown, and says why on their edge;
// without a reason they are as usual again.
export function dim(reason, stages = Object.keys(CARDS)) {
  for (const stage of stages) {
    for (const id of CARDS[stage]) {
      for (const card of id === "sections" ? at(id).children : [at(id)]) mark(card, reason);
    }
  }
}

function mark(card, reason) {
  card.classList.toggle("stale", Boolean(reason));
  const note = card.querySelector(":scope > .reason");
  if (!reason) note?.remove();
  else if (note) note.textContent = reason;
  else card.prepend(element("p", { className: "reason" }, reason));
}

// Disables buttons and shows the reason next to them; without a reason they are enabled.
export function withhold(reason, buttons, place) {
  for (const button of buttons) {
    button.disabled = Boolean(reason);
    button.title = reason;
  }
  place.textContent = reason;
}
