// Reading the data that the file carries: columns become typed arrays when they are first looked at.

const DATA = JSON.parse(document.getElementById("figure-data").textContent);
const MISSING = -32768;
const decoded = new WeakMap();

function column(packed) {
  if (!decoded.has(packed)) decoded.set(packed, decode(packed));
  return decoded.get(packed);
}

function decode(packed) {
  const text = atob(packed.d);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const view = new DataView(bytes.buffer);
  const wide = packed.k === "f4" ? 4 : 2;
  const values = new Float64Array(bytes.length / wide);
  for (let i = 0; i < values.length; i++) {
    if (wide === 4) {
      values[i] = view.getFloat32(4 * i, true);
    } else {
      const code = view.getInt16(2 * i, true);
      values[i] = code === MISSING ? NaN : packed.o + packed.s * code;
    }
  }
  return values;
}

function scaled(values, factor, offset) {
  return Float64Array.from(values, (v) => v * factor + (offset || 0));
}

function plus(a, b) {
  return Float64Array.from(a, (v, i) => v + b[i]);
}

// [lowest, highest] finite value of some columns, or null
function range(columns) {
  let low = Infinity, high = -Infinity;
  for (const values of columns) {
    for (const v of values) {
      if (v < low) low = v;
      if (v > high) high = v;
    }
  }
  return low <= high ? [low, high] : null;
}

// the value that a part q of the finite absolute values does not exceed
function quantile(values, q) {
  const sizes = Float64Array.from(values, Math.abs).filter(Number.isFinite).sort();
  return sizes.length ? sizes[Math.min(sizes.length - 1, Math.floor(q * sizes.length))] : 0;
}

// NaN must reach Plotly as null: a gap in the line
function gaps(values) {
  return Array.from(values, (v) => (Number.isFinite(v) ? v : null));
}

// the same digits as in the tables beside the figures
function digits(value, count) {
  if (value === null || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const magnitude = Math.floor(Math.log10(Math.abs(value)));
  if (Math.abs(value) >= 1e6 || magnitude < -4) return value.toExponential(count - 1).replace("-", "−");
  return value.toFixed(Math.max(0, count - 1 - magnitude)).replace("-", "−");
}

function ratio(after, before) {
  if (!(before > 0) || after === null) return "";
  const part = after / before;
  return ` (${part < 0.005 ? "<0.01" : part < 9.995 ? part.toFixed(2) : digits(part, 3)}×)`;
}
