// The page of a training run: curves, drives at milestones, agents, parameters.
const model = JSON.parse($("data").textContent);
const MUTED = "#b9bec6";
const PLAIN = { font: PLOT_FONT, plot_bgcolor: "#fff", paper_bgcolor: "rgba(0,0,0,0)", dragmode: false, showlegend: false };
const LEAST_LOSS = 1e-4;
const CURVES = [["all agents", { color: MUTED, width: 1.2 }], ["median, with the middle half", { color: COLOR.blue, width: 3 }], ["best agent", { color: COLOR.red, width: 2.5, dash: "dash" }]];
const DRIVES = [["at this milestone", { color: COLOR.blue, width: 3.5 }], ["at the others", { color: MUTED, width: 1.3 }], ["goal and tolerance", { color: COLOR.green, width: 2, dash: "dash" }]];

const quantile = (sorted, part) => {
  const place = part * (sorted.length - 1), low = Math.floor(place);
  return sorted[low] + (place - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
};

function curves() {
  const { iterations, agents, best } = model.curves;
  const losses = agents.map((row) => row.map((value) => Math.max(-value, LEAST_LOSS)));
  const columns = iterations.map((_, k) => losses.map((row) => row[k]).sort((a, b) => a - b));
  const line = (y, rest) => ({ x: iterations, y, mode: "lines", line: { shape: "hv" }, hoverinfo: "skip", ...rest });
  const band = { line: { width: 0, shape: "hv" } };
  const traces = losses.map((row) => line(row, { line: { ...CURVES[0][1], shape: "hv" } }));
  traces.push(line(columns.map((column) => quantile(column, 0.25)), band));
  traces.push(line(columns.map((column) => quantile(column, 0.75)), { ...band, fill: "tonexty", fillcolor: "rgba(0,114,178,0.15)" }));
  traces.push(line(columns.map((column) => quantile(column, 0.5)), { line: { ...CURVES[1][1], shape: "hv" } }));
  traces.push(line(losses[best], { line: { ...CURVES[2][1], shape: "hv" } }));
  const all = losses.flat(), ticks = [];
  for (let power = Math.floor(Math.log10(Math.min(...all))); power <= Math.ceil(Math.log10(Math.max(...all))); power += 1) ticks.push(10 ** power);
  lineLegend($("curves-legend"), CURVES);
  Plotly.react($("curves"), traces, {
    ...PLAIN, height: hold($("curves"), narrow() ? 320 : 420), margin: { l: 62, r: 12, t: 8, b: 44 }, hovermode: false,
    xaxis: { title: { text: "iteration", standoff: 6 }, gridcolor: GRID, zeroline: false, fixedrange: true },
    yaxis: { type: "log", autorange: "reversed", tickvals: ticks, ticktext: ticks.map((tick) => `−${tick}`), gridcolor: GRID, fixedrange: true, title: { text: "best return so far", standoff: 4 } },
  }, PLOT_CONFIG);
}

function drives() {
  const { course, milestones, agents } = model, chosen = Number($("milestone").value);
  const [gx, gy, radius] = course.goal;
  const others = $("all-agents").checked ? agents : milestones.filter((_, k) => k !== chosen);
  const traces = others.map((run) => ({ x: run.x, y: run.y, mode: "lines", line: DRIVES[1][1], hoverinfo: "skip" }));
  traces.push({
    x: course.checkpoints.map((p) => p[1]), y: course.checkpoints.map((p) => p[2]), mode: "markers", hoverinfo: "skip",
    marker: { symbol: "arrow", angle: course.checkpoints.map((p) => 90 - (p[3] * 180) / Math.PI), angleref: "up", size: 12, color: COLOR.ink },
  });
  const now = milestones[chosen];
  traces.push({ x: now.x, y: now.y, mode: "lines", line: DRIVES[0][1], hoverinfo: "skip" });
  traces.push({ x: [now.x.at(-1)], y: [now.y.at(-1)], mode: "markers", marker: { symbol: "square", size: 9, color: COLOR.blue }, hoverinfo: "skip" });
  const shapes = [{ type: "circle", x0: gx - radius, x1: gx + radius, y0: gy - radius, y1: gy + radius, line: { color: COLOR.green, width: 2, dash: "dash" }, layer: "below" }];
  for (const corners of course.obstacles) {
    const points = [];
    for (let k = 0; k < corners.length; k += 2) points.push(`${corners[k]},${corners[k + 1]}`);
    shapes.push({ type: "path", path: `M${points.join("L")}Z`, fillcolor: "#dfe2e7", line: { color: COLOR.grey, width: 1 }, layer: "below" });
  }
  // The course decides what is shown: an early policy that drives off would shrink everything else.
  const margin = 0.45;
  const [left, right] = extent([course.checkpoints.map((p) => p[1])]), [low, high] = extent([course.checkpoints.map((p) => p[2])]);
  lineLegend($("drives-legend"), [DRIVES[0], [$("all-agents").checked ? "of all agents at the end" : DRIVES[1][0], DRIVES[1][1]], DRIVES[2]], ["square: where it ended"]);
  const axis = { gridcolor: GRID, zeroline: false, fixedrange: true };
  Plotly.react($("drives"), traces, {
    ...PLAIN, datarevision: (revision += 1), height: hold($("drives"), narrow() ? 320 : 420), margin: { l: 46, r: 8, t: 8, b: 40 }, hovermode: false, shapes,
    xaxis: { ...axis, title: { text: "x (m)", standoff: 6 }, range: [left - margin, right + margin] },
    yaxis: { ...axis, title: { text: "y (m)", standoff: 4 }, range: [low - margin, high + margin], scaleanchor: "x" },
  }, PLOT_CONFIG);
  const words = `${now.iterations} iterations: return ${number(now.value, 3)}, ${now.parked ? "parks" : "does not park"}`;
  $("milestone-words").textContent = words;
  $("milestone").setAttribute("aria-valuetext", words);
}

function agentTable() {
  const order = [...model.agents].sort((a, b) => b.value - a.value);
  const head = element("tr", {}, ...["agent", "return", "parks", "from the goal", "last improved at", "why not"].map((words) => element("th", { scope: "col" }, words)));
  $("agents").replaceChildren(element("thead", {}, head), element("tbody", {}, ...order.map((agent) => element("tr", {},
    element("th", { scope: "row" }, String(agent.number).padStart(2, "0")),
    ...[number(agent.value, 4), agent.parked ? "yes" : "no", `${number(1000 * agent.errorM)} mm, ${number(1000 * agent.errorRad)} mrad`, String(agent.last), agent.reason].map((words) => element("td", {}, words))))));
}

function histograms() {
  const bins = 24;
  // All places first: what stands beside a plot decides how wide it is.
  const holders = model.parameters.map(({ kind }) => element("div", { class: "plot", role: "img", "aria-label": `Histogram of ${kind}` }));
  $("histograms").replaceChildren(...holders);
  for (const [place, { kind, lower, upper, values, names, best }] of model.parameters.entries()) {
    const holder = holders[place];
    const all = values.flat(), width = (upper - lower) / bins, counts = new Array(bins).fill(0);
    for (const value of all) counts[clamp(Math.floor((value - lower) / width), 0, bins - 1)] += 1;
    const top = Math.max(...counts);
    const bounds = [lower, upper].map((x) => ({ type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, line: { color: COLOR.ink, width: 2 } }));
    const atBound = all.filter((value) => value <= lower || value >= upper).length;
    Plotly.react(holder, [
      { type: "bar", x: counts.map((_, k) => lower + (k + 0.5) * width), y: counts, width: counts.map(() => 0.9 * width), marker: { color: COLOR.blue, opacity: 0.55 }, hoverinfo: "skip" },
      { x: values[best], y: values[best].map((_, k) => top * (1.08 + 0.05 * (k % 3))), mode: "markers", marker: { symbol: "diamond", size: 7, color: COLOR.red }, text: values[best].map((value, k) => `${names[k]}: ${value}`), hovertemplate: "%{text}<extra></extra>" },
    ], {
      ...PLAIN, height: hold(holder, 190), margin: { l: 44, r: 10, t: 26, b: 28 }, hovermode: "closest", shapes: bounds,
      title: { text: `${kind}, ${Math.round((100 * atBound) / all.length)} % at a bound`, font: { size: 13 }, x: 0.02, xanchor: "left", y: 0.97 },
      xaxis: { range: [lower - 0.03 * (upper - lower), upper + 0.03 * (upper - lower)], gridcolor: GRID, zeroline: false, fixedrange: true },
      yaxis: { gridcolor: GRID, fixedrange: true, range: [0, 1.25 * top] },
    }, PLOT_CONFIG);
  }
}

const [first, ...rest] = model.headline.split(": ");
$("badge").textContent = first;
$("badge").className = model.parked ? "good" : "bad";
$("headline").textContent = rest.join(": ");
$("subline").textContent = model.subline;
$("origin").replaceChildren(...model.origin.flatMap(([what, words]) => [element("dt", {}, what), element("dd", {}, words)]));
$("milestone").max = String(model.milestones.length - 1);
$("milestone").value = $("milestone").max;
$("milestone").addEventListener("input", drives);
$("all-agents").addEventListener("change", drives);
curves();
drives();
agentTable();
histograms();
