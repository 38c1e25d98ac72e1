// Small things that everything below is made of.
const $ = (id) => document.getElementById(id);
const SVG_NS = "http://www.w3.org/2000/svg";
const COLOR = { ink: "#1b1f24", grey: "#6b7280", blue: "#0072b2", red: "#d55e00", green: "#00785a", focus: "#aa4499", amber: "#e69f00" };
const VIRIDIS = ["#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"];
const LOW_MV = -90, HIGH_MV = 0;

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// The share of its range that a potential has reached, 0 to 1.
const share = (mv) => clamp((mv - LOW_MV) / (HIGH_MV - LOW_MV), 0, 1);

function viridis(part) {
  const place = clamp(part, 0, 1) * (VIRIDIS.length - 1), low = Math.floor(place), high = Math.min(low + 1, VIRIDIS.length - 1);
  const mix = (at) => {
    const [a, b] = [VIRIDIS[low], VIRIDIS[high]].map((color) => parseInt(color.slice(at, at + 2), 16));
    return Math.round(a + (b - a) * (place - low));
  };
  return `rgb(${mix(1)},${mix(3)},${mix(5)})`;
}

// The last index whose time is not after t; -1 before the first.
function locate(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + 1e-6) low = middle + 1; else high = middle;
  }
  return low - 1;
}

// The least and the largest of several columns.
function extent(columns) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) for (const value of column) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return [low, high];
}

// A number as people write it, with a real minus.
const number = (value, digits = 0) => value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
const signed = (value, digits = 0) => (value > 0 && Number(value.toFixed(digits)) !== 0 ? "+" : "") + number(value, digits);
const degrees = (radians) => number((radians * 180) / Math.PI, 1) + "°";

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG_NS, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// Corners [x, y] of a body's own frame, where the body is.
function placed(corners, x, y, theta) {
  const c = Math.cos(theta), s = Math.sin(theta);
  return corners.map(([a, b]) => [x + c * a - s * b, y + s * a + c * b]);
}

function ellipsePoints(x, y, [major, minor, direction], scale) {
  const points = [];
  for (let k = 0; k <= 36; k += 1) {
    const angle = (k * Math.PI) / 18;
    points.push([scale * major * Math.cos(angle), scale * minor * Math.sin(angle)]);
  }
  return placed(points, x, y, direction);
}
