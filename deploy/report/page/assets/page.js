// The page: builds all parts from the data and ties them to one time.
const EMPTY = { t: [], x: [], y: [], theta: [], v: [], omega: [], ellipse: [] };
const model = JSON.parse($("data").textContent);
model.findings = model.findings || {};
model.drive = model.drive || {};
for (const name of ["ticks", "odometry", "truth", "asked", "letThrough"]) model.drive[name] = { ...structuredClone(EMPTY), ...model.drive[name] };
if (!model.drive.ticks.potentials) {
  model.drive.ticks.potentials = model.circuit.neurons.map(() => []);
  model.drive.ticks.currents = model.circuit.synapses.map(() => []);
  model.drive.ticks.pulls = model.circuit.synapses.map(() => []);
}
model.drive.events = model.drive.events || [];
model.end = model.drive.ticks.t.length ? model.drive.ticks.t.at(-1) : model.course.horizon;

function headline(words, parked, subline) {
  const badge = $("badge");
  const [first, ...rest] = words.split(": ");
  badge.textContent = first;
  badge.className = parked === true ? "good" : parked === false ? "bad" : "";
  $("headline").textContent = rest.join(": ");
  $("subline").textContent = subline;
}

function definitions(list, rows) {
  list.replaceChildren(...rows.flatMap(([what, words]) => [element("dt", {}, what), element("dd", {}, words)]));
}

function phaseList(phases) {
  $("phases").replaceChildren(...phases.map((phase) => {
    const [head, ...rest] = phase.text.split(": ");
    const jump = element("button", { type: "button" }, head);
    jump.addEventListener("click", () => player.set(phase.start));
    return element("li", {}, jump, rest.join(": "));
  }));
}

function eventList(events) {
  const words = { state: "state", start: "signal", gate: "gate", stop: "STOP", late: "LATE" };
  $("events").replaceChildren(...events.map((event) => {
    const jump = element("button", { type: "button" }, `${number(event.t, 1)} s`);
    jump.addEventListener("click", () => player.set(event.t));
    return element("li", { class: event.kind }, element("span", { class: "kind" }, words[event.kind] || event.kind), " ", jump, ` ${event.text}`);
  }));
}

const strongest = () => Math.max(1e-9, ...model.drive.ticks.currents.map((column) => column.reduce((most, current) => Math.max(most, Math.abs(current)), 0)));
const pathPlot = new PathPlot($("path-plot"), model);
const circuit = new Circuit($("circuit"), model.circuit, model.findings.rings || {}, strongest(), chooseNeuron);
circuitLegend($("circuit-legend"));
const player = new Player(model, show);
const lanes = new Lanes($("lanes"), model, (t) => player.set(t));
const commands = new Commands($("commands"), model, (t) => player.set(t));
let pair = null, lastPhase = null;

function chooseNeuron(index) {
  circuit.choose(index);
  $("paint").value = index < 0 ? "" : String(index);
  pathPlot.choose(index);
  show(player.t);
}

// Everything that depends on the time.
function show(t) {
  const { ticks } = model.drive, i = locate(ticks.t, t);
  pathPlot.update(i, t);
  $("path-now").textContent = pathPlot.words(i, t);
  circuit.update(ticks, i);
  $("neuron-now").textContent = i < 0 ? "" : circuit.chosen < 0 ? "Choose a neuron to see what drives it, and to paint the path with it." : circuit.words(ticks, i, circuit.chosen) + ".";
  lanes.update(t);
  commands.update(t);
  if (pair) pair.update(i);
  const phases = model.findings.phases || [];
  const now = phases.findIndex((phase) => t >= phase.start - 1e-6 && t < phase.end - 1e-6);
  const k = now < 0 && phases.length ? phases.length - 1 : now;
  $("time").setAttribute("aria-valuetext", `${number(t, 1)} seconds${k < 0 ? "" : ", " + phases[k].label}`);
  if (k !== lastPhase) {
    lastPhase = k;
    $("caption").textContent = k < 0 ? "" : `${k + 1}. ${phases[k].text}`;
    [...$("phases").children].forEach((item, own) => item.classList.toggle("current", own === k));
  }
}

function drawAll() {
  pathPlot.draw();
  lanes.draw();
  commands.draw();
}

$("paint").append(...model.circuit.neurons.map((neuron, index) => element("option", { value: String(index) }, neuron.name)));
$("paint").addEventListener("change", () => chooseNeuron($("paint").value === "" ? -1 : Number($("paint").value)));

drawAll();
eventList(model.drive.events);
definitions($("summary"), model.summary || []);
definitions($("origin"), model.origin || []);
$("origin-box").hidden = !(model.origin || []).length;
// Findings about the circuit: all of them at the end of a drive, the phases also during it.
function showFindings() {
  const { findings } = model;
  phaseList(findings.phases || []);
  lastPhase = null;
  if (!findings.contributions) return;
  for (const id of ["contributions", "pair"]) $(id).hidden = false;
  if (!pair) pair = new Pair(model);
  pair.draw();
  signTable($("signs"), findings, (source, destination) => pair.choose(source, destination));
  constantsTable($("taus"), findings.timeConstants);
}

showFindings();
if (!model.live) {
  headline(model.headline, model.parked, model.subline);
  player.set(0);
}
window.addEventListener("resize", () => {
  drawAll();
  show(player.t);
});
