// Options and switches of the case: a menu shows the allowed values.

import { element } from "./draw.js";

const words = (value) => (typeof value === "boolean" ? (value ? "yes" : "no") : value);

// Makes a menu for each choice below the inputs; `moved(done)` is called at every change.
export function menus(place, choices, moved) {
  if (!choices.length) return [];
  const mark = element("span", { className: "moved" });
  const box = element("details", { className: "group", open: choices.length < 4 }, element("summary", {}, "Choices", mark));
  const made = choices.map((choice) => {
    const menu = element("select", { ariaLabel: choice.title }, ...choice.allowed.map((value, i) => element("option", { value: String(i) }, words(value))));
    const row = element("div", { className: "input" }, element("div", { className: "title" }, element("label", {}, element("b", {}, choice.title), " ", menu), element("span", {}, `in the run: ${words(choice.value)}`)));
    const note = element("p", { className: "quiet", role: "status", hidden: true });
    row.append(note);
    row.dataset.choice = choice.name;
    box.append(row);
    const found = { ...choice, now: choice.value };
    found.set = (value) => {
      if (!choice.allowed.includes(value)) return;
      found.now = value;
      menu.value = String(choice.allowed.indexOf(value));
      row.classList.toggle("changed", value !== choice.value);
      const count = made.filter((each) => each.now !== each.value).length;
      mark.textContent = count ? `${count} moved` : "";
    };
    found.busy = (text) => {
      note.textContent = text;
      note.hidden = !text;
    };
    menu.addEventListener("change", () => {
      found.set(choice.allowed[Number(menu.value)]);
      moved(true);
    });
    return found;
  });
  place.append(box);
  for (const each of made) each.set(each.value);
  return made;
}
