"use strict";
// Value after a move of the inputs = value + sum of (sensitivity x shift): nothing is simulated here.
for (const box of document.querySelectorAll(".sliders")) {
  const base = Number(box.dataset.value);
  const places = Number(box.dataset.places);
  const inputs = [...box.querySelectorAll("input[type=range]")];
  const text = (x, digits, sign) => {
    const size = Math.abs(x).toLocaleString("en-US", {
      minimumFractionDigits: digits, maximumFractionDigits: digits });
    if (!/[1-9]/.test(size)) return size;
    return (x < 0 ? "\u2212" : sign ? "+" : "") + size;
  };
  const money = (x, sign) => box.dataset.currency + "\u00a0" + text(x, places, sign);
  const show = () => {
    let change = 0;
    for (const input of inputs) {
      const shift = Number(input.value);
      const part = shift * Number(input.dataset.slope);
      const words = text(shift, Number(input.dataset.places), true) + "\u00a0" + input.dataset.unit;
      change += part;
      input.setAttribute("aria-valuetext", words);
      const label = input.closest("label");
      label.querySelector(".shift").textContent = words;
      label.querySelector(".part").textContent = money(part, true);
      label.classList.toggle("on", shift !== 0);
    }
    box.querySelector(".base").textContent = money(base, false);
    box.querySelector(".change").textContent = money(change, true);
    box.querySelector(".after").textContent = money(base + change, false);
  };
  box.addEventListener("input", show);
  box.querySelector("button").addEventListener("click", () => {
    for (const input of inputs) input.value = 0;
    show();
  });
  box.classList.add("ready");
  show();
}
