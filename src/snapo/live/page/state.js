// The inputs and choices as text, for the address and for steps back.

import { changed } from "./inputs.js";
import { page } from "./page.js";

const CHOICE = "~"; // before the name of a choice

// "price=0:21.5,1:22&~item.unmet=waits": every number that differs from the run's, by its position.
export function written() {
  const parts = new URLSearchParams();
  for (const input of page.inputs.filter(changed)) {
    parts.set(input.name, input.now.flatMap((v, i) => (v === input.values[i] ? [] : [`${i}:${v}`])).join());
  }
  for (const menu of page.menus) if (menu.now !== menu.value) parts.set(CHOICE + menu.name, String(menu.now));
  return parts.toString();
}

// Puts the inputs and menus where a text has them; what it does not name, or names wrongly, is the
// run's.
export function restore(text) {
  const parts = new URLSearchParams(text);
  for (const menu of page.menus) {
    const value = menu.allowed.find((each) => String(each) === parts.get(CHOICE + menu.name));
    menu.set(value ?? menu.value);
  }
  for (const input of page.inputs) {
    const now = [...input.values];
    for (const pair of (parts.get(input.name) ?? "").split(",").filter(Boolean)) {
      const [i, v] = pair.split(":").map((each) => (each?.trim() ? Number(each) : NaN));
      if (i in now && Number.isFinite(v)) now[i] = v;
    }
    input.now = now;
    input.refuse("");
    input.show();
  }
}

// Steps: call `record` after each; `back` and `forth` return the text of another step, or null.
export class Steps {
  past = [];
  future = [];
  here = "";

  record(text) {
    if (text === this.here) return;
    this.past.push(this.here);
    this.future = [];
    this.here = text;
  }

  go(from, to) {
    if (!from.length) return null;
    to.push(this.here);
    return (this.here = from.pop());
  }

  back() {
    return this.go(this.past, this.future);
  }

  forth() {
    return this.go(this.future, this.past);
  }
}
