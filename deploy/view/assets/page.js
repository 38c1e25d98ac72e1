// The page of a run: takes updates of it, all at once or while a rover drives, and ties all parts to one time.
const PER_UNIT = new Set(["potentials", "currents", "pulls"]); // one column for each neuron or synapse
const STREAMS = ["ticks", "odometry", "truth", "commands", "setpoints"];
const COURSE_END = data.course?.horizon ?? 1;
const model = { circuit: data.circuit, course: data.course, end: COURSE_END, elsewhere: false };
const KEPT_PICTURES = 600; // five minutes of a running drive
let strongest = 1e-9, lastPhase = null, lastPicture = null;

function reset() {
  model.drive = Object.fromEntries(STREAMS.map((name) => [name, { t: [], x: [], y: [], theta: [], v: [], omega: [] }]));
  model.events = [];
  model.phases = [];
  model.pictures = data.pictures ?? [];
  if (!data.updates) $("events").replaceChildren();
}

function append(columns, more) {
  if (!columns.t.length) Object.assign(columns, more);
  else for (const [name, values] of Object.entries(more)) {
    if (PER_UNIT.has(name)) values.forEach((column, k) => columns[name][k].push(...column));
    else columns[name].push(...values);
  }
}

// Take updates; return whether the plots have to be drawn again at once.
function take(updates) {
  if (updates.reset) reset();
  for (const name of STREAMS) if (updates[name]) append(model.drive[name], updates[name]);
  for (const column of updates.ticks?.currents || []) for (const current of column) strongest = Math.max(strongest, Math.abs(current));
  for (const [id, html] of Object.entries(updates.html || {})) $(id).innerHTML = html;
  model.end = Math.max(updates.reset ? COURSE_END : model.end, model.drive.ticks.t.at(-1) ?? 0); // a drive may last longer
  const moved = Boolean(updates.elsewhere) !== model.elsewhere;
  model.elsewhere = Boolean(updates.elsewhere);
  const changed = moved || updates.reset || updates.phases || updates.events.length !== model.events.length;
  model.events = updates.events;
  if (updates.phases) {
    model.phases = updates.phases;
    lastPhase = null;
  }
  return changed;
}

reset();
const pathPlot = data.course && new PathPlot($("path-plot"), model);
const circuit = new Circuit(model.circuit, chooseNeuron);
const player = new Player(model, show);
const lanes = new Lanes($("lanes"), model, (t) => player.set(t));
const commands = new Commands($("commands"), model, (t) => player.set(t));
const pair = data.contributions && new Pair(model);

function chooseNeuron(index) {
  circuit.choose(index);
  if (pathPlot) {
    $("paint").value = String(index);
    pathPlot.choose(index);
  }
  show(player.t);
}

// Update everything that depends on the time.
function show(t) {
  const { ticks } = model.drive, i = locate(ticks.t, t);
  if (pathPlot) $("path-now").textContent = pathPlot.update(i, t);
  circuit.update(ticks, i, strongest);
  $("neuron-now").textContent = circuit.words(ticks, i);
  for (const over of [lanes, commands]) over.update(t);
  pair?.update(i);
  if (model.pictures.length) showPicture(t);
  const { phases } = model;
  const now = phases.findIndex((phase) => t >= phase.start_s - 1e-6 && t < phase.end_s - 1e-6);
  const k = now < 0 ? phases.length - 1 : now;
  $("time").setAttribute("aria-valuetext", `${number(t, 1)} seconds${k < 0 ? "" : `, ${phases[k].label}`}`);
  if (k === lastPhase) return;
  lastPhase = k;
  $("caption").textContent = k < 0 ? "" : `${k + 1}. ${phases[k].sentence}`;
  [...$("phases").children].forEach((item, own) => item.classList.toggle("current", own === k));
}

// Show the picture that was the newest at a time.
function showPicture(t) {
  const k = model.pictures.findLastIndex((picture) => picture.t <= t + 1e-6), picture = model.pictures[Math.max(k, 0)];
  $("tag-now").textContent = `Picture at ${number(picture.t, 1)} s${t - picture.t > 1.5 ? ", and none since" : ""}.`;
  if (picture === lastPicture) return;
  lastPicture = picture;
  $("tag-view").src = `data:image/jpeg;base64,${picture.jpeg}`;
}

function drawAll() {
  for (const part of [pathPlot, lanes, commands]) part?.draw();
  if (pair) {
    if (!pair.x) {
      const last = $("signs").querySelector("tr:last-child button").dataset;
      [pair.ends[0].value, pair.ends[1].value] = [last.from, last.to];
    }
    pair.draw();
  }
  show(player.t);
}

$("paint")?.addEventListener("change", () => chooseNeuron(Number($("paint").value)));
document.addEventListener("click", ({ target }) => {
  const button = target.closest("button");
  if (button?.dataset.t) player.set(Number(button.dataset.t));
  if (button?.dataset.from) pair.choose(button.dataset);
});
window.addEventListener("resize", drawAll);
if (data.updates) {
  take(data.updates);
  model.end = model.drive.ticks.t.at(-1);
}
player.stretch();
drawAll();
player.set(0);
