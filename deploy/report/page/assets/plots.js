// The plots over time and the path from above. Plotly draws the static parts; few parts move with the slider.
const PLOT_FONT = { family: "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif", size: 12, color: COLOR.ink };
const PLOT_CONFIG = { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: false };
const GRID = "#e4e6ea";
const ELLIPSE_SIGMAS = 3;
// Columns grow in place while a rover drives; Plotly draws them again only when `datarevision` changes.
let revision = 0;
const narrow = () => window.innerWidth < 560;

const PATH_LINES = [
  ["estimate", { color: COLOR.blue, width: 3 }], ["odometry alone", { color: COLOR.grey, width: 1.5, dash: "dash" }],
  ["true", { color: COLOR.ink, width: 1.5, dash: "dot" }], [`covariance, ${ELLIPSE_SIGMAS} σ`, { color: COLOR.focus, width: 2 }],
  ["goal and tolerance", { color: COLOR.green, width: 2, dash: "dash" }],
];
const COMMAND_LINES = [
  ["asked by the circuit", { color: COLOR.blue, width: 3 }], ["let through by the gate", { color: COLOR.amber, width: 1.8, dash: "dash" }],
  ["measured", { color: COLOR.ink, width: 1.2, dash: "dot" }],
];
const DASHES = { dash: "7 4", dot: "2 3" };

// Hold a plot's room while Plotly draws it anew, so that nothing below it jumps.
function hold(holder, height) {
  holder.style.height = `${height}px`;
  return height;
}

// A legend of lines beside a plot; Plotly's own would take its room from the plot.
function lineLegend(list, lines, others = []) {
  const items = lines.map(([words, { color, width, dash }]) => {
    const line = svg("line", { x1: 1, y1: 7, x2: 31, y2: 7, stroke: color, "stroke-width": width, "stroke-dasharray": DASHES[dash] || "" });
    return element("li", {}, svg("svg", { width: 32, height: 14, "aria-hidden": "true" }, line), words);
  });
  list.replaceChildren(...items, ...others.map((words) => element("li", {}, words)));
}

class PathPlot {
  constructor(holder, model) {
    this.holder = holder;
    this.model = model;
    this.painted = -1;
  }

  draw() {
    const { course, drive } = this.model;
    lineLegend($("path-legend"), PATH_LINES.filter(([words]) => words !== "true" || drive.truth.t.length), ["arrow: checkpoint", "ring: the next one due"]);
    const traces = [
      { ...this.line(drive.odometry), line: PATH_LINES[1][1] },
      { ...this.line(drive.ticks), line: PATH_LINES[0][1] },
      { ...this.line(drive.truth), line: PATH_LINES[2][1] },
      this.paint(),
      {
        x: course.checkpoints.map((p) => p[1]), y: course.checkpoints.map((p) => p[2]), mode: "markers",
        marker: { symbol: "arrow", angle: course.checkpoints.map((p) => 90 - (p[3] * 180) / Math.PI), angleref: "up", size: 13, color: COLOR.ink, standoff: 0 },
        text: course.checkpoints.map((p) => `${number(p[0], 1)} s`), hovertemplate: "checkpoint at %{text}<extra></extra>",
      },
      { x: [], y: [], mode: "markers", marker: { symbol: "circle-open", size: 22, color: COLOR.red, line: { width: 3 } }, hoverinfo: "skip" },
      { x: [], y: [], mode: "lines", line: { color: COLOR.blue, width: 2 }, hoverinfo: "skip" },
      { x: [], y: [], mode: "lines", line: PATH_LINES[2][1], hoverinfo: "skip" },
      { x: [], y: [], mode: "lines", line: PATH_LINES[3][1], fill: "toself", fillcolor: "rgba(170,68,153,0.2)", hoverinfo: "skip" },
    ];
    this.moving = [5, 6, 7, 8];
    const [gx, gy, radius] = course.goal;
    const shapes = [{ type: "circle", x0: gx - radius, x1: gx + radius, y0: gy - radius, y1: gy + radius, line: { color: COLOR.green, width: 2, dash: "dash" }, layer: "below" }];
    for (const corners of course.obstacles) {
      const points = [];
      for (let k = 0; k < corners.length; k += 2) points.push(`${corners[k]},${corners[k + 1]}`);
      shapes.push({ type: "path", path: `M${points.join("L")}Z`, fillcolor: "#dfe2e7", line: { color: COLOR.grey, width: 1 }, layer: "below" });
    }
    const [left, right, low, high] = this.bounds();
    const axis = { gridcolor: GRID, zeroline: false, ticks: "outside", tickcolor: GRID, fixedrange: true };
    const layout = {
      datarevision: (revision += 1), font: PLOT_FONT, height: hold(this.holder, narrow() ? 340 : 500), margin: { l: 46, r: 8, t: 8, b: 40, autoexpand: false }, plot_bgcolor: "#fff", paper_bgcolor: "rgba(0,0,0,0)",
      xaxis: { ...axis, title: { text: "x (m)", standoff: 6 }, range: [left, right] },
      yaxis: { ...axis, title: { text: "y (m)", standoff: 4 }, range: [low, high], scaleanchor: "x", scaleratio: 1 },
      showlegend: false, shapes, dragmode: false, hovermode: "closest",
      annotations: this.deadlines(),
    };
    Plotly.react(this.holder, traces, layout, PLOT_CONFIG);
  }

  line(columns) {
    return { x: columns.x, y: columns.y, mode: "lines", text: columns.t.map((t) => number(t, 1)), hovertemplate: "%{text} s<extra></extra>" };
  }

  paint() {
    const { ticks } = this.model.drive, index = this.painted;
    const shown = index >= 0 ? ticks.potentials[index] : [];
    return {
      name: index >= 0 ? this.model.circuit.neurons[index].name : "", x: index >= 0 ? ticks.x : [], y: index >= 0 ? ticks.y : [], mode: "markers", showlegend: false,
      marker: { color: shown, colorscale: "Viridis", cmin: LOW_MV, cmax: HIGH_MV, size: shown.map((mv) => 4 + 16 * share(mv)), line: { width: 0 }, showscale: index >= 0,
        colorbar: { title: { text: "mV" }, thickness: 10, len: 0.5, y: 0.72, x: 1, xanchor: "right", outlinewidth: 0 } },
      text: shown.map((mv, i) => `${number(mv)} mV at ${number(ticks.t[i], 1)} s`), hovertemplate: "%{text}<extra></extra>",
    };
  }

  bounds() {
    const { course, drive } = this.model, reach = 0.38;
    const known = [drive.ticks, drive.truth, drive.odometry];
    const [left, right] = extent([course.checkpoints.map((p) => p[1]), ...known.map((columns) => columns.x), ...course.obstacles.map((corners) => corners.filter((_, k) => k % 2 === 0))]);
    const [low, high] = extent([course.checkpoints.map((p) => p[2]), ...known.map((columns) => columns.y), ...course.obstacles.map((corners) => corners.filter((_, k) => k % 2 === 1))]);
    return [left - reach, right + reach, low - reach, high + reach];
  }

  // Deadlines beside the checkpoints, where they have room: those that wait in one place first.
  deadlines() {
    const places = new Map();
    for (const [t, x, y] of this.model.course.checkpoints) {
      const key = `${x.toFixed(3)} ${y.toFixed(3)}`;
      if (!places.has(key)) places.set(key, { x, y, times: [] });
      places.get(key).times.push(t);
    }
    const labelled = [];
    for (const place of [...places.values()].sort((a, b) => b.times.length - a.times.length)) {
      if (labelled.every((other) => Math.hypot(place.x - other.x, place.y - other.y) > (narrow() ? 0.16 : 0.07))) labelled.push(place);
    }
    return labelled.map(({ x, y, times }) => ({
      x, y, text: times.length > 1 ? `${number(times[0])} to ${number(times.at(-1))} s` : `${number(times[0])} s`,
      showarrow: false, xanchor: "left", yanchor: "top", xshift: 7, yshift: -3, font: { size: 11 },
    }));
  }

  choose(index) {
    this.painted = index;
    this.draw();
  }

  update(i, t) {
    const { course, drive } = this.model, { ticks, truth } = drive;
    const next = course.checkpoints.find((p) => p[0] >= t - 1e-6);
    const j = locate(truth.t, t);
    // The outline, and a line from its middle to its nose.
    const body = i >= 0 ? [...course.outline, [null, null], [0, 0], [course.outline[0][0], 0]] : [];
    const seen = i >= 0 ? placed(body, ticks.x[i], ticks.y[i], ticks.theta[i]).map((p, k) => (body[k][0] === null ? body[k] : p)) : [];
    const real = j >= 0 ? placed(course.outline, truth.x[j], truth.y[j], truth.theta[j]) : [];
    const doubt = i >= 0 ? ellipsePoints(ticks.x[i], ticks.y[i], ticks.ellipse[i], ELLIPSE_SIGMAS) : [];
    const all = [next ? [[next[1], next[2]]] : [], seen, real, doubt];
    Plotly.restyle(this.holder, { x: all.map((points) => points.map((p) => p[0])), y: all.map((points) => points.map((p) => p[1])) }, this.moving);
  }

  // One line of numbers, for screen readers.
  words(i, t) {
    if (i < 0) return "No tick yet.";
    const { course, drive } = this.model, { ticks, truth } = drive, j = locate(truth.t, t);
    const parts = [`x ${number(ticks.x[i], 3)} m, y ${number(ticks.y[i], 3)} m, θ ${degrees(ticks.theta[i])}`];
    const doubt = 1000 * ticks.ellipse[i][0];
    parts.push(`± ${number(doubt, 1)} mm (one σ)`);
    if (j >= 0) parts.push(`truly ${number(1000 * Math.hypot(ticks.x[i] - truth.x[j], ticks.y[i] - truth.y[j]), 0)} mm from there`);
    const next = course.checkpoints.find((p) => p[0] >= t - 1e-6);
    if (next) parts.push(`${number(100 * Math.hypot(next[1] - ticks.x[i], next[2] - ticks.y[i]), 1)} cm from the checkpoint due in ${number(next[0] - t, 1)} s`);
    return parts.join("; ") + ".";
  }
}

// A plot over time whose cursor is an element of its own: moving it costs nothing.
class TimePlot {
  constructor(holder, model, onTime) {
    this.holder = holder;
    this.model = model;
    this.margin = { l: 52, r: 10, t: 22, b: 36, autoexpand: false };
    holder.addEventListener("click", (event) => {
      const box = holder.getBoundingClientRect(), width = box.width - this.margin.l - this.margin.r;
      const part = (event.clientX - box.left - this.margin.l) / width;
      if (part >= 0 && part <= 1) onTime(part * this.end());
    });
  }

  end() {
    return this.model.end;
  }

  // The phases as bands with their numbers, the events as lines.
  backdrop() {
    const { findings, drive } = this.model, shapes = [], annotations = [];
    (findings.phases || []).forEach((phase, k) => {
      if (k % 2) shapes.push({ type: "rect", xref: "x", yref: "paper", x0: phase.start, x1: phase.end, y0: 0, y1: 1, fillcolor: "#eef0f3", line: { width: 0 }, layer: "below" });
      annotations.push({ xref: "x", yref: "paper", x: (phase.start + phase.end) / 2, y: 1, yanchor: "bottom", text: String(k + 1), showarrow: false, font: { size: 11, color: COLOR.grey } });
    });
    for (const event of drive.events) {
      if (event.t < 0 || event.t > this.end()) continue;
      const bad = event.kind === "stop" || event.kind === "late";
      shapes.push({ type: "line", xref: "x", yref: "paper", x0: event.t, x1: event.t, y0: 0, y1: 1, line: { color: bad ? COLOR.red : COLOR.green, width: bad ? 2 : 1.2, dash: bad ? "solid" : "dot" } });
    }
    return { shapes, annotations };
  }

  show(traces, layout) {
    const time = { range: [0, this.end()], fixedrange: true, gridcolor: GRID, zeroline: false };
    Plotly.react(this.holder, traces, {
      datarevision: (revision += 1), font: PLOT_FONT, margin: this.margin, plot_bgcolor: "rgba(0,0,0,0)", paper_bgcolor: "rgba(0,0,0,0)", dragmode: false, hovermode: false, ...layout,
      xaxis: { ...time, title: { text: "time (s)", standoff: 6 }, ...(layout.xaxis || {}) },
    }, PLOT_CONFIG);
    if (!this.cursor) {
      this.cursor = element("div", { class: "cursor", "aria-hidden": "true" });
      this.holder.append(this.cursor);
    }
  }

  update(t) {
    const part = clamp(t / this.end(), 0, 1);
    this.cursor.style.left = `calc(${this.margin.l}px + (100% - ${this.margin.l + this.margin.r}px) * ${part})`;
    this.cursor.style.top = `${this.margin.t}px`;
    this.cursor.style.bottom = `${this.margin.b}px`;
  }
}

class Lanes extends TimePlot {
  draw() {
    const { circuit, drive } = this.model, { ticks } = drive;
    const rows = ["motor", "command", "inter", "sensory"].flatMap((layer) => circuit.neurons.map((n, i) => [n, i]).filter(([n]) => n.layer === layer));
    const traces = [], middles = [], names = [];
    rows.forEach(([neuron, index], lane) => {
      const high = ticks.t.length ? ticks.potentials[index].map((mv) => lane + 0.92 * share(mv)) : [];
      traces.push({ x: ticks.t, y: ticks.t.map(() => lane), mode: "lines", line: { width: 0 }, showlegend: false });
      traces.push({ x: ticks.t, y: high, mode: "lines", line: { width: 1.6, color: COLOR.blue }, fill: "tonexty", fillcolor: "rgba(0,114,178,0.22)", showlegend: false });
      middles.push(lane + 0.45);
      names.push(neuron.name);
    });
    const { shapes, annotations } = this.backdrop();
    rows.forEach((_, lane) => {
      const half = lane + 0.92 * share(-40);
      shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: half, y1: half, line: { color: "#b9bec6", width: 0.7, dash: "dot" }, layer: "below" });
    });
    this.show(traces, {
      height: hold(this.holder, 60 + 44 * rows.length), shapes, annotations,
      yaxis: { range: [-0.05, rows.length], tickvals: middles, ticktext: names, fixedrange: true, showgrid: false, zeroline: false, ticklen: 0 },
    });
  }
}

class Commands extends TimePlot {
  draw() {
    const { asked, letThrough, odometry } = this.model.drive, traces = [];
    lineLegend($("commands-legend"), COMMAND_LINES);
    const rows = [["v", "y2", "v (m/s)"], ["omega", "y", "ω (rad/s)"]];
    for (const [name, axis] of rows) {
      const own = (columns, line) => ({ x: columns.t, y: columns[name], yaxis: axis, mode: "lines", line });
      traces.push(own(asked, { ...COMMAND_LINES[0][1], shape: "hv" }), own(letThrough, { ...COMMAND_LINES[1][1], shape: "hv" }), own(odometry, COMMAND_LINES[2][1]));
    }
    const { shapes, annotations } = this.backdrop();
    const axis = { fixedrange: true, gridcolor: GRID, zerolinecolor: "#9aa2ad", automargin: false };
    this.show(traces, {
      height: hold(this.holder, 380), shapes, annotations,
      yaxis2: { ...axis, domain: [0.54, 1], title: { text: rows[0][2], standoff: 2 } },
      yaxis: { ...axis, domain: [0, 0.46], title: { text: rows[1][2], standoff: 2 } },
      showlegend: false, xaxis: { anchor: "y" },
    });
  }
}
