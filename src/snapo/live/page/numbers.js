// Numbers as people read and write them.

const formats = new Map();

function format(options) {
  const key = JSON.stringify(options);
  if (!formats.has(key)) formats.set(key, new Intl.NumberFormat("en-GB", options));
  return formats.get(key);
}

// A number with a sensible number of digits; a dash where there is none.
export function shown(x, digits = 5) {
  return written(x, digits).replace("-", "−");
}

function written(x, digits) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  if (Math.abs(x) >= 10 ** (digits - 1)) return format({ maximumFractionDigits: 0 }).format(x);
  if (x !== 0 && Math.abs(x) < 1e-6) return x.toExponential(2);
  return format({ maximumSignificantDigits: digits }).format(x);
}

export function signed(x, digits = 5) {
  return x > 0 ? `+${shown(x, digits)}` : shown(x, digits);
}

export const error = (x) => (Number.isFinite(x) && x !== null ? `± ${shown(x, 3)}` : "");

// A number in a field: short where rounding away binary noise loses nothing.
export const field = (x) => String(Number(x.toPrecision(12)));

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
