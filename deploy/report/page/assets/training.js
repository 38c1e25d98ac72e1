// The page of a training run: curves, drives at milestones, parameters.
const CURVES = [["all agents", { color: "#b9bec6", width: 1.2 }], ["median, with the middle half", { color: COLOR.blue, width: 3 }], ["best agent", { color: COLOR.red, width: 2.5, dash: "dash" }]];
const DRIVES = [["at this milestone", { color: COLOR.blue, width: 3.5 }], ["at the others", CURVES[0][1]], GOAL];

// Returns differ by orders of magnitude, so the axis is that of −return, logarithmic and upside down.
function curves() {
  const { iterations, losses, quartiles, best } = data.curves, [all, median, winner] = CURVES.map(([, line]) => line);
  const curve = (y, line, rest = {}) => ({ x: iterations, y, mode: "lines", line: { ...line, shape: "hv" }, hoverinfo: "skip", ...rest });
  const [low, middle, high] = quartiles, powers = [];
  const [least, most] = range(losses, 0).map(Math.log10);
  for (let power = Math.floor(least); power <= Math.ceil(most); power += 1) powers.push(10 ** power);
  legend($("curves-legend"), CURVES);
  plot($("curves"), narrow() ? 320 : 420, [
    ...losses.map((row) => curve(row, all)), curve(low, { width: 0 }), curve(high, { width: 0 }, { fill: "tonexty", fillcolor: "rgba(0,114,178,0.15)" }),
    curve(middle, median), curve(losses[best], winner),
  ], {
    margin: { l: 62, r: 12, t: 8, b: 44 }, xaxis: axis("iteration"),
    yaxis: axis("best return so far", { type: "log", autorange: "reversed", tickvals: powers, ticktext: powers.map((power) => `−${power}`) }),
  });
}

function drives() {
  const { course, milestones, agents } = data, chosen = Number($("milestone").value), ofAgents = $("all-agents").checked;
  const [now, other] = DRIVES.map(([, line]) => line), { iterations, value, parked, x, y } = milestones[chosen];
  const others = ofAgents ? agents : milestones.filter((_, k) => k !== chosen);
  const points = checkpoints(course);
  legend($("drives-legend"), [DRIVES[0], [ofAgents ? "of all agents at the end" : DRIVES[1][0], other], GOAL], ["square: end of the drive"]);
  plot($("drives"), narrow() ? 320 : 420, [
    ...others.map((run) => ({ x: run.x, y: run.y, mode: "lines", line: other })), points,
    { x, y, mode: "lines", line: now }, { x: [x.at(-1)], y: [y.at(-1)], mode: "markers", marker: { symbol: "square", size: 9, color: COLOR.blue } },
    // The course sets the axes: an early policy that drives away would shrink everything else.
  ], { ...meters(range([points.x], 0.45), range([points.y], 0.45)), shapes: ground(course) });
  const words = `${iterations} iterations: return ${number(value, 3)}, ${parked ? "parks" : "does not park"}`;
  $("milestone-words").textContent = words;
  $("milestone").setAttribute("aria-valuetext", words);
}

function histogram(holder, { kind, lower, upper, counts, at_bounds, best, names }) {
  const width = (upper - lower) / counts.length, top = Math.max(...counts), margin = 0.03 * (upper - lower);
  const bound = (x) => ({ type: "line", xref: "x", yref: "paper", x0: x, x1: x, y0: 0, y1: 1, line: { color: COLOR.ink, width: 2 } });
  plot(holder, 190, [
    { type: "bar", x: counts.map((_, k) => lower + (k + 0.5) * width), y: counts, width: 0.9 * width, marker: { color: COLOR.blue, opacity: 0.55 }, hoverinfo: "skip" },
    {
      x: best, y: best.map((_, k) => top * (1.08 + 0.05 * (k % 3))), mode: "markers", marker: { symbol: "diamond", size: 7, color: COLOR.red },
      text: best.map((value, k) => `${names[k]}: ${value}`), hovertemplate: "%{text}<extra></extra>",
    },
  ], {
    margin: { l: 44, r: 10, t: 26, b: 28 }, hovermode: "closest", shapes: [bound(lower), bound(upper)],
    title: { text: `${kind}, ${number(100 * at_bounds)} % at a bound`, font: { size: 13 }, x: 0.02, xanchor: "left", y: 0.97 },
    xaxis: axis("", { range: [lower - margin, upper + margin] }), yaxis: axis("", { range: [0, 1.25 * top] }),
  });
}

$("milestone").addEventListener("input", drives);
$("all-agents").addEventListener("change", drives);
curves();
drives();
[...$("histograms").children].forEach((holder, k) => histogram(holder, data.parameters[k]));
