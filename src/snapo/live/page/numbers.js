// Numbers in the form in which people read and write them.

const formats = new Map();

function format(options) {
  const key = JSON.stringify(options);
  if (!formats.has(key)) formats.set(key, new Intl.NumberFormat("en-GB", options));
  return formats.get(key);
}

// A number with a sensible number of digits; a dash if there is no number.
export function shown(x, digits = 5) {
  return written(x, digits).replace(/^-/, "−");
}

function written(x, digits) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  if (x !== 0 && (Math.abs(x) < 1e-5 || Math.abs(x) >= 10 ** (digits + 6))) {
    const [mantissa, power] = x.toExponential(Math.min(digits, 4) - 1).split("e");
    return `${Number(mantissa)}\u00a0×\u00a010${raised(String(Number(power)))}`;
  }
  if (Math.abs(x) >= 10 ** (digits - 1)) return format({ maximumFractionDigits: 0 }).format(x);
  return format({ maximumSignificantDigits: digits }).format(x);
}

export function signed(x, digits = 5) {
  return x > 0 ? `+${shown(x, digits)}` : shown(x, digits);
}

// Half of the 95 % interval, from a standard error: the only number that is written after ±.
export const HALF = 1.959964;
export const error = (x) => (Number.isFinite(x) && x !== null ? `± ${shown(HALF * x, 2)}` : "");

const DECIDED = ["converged", "start kept", "", undefined, null]; // verdicts with nothing to add

// How near a policy is to its best, by the norm of its gradient: against that where it was trained,
// or, where that is nothing beyond its noise, against the noise. `run`: its own verdict on its
// training; where that is not settled, a small gradient here says no more than there.
export function nearness({ gradient, noise, at_training: before }, run = {}) {
  const away = gradient > 2 * noise && gradient > 2 * before, open = !DECIDED.includes(run.convergence);
  const times = before ? `${shown(gradient / before, 2)} times as large as at the inputs of training, with a noise of ${shown(noise / before, 2)}` : "";
  const verdict = run.verdict || (open ? `the training is “${run.convergence}”` : "");
  const said = verdict ? ` The verdict on the run itself: ${verdict.replace(/[.]$/, "")}.` : "";
  const near = open
    ? `The policy is about as near its best here as at the run's inputs: its gradient is ${times || "no more than noise, as it is there"}. However, it is not certain that it is near its best there.`
    : `The policy is near its best here, as its gradient shows: it is ${times || "no more than noise, as it was at the inputs of training"}.`;
  const words = away
    ? `The policy is no longer near its best here: its gradient ${times ? `is ${times}` : "is above its noise, and was not at the inputs of training"}. The value shown is still exact for this policy, but a better policy is likely to exist. Press "Train again here" to see how much it gains.`
    : near;
  return { far: away || open, words: words + said };
}

// A number in a field: short where rounding away binary noise loses nothing.
export function field(x) {
  const plain = Number(x.toPrecision(12));
  return Math.abs(plain) >= 1e9 ? plain.toExponential().replace("e+", "e") : String(plain);
}

// How the numbers of a column are shown: with as many decimals as the largest needs, so that their
// points stand under one another; each by itself where that would leave nothing of the small ones.
export function alike(numbers, digits = 5) {
  const sizes = numbers.filter((x) => typeof x === "number" && Number.isFinite(x) && x !== 0).map(Math.abs);
  const most = Math.max(...sizes), least = Math.min(...sizes);
  if (!sizes.length || least < 1e-3 * most || most >= 1e9 || most < 1e-3) return (x) => shown(x, digits);
  const wanted = Math.max(0, digits - 1 - Math.floor(Math.log10(most)));
  const needed = sizes.map((x) => String(Number(x.toPrecision(digits))).split(".")[1]?.length ?? 0);
  const places = Math.min(wanted, Math.max(...needed));
  const fixed = format({ minimumFractionDigits: places, maximumFractionDigits: places });
  return (x) => (typeof x === "number" && Number.isFinite(x) ? fixed.format(x).replace("-", "−") : shown(x));
}

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

const raised = (digits) => [...digits].map((each) => RAISED[each]).join("");

// A unit as it is written by hand: "kg/m^3" as "kg/m³", "um" as "µm", "Pa*s" as "Pa·s".
export function unitWords(text) {
  const power = /((?<![A-Za-z])(?:[cdhkmnuµ]?m|s|h|min|rad|K|ft|day|week|month|year)|\))\^?(-?\d)(?![\w.])/g;
  const written = text.replace(power, (_, unit, digits) => unit + raised(digits));
  return written.replace(/\bum\b/g, "µm").replace(/\bdegC\b/g, "°C").replace(/\bsqrt\((\w+)\)|\b([A-Za-z]+)\^0\.5\b/g, "√$1$2").replaceAll("*", "·").replaceAll("^k", "ᵏ");
}

// A number as it was typed or pasted: "1 234,5", "1,234.5", "16.61". NaN where it is none.
export function parsed(text) {
  let s = text.trim().replace(/[\s\u00a0\u202f']/g, "").replace("−", "-").replace(/%$/, "");
  if (/^[+-]?\d{1,3}(,\d{3})+(\.\d*)?$/.test(s)) s = s.replaceAll(",", "");
  else if (/^[+-]?\d{1,3}(\.\d{3})+,\d*$/.test(s)) s = s.replaceAll(".", "").replace(",", ".");
  else if (/^[+-]?\d*,\d+$/.test(s)) s = s.replace(",", ".");
  return /^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$/.test(s) ? Number(s) : NaN;
}

// The column of a paste: the last cell of every line; a first line of words is a header.
export function column(text) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() !== "");
  const cells = lines.map((line) => line.split(/[\t;]/).map((cell) => cell.trim()).filter(Boolean).at(-1) ?? "");
  const found = cells.map(parsed);
  if (found.length > 1 && Number.isNaN(found[0]) && /^\p{L}/u.test(cells[0])) {
    found.shift();
    cells.shift();
  }
  const bad = found.findIndex(Number.isNaN);
  return bad >= 0 ? { bad: cells[bad] || "an empty cell", line: bad + 1 } : { numbers: found };
}

// Round numbers that cover an interval.
export function ticks(low, high, count) {
  const width = high - low || Math.abs(high) || 1;
  const raw = width / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * width; k++) found.push(k * step + 0);
  return found;
}
