// Helpers of all pages: elements, colours, numbers, and plots in one style.
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);

const css = getComputedStyle(document.body);
const NAMES = ["ink", "grey", "line", "blue", "red", "green", "amber", "focus"];
const COLOR = Object.fromEntries(NAMES.map((name) => [name, css.getPropertyValue(`--${name}`).trim()]));
const VIRIDIS = ["#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"];
const LOW_MV = -90, HIGH_MV = 0;
const FONT = { family: css.getPropertyValue("font-family") || "sans-serif", size: 12, color: COLOR.ink };
const DASHES = { dash: "7 4", dot: "2 3" };
const narrow = () => window.innerWidth < 560;

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// The share of its range that a potential has reached, 0 to 1, and its colour.
const share = (mv) => clamp((mv - LOW_MV) / (HIGH_MV - LOW_MV), 0, 1);
const viridis = (part) => VIRIDIS[Math.round(part * (VIRIDIS.length - 1))];

// A number with a typographic minus; zero has no sign.
const number = (value, digits = 0) => value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
const signed = (value, digits = 0) => (Number(value.toFixed(digits)) > 0 ? "+" : "") + number(value, digits);

// The last index whose time is not after t; -1 before the first.
const locate = (times, t) => times.findLastIndex((time) => time <= t + 1e-6);

// Smallest and largest value of several columns, with a margin.
function range(columns, margin) {
  const values = columns.flat();
  const low = values.reduce((a, b) => Math.min(a, b), Infinity), high = values.reduce((a, b) => Math.max(a, b), -Infinity);
  return [low - margin, high + margin];
}

const axis = (text, rest = {}) => ({ title: { text, standoff: 5 }, gridcolor: COLOR.line, zeroline: false, fixedrange: true, ...rest });

// Draw a plot. Columns grow in place while a rover drives; Plotly draws them again only for a new `datarevision`.
let revision = 0;
function plot(holder, height, traces, layout) {
  holder.style.height = `${height}px`; // so that nothing below jumps while Plotly draws
  Plotly.react(holder, traces, {
    datarevision: (revision += 1), font: FONT, height, plot_bgcolor: "rgba(0,0,0,0)", paper_bgcolor: "rgba(0,0,0,0)",
    dragmode: false, hovermode: false, showlegend: false, margin: { l: 52, r: 10, t: 8, b: 42 }, ...layout,
  }, { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: false });
}

// A legend of lines and marks beside a plot; Plotly's own would take its room from the plot.
const sample = (drawn, words) => `<li><svg width="32" height="14" aria-hidden="true">${drawn}</svg>${words}</li>`;
function legend(list, lines, marks = []) {
  const items = lines.map(([words, { color, width, dash }]) =>
    sample(`<line x1="1" y1="7" x2="31" y2="7" stroke="${color}" stroke-width="${width}" stroke-dasharray="${DASHES[dash] || ""}"/>`, words));
  list.innerHTML = [...items, ...marks.map(([words, drawn]) => sample(drawn, words))].join("");
}

// The parts of a course that do not move: its checkpoints as a trace, goal and obstacles as shapes.
const GOAL = ["goal and tolerance", { color: COLOR.green, width: 2, dash: "dash" }];
function checkpoints({ checkpoints: points }) {
  return {
    x: points.map((p) => p[1]), y: points.map((p) => p[2]), mode: "markers",
    marker: { symbol: "arrow", angle: points.map((p) => 90 - (p[3] * 180) / Math.PI), angleref: "up", size: 13, color: COLOR.ink },
    text: points.map((p) => `checkpoint at ${number(p[0], 1)} s`), hovertemplate: "%{text}<extra></extra>",
  };
}

function ground({ goal: [x, y, radius], obstacles }) {
  const rectangles = obstacles.map((corners) => ({
    type: "path", path: `M${corners.map((corner) => corner.join(",")).join("L")}Z`, fillcolor: "#dfe2e7", line: { color: COLOR.grey, width: 1 }, layer: "below",
  }));
  return radius === undefined ? rectangles : [...rectangles, { type: "circle", x0: x - radius, x1: x + radius, y0: y - radius, y1: y + radius, line: GOAL[1], layer: "below" }];
}

const meters = (x, y) => ({ xaxis: axis("x (m)", { range: x }), yaxis: axis("y (m)", { range: y, scaleanchor: "x" }) });
