// The path from above and the plots over time. Few parts of them move with the slider.
const ELLIPSE_SIGMAS = 3;
const REFERENCE = ["moving reference", { color: COLOR.green, width: 1.5 }];
const PATH_LINES = {
  [data.simulated ? "path" : "estimate"]: { color: COLOR.blue, width: 3 }, "odometry alone": { color: COLOR.grey, width: 1.5, dash: "dash" },
  true: { color: COLOR.ink, width: 1.5, dash: "dot" }, [`covariance, ${ELLIPSE_SIGMAS} σ`]: { color: COLOR.focus, width: 2 },
  [REFERENCE[0]]: REFERENCE[1], [GOAL[0]]: GOAL[1],
};
const PATH_MARKS = [
  ["rover", `<rect x="5" y="1" width="22" height="12" fill="none" stroke="${COLOR.blue}" stroke-width="2"/><path d="M16 7H27" stroke="${COLOR.blue}" stroke-width="2"/>`],
  ["checkpoint, its heading", `<path d="M10 2L22 7L10 12L13 7Z" fill="${COLOR.ink}"/>`],
  ["the next one due", `<circle cx="16" cy="7" r="5.5" fill="none" stroke="${COLOR.red}" stroke-width="2.5"/>`],
];
const COMMAND_LINES = {
  [data.simulated ? "output" : "command sent"]: { color: COLOR.blue, width: 3 }, "setpoint of the gate": { color: COLOR.amber, width: 1.8, dash: "dash" },
  measured: { color: COLOR.ink, width: 1.2, dash: "dot" },
};

// Points [x, y] of a body's own frame in the frame of its pose; null separates lines.
function placed(points, x, y, theta) {
  const c = Math.cos(theta), s = Math.sin(theta);
  return points.map(([a, b]) => (a === null ? [null, null] : [x + c * a - s * b, y + s * a + c * b]));
}

// Nothing of the page's course is where the rover of another course drives; its outline is known all the same.
const NOWHERE = { reference: [[], []], checkpoints: [], obstacles: [], deadlines: [], goal: [] };

class PathPlot {
  constructor(holder, model) {
    this.holder = holder;
    this.model = model;
    this.painted = -1;
  }

  get course() {
    const { course, elsewhere, drive: { ticks } } = this.model;
    return elsewhere && ticks.t.length ? { ...course, ...NOWHERE } : course;
  }

  draw() {
    const { course, model: { drive: { odometry, ticks, truth } } } = this;
    const lines = Object.entries(PATH_LINES), [estimate, alone, real, doubt] = lines.map(([, line]) => line);
    const empty = [!ticks.t.length, !odometry.t.length, !truth.t.length, !ticks.ellipse];
    const known = course.checkpoints.length;
    legend($("path-legend"), lines.filter((_, k) => !empty[k] && (k < 4 || known)), known ? PATH_MARKS : PATH_MARKS.slice(0, 1));
    const path = ({ x, y, t }, line) => ({ x, y, mode: "lines", line, text: t, hovertemplate: "%{text} s<extra></extra>" });
    const moving = (style) => ({ x: [], y: [], mode: "lines", hoverinfo: "skip", ...style });
    const traces = [
      { x: course.reference[0], y: course.reference[1], mode: "lines", line: REFERENCE[1], hoverinfo: "skip" },
      path(odometry, alone), path(ticks, estimate), path(truth, real), this.paint(ticks), checkpoints(course),
      moving({ mode: "markers", marker: { symbol: "circle-open", size: 22, color: COLOR.red, line: { width: 3 } } }),
      moving({ line: { color: COLOR.blue, width: 2 } }), moving({ line: real }),
      moving({ line: doubt, fill: "toself", fillcolor: "rgba(170,68,153,0.2)" }),
    ];
    const shown = [course.checkpoints.map((p) => p[1]), course.checkpoints.map((p) => p[2])];
    const corners = course.obstacles.flat();
    const [x, y] = ["x", "y"].map((name, k) =>
      range([shown[k], ticks[name], truth[name], odometry[name], corners.map((corner) => corner[k])], 0.38));
    // As high as the path is wide and high, so that a straight one does not get an axis of empty metres.
    const margin = { l: 46, r: 8, t: 8, b: 40, autoexpand: false }, wide = this.holder.clientWidth - margin.l - margin.r;
    const high = clamp((wide * (y[1] - y[0])) / (x[1] - x[0]), 150, narrow() ? 300 : 450);
    const scale = Math.min(wide / (x[1] - x[0]), high / (y[1] - y[0]));
    plot(this.holder, high + margin.t + margin.b, traces, {
      ...meters(x, y), margin, hovermode: "closest", shapes: ground(course), annotations: this.deadlines(scale, x[1]),
    });
  }

  paint(ticks) {
    const mv = this.painted < 0 ? [] : ticks.potentials[this.painted];
    return {
      x: mv.length ? ticks.x : [], y: mv.length ? ticks.y : [], mode: "markers",
      marker: {
        color: mv, colorscale: "Viridis", cmin: LOW_MV, cmax: HIGH_MV, size: mv.map((value) => 4 + 16 * share(value)), line: { width: 0 }, showscale: mv.length > 0,
        colorbar: { title: { text: "mV" }, thickness: 10, len: 0.5, y: 0.72, x: 1, xanchor: "right", outlinewidth: 0 },
      },
      text: mv.map((value, i) => `${number(value)} mV at ${number(ticks.t[i], 1)} s`), hovertemplate: "%{text}<extra></extra>",
    };
  }

  // Deadlines beside the checkpoints, at `scale` pixels per metre; one that would cover an earlier one is left out.
  deadlines(scale, right) {
    const size = 11, labelled = [];
    for (const [x, y, text] of this.course.deadlines) {
      const width = 0.62 * size * text.length, flipped = scale * (right - x) < width + 7;
      const left = scale * x + (flipped ? -7 - width : 7), top = scale * y;
      // Right of a flipped label, that of an earlier place would be taken for a later one.
      const label = { x, y, text, flipped, left, top, end: flipped ? Infinity : left + width + 4 };
      const covers = (other) => left < other.end && other.left < label.end && Math.abs(top - other.top) < 1.3 * size;
      if (!labelled.some(covers)) labelled.push(label);
    }
    return labelled.map(({ x, y, text, flipped }) => ({
      x, y, text, showarrow: false, xanchor: flipped ? "right" : "left", yanchor: "top", xshift: flipped ? -7 : 7, yshift: -3, font: { size },
    }));
  }

  choose(index) {
    this.painted = index;
    this.draw();
  }

  // Move what depends on tick i, and describe it in a line of numbers, also for screen readers.
  update(i, t) {
    const { course, model: { drive: { ticks, truth } } } = this, j = locate(truth.t, t);
    const next = course.checkpoints.find((p) => p[0] >= t - 1e-6);
    // The outline, and a line from its middle to its nose.
    const body = [...course.outline, [null, null], [0, 0], [course.outline[0][0], 0]];
    const [x, y, theta] = [ticks.x[i], ticks.y[i], ticks.theta[i]], [major, minor, direction] = ticks.ellipse?.[i] || [];
    const circle = Array.from({ length: 37 }, (_, k) => (k * Math.PI) / 18);
    const ellipse = circle.map((angle) => [ELLIPSE_SIGMAS * major * Math.cos(angle), ELLIPSE_SIGMAS * minor * Math.sin(angle)]);
    const all = [
      next ? [[next[1], next[2]]] : [], i < 0 ? [] : placed(body, x, y, theta),
      j < 0 ? [] : placed(course.outline, truth.x[j], truth.y[j], truth.theta[j]), i < 0 ? [] : placed(ellipse, x, y, direction),
    ];
    Plotly.restyle(this.holder, { x: all.map((points) => points.map((p) => p[0])), y: all.map((points) => points.map((p) => p[1])) }, [6, 7, 8, 9]);
    if (i < 0) return "No tick yet.";
    const words = [`x ${number(x, 3)} m, y ${number(y, 3)} m, θ ${number((theta * 180) / Math.PI, 1)}°`, ...(major === undefined ? [] : [`± ${number(1000 * major, 1)} mm (one σ)`])];
    if (j >= 0) words.push(`${number(1000 * Math.hypot(x - truth.x[j], y - truth.y[j]))} mm from the true position`);
    if (next) words.push(`${number(100 * Math.hypot(next[1] - x, next[2] - y), 1)} cm from the checkpoint due in ${number(next[0] - t, 1)} s`);
    return `${words.join("; ")}.`;
  }
}

// A plot over time whose cursor is an element of its own, which moves without a new drawing.
class TimePlot {
  constructor(holder, model, onTime) {
    this.holder = holder;
    this.model = model;
    this.margin = { l: 52, r: 10, t: 22, b: 36, autoexpand: false };
    this.cursor = document.createElement("div");
    this.cursor.className = "cursor";
    holder.addEventListener("click", (event) => {
      const box = holder.getBoundingClientRect(), { l, r } = this.margin;
      const part = (event.clientX - box.left - l) / (box.width - l - r);
      if (part >= 0 && part <= 1) onTime(part * model.end);
    });
  }

  // Draw with the phases as numbered bands and the events as lines behind the traces.
  show(height, traces, layout, lines = []) {
    const { phases, end } = this.model;
    const vertical = { xref: "x", yref: "paper", y0: 0, y1: 1 };
    const bands = phases.filter((_, k) => k % 2)
      .map(({ start_s, end_s }) => ({ type: "rect", ...vertical, x0: start_s, x1: end_s, fillcolor: "#eef0f3", line: { width: 0 }, layer: "below" }));
    const events = this.model.events.filter(({ t }) => t >= 0 && t <= end).map(({ t, kind }) => {
      const line = kind === "stop" || kind === "late" ? { color: COLOR.red, width: 2 } : { color: COLOR.green, width: 1.2, dash: "dot" };
      return { type: "line", ...vertical, x0: t, x1: t, line };
    });
    const annotations = phases.map(({ start_s, end_s }, k) => ({
      xref: "x", yref: "paper", x: (start_s + end_s) / 2, y: 1, yanchor: "bottom", text: String(k + 1), showarrow: false, font: { size: 11, color: COLOR.grey },
    }));
    plot(this.holder, height, traces, { margin: this.margin, shapes: [...bands, ...events, ...lines], annotations, xaxis: axis("time (s)", { range: [0, end], anchor: "y" }), ...layout });
    this.holder.append(this.cursor);
  }

  update(t) {
    const { l, r, t: top, b } = this.margin, part = clamp(t / this.model.end, 0, 1);
    Object.assign(this.cursor.style, { left: `calc(${l}px + (100% - ${l + r}px) * ${part})`, top: `${top}px`, bottom: `${b}px` });
  }
}

class Lanes extends TimePlot {
  draw() {
    const { circuit, drive: { ticks } } = this.model;
    const neurons = circuit.neurons.map((neuron, index) => ({ ...neuron, index }));
    const rows = ["motor", "command", "inter", "sensory"].flatMap((layer) => neurons.filter((neuron) => neuron.layer === layer));
    const height = (mv) => 0.92 * share(mv);
    const traces = rows.flatMap(({ index }, lane) => [
      { x: ticks.t, y: ticks.t.map(() => lane), mode: "lines", line: { width: 0 } },
      { x: ticks.t, y: ticks.t.map((_, i) => lane + height(ticks.potentials[index][i])), mode: "lines", line: { width: 1.6, color: COLOR.blue }, fill: "tonexty", fillcolor: "rgba(0,114,178,0.22)" },
    ]);
    const half = rows.map((_, lane) => lane + height(-40));
    this.show(60 + 44 * rows.length, traces, {
      yaxis: { range: [-0.05, rows.length], tickvals: rows.map((_, lane) => lane + 0.45), ticktext: rows.map(({ nameLines }) => nameLines.join("<br>")), fixedrange: true, showgrid: false, zeroline: false },
    }, half.map((y) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line: { color: COLOR.grey, width: 0.5, dash: "dot" }, layer: "below" })));
  }
}

class Commands extends TimePlot {
  draw() {
    const { drive, circuit: { outputs } } = this.model, streams = [drive.commands, drive.setpoints, drive.odometry];
    const styles = Object.values(COMMAND_LINES), count = outputs.length;
    legend($("commands-legend"), Object.entries(COMMAND_LINES).filter((_, k) => streams[k].t.length));
    const axisOf = (row) => (row === count - 1 ? "" : row + 2); // the last one carries the axis of time
    const scale = streams.some((columns) => columns.t.length) ? {} : { range: [-0.2, 0.2] }; // Plotly's own is -1 to 4
    const traces = outputs.flatMap(([name], row) => streams.map((columns, k) => (
      { x: columns.t, y: columns[name], yaxis: `y${axisOf(row)}`, mode: "lines", line: { ...styles[k], shape: columns === drive.odometry ? "linear" : "hv" } })));
    const axes = outputs.map(([, text], row) => [`yaxis${axisOf(row)}`, axis(text, {
      domain: [(count - 1 - row) / count, (count - row - (row ? 0.08 : 0)) / count], zeroline: true, zerolinecolor: COLOR.grey, ...scale })]);
    this.show(60 + 160 * count, traces, Object.fromEntries(axes));
  }
}
