// The page: the course from above, the controls, and one drive at a time.
const SVG = "http://www.w3.org/2000/svg", MARGIN_M = 0.45, STEP_M = 0.05, ASIDE_M = 0.2, CALM_S = 1;
const STRONG_MA = 30; // the current that is drawn thickest, unless one is stronger
const SETTINGS = {
  delay: (value) => [value, `${number(value, 2)} s`], gain: (value) => [value / 100, `${value} %`],
  slip: (value) => [value / 100, `${value} %`], noise: (value) => [value / 1000, `${value} mm`],
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const line = (points) => points.map(([x, y]) => `${x.toFixed(3)},${y.toFixed(3)}`).join(" ");
function draw(parent, name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return parent.appendChild(element);
}

// The course from above, in metres.
class Ground {
  constructor(onPush) {
    this.rover = $("rover");
    let last = null;
    const at = ({ clientX, clientY }) => new DOMPoint(clientX, clientY).matrixTransform($("ground").getScreenCTM().inverse());
    this.rover.addEventListener("pointerdown", (event) => {
      this.rover.setPointerCapture(event.pointerId);
      last = at(event);
    });
    this.rover.addEventListener("pointermove", (event) => {
      if (!last) return;
      const now = at(event);
      onPush(now.x - last.x, now.y - last.y);
      last = now;
    });
    for (const end of ["pointerup", "pointercancel"]) this.rover.addEventListener(end, () => (last = null));
    this.rover.addEventListener("keydown", (event) => {
      const way = ARROWS[event.key];
      if (!way) return;
      event.preventDefault();
      onPush(STEP_M * way[0], STEP_M * way[1]);
    });
  }

  show(course) {
    const { ticks, obstacles, target: [x, y, theta], goal, outline } = course;
    const goalOutline = placed(outline, { x, y, theta });
    const points = [...ticks.flatMap((tick) => placed(outline, { x: tick[0], y: tick[1], theta: tick[2] })), ...obstacles.flat(), ...goalOutline];
    const [[left, right], [low, high]] = [0, 1].map((axis) => range([points.map((point) => point[axis])], MARGIN_M / 2));
    $("map").setAttribute("viewBox", `${left} ${-high} ${right - left} ${high - low}`);
    $("still").replaceChildren();
    for (const corners of obstacles) draw($("still"), "polygon", { class: "car", points: line(corners) });
    draw($("still"), "polygon", { class: "goal", points: line(goalOutline) });
    draw($("still"), "circle", { class: "goal", cx: x, cy: y, r: goal[2] });
    draw($("still"), "polyline", { class: "reference", points: line(ticks) });
    const body = this.rover.querySelectorAll("polygon, line");
    body[0].setAttribute("points", line(outline));
    body[1].setAttribute("x2", outline[0][0]);
  }

  update({ pose, poses, dot: [left, up] }) {
    const { x, y, theta } = pose;
    $("now").setAttribute("transform", `translate(${left} ${up})`);
    this.rover.setAttribute("transform", `translate(${x} ${y}) rotate(${(180 * theta) / Math.PI})`);
    $("driven").setAttribute("points", line([...poses, pose].map((each) => [each.x, each.y])));
  }
}

// The potentials over time, a row for each neuron.
class Rows {
  constructor({ neurons }) {
    this.order = ["motor", "command", "inter", "sensory"].flatMap((layer) => neurons.filter((neuron) => neuron.layer === layer))
      .map((neuron) => neurons.indexOf(neuron));
    this.lines = this.order.map((index) => {
      const row = document.createElement("div");
      row.append(Object.assign(document.createElement("span"), { textContent: neurons[index].name }));
      const chart = draw(row, "svg", { viewBox: `0 0 1 ${HIGH_MV - LOW_MV}`, preserveAspectRatio: "none", "aria-hidden": "true" });
      $("rows").append(row);
      return draw(chart, "polyline", {});
    });
  }

  update({ potentials, course }) {
    const end = course.ticks.length - 1;
    this.order.forEach((neuron, row) => {
      this.lines[row].setAttribute("points", line(potentials.map((all, tick) => [tick / end, HIGH_MV - clamp(all[neuron], LOW_MV, HIGH_MV)])));
    });
  }
}

class Demo {
  constructor(core) {
    this.core = core;
    this.settings = {};
    this.silenced = new Set();
    this.strongest = STRONG_MA;
    this.running = false;
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.ground = new Ground((dx, dy) => this.push(dx, dy));
    this.circuit = new Circuit(data.circuit, (neuron) => this.toggle(neuron));
    this.rows = new Rows(data.circuit);
    for (const name of Object.keys(SETTINGS)) {
      const slider = $(name), read = () => {
        const [value, words] = SETTINGS[name](Number(slider.value));
        this.settings[name] = value;
        $(`${name}-value`).textContent = words;
        slider.setAttribute("aria-valuetext", words);
      };
      slider.addEventListener("input", read);
      read();
    }
    $("course").addEventListener("change", () => this.restart());
    $("park").addEventListener("click", () => this.park());
    $("again").addEventListener("click", () => this.restart());
    $("end").addEventListener("click", () => this.finish());
    $("aside").addEventListener("click", () => {
      const { theta } = this.drive.pose;
      this.push(-ASIDE_M * Math.sin(theta), ASIDE_M * Math.cos(theta));
    });
    $("wake").addEventListener("click", () => {
      this.silenced.clear();
      this.applySilence();
    });
    $("defaults").addEventListener("click", () => {
      for (const name of Object.keys(SETTINGS)) {
        $(name).value = $(name).defaultValue;
        $(name).dispatchEvent(new Event("input"));
      }
    });
    this.restart();
  }

  restart() {
    const course = data.courses[$("course").selectedIndex];
    this.running = false;
    this.drive = new Drive(this.core, course, data.rover, this.settings);
    this.ground.show(course);
    this.show();
  }

  // Start, pause or go on; after the end, begin again.
  park() {
    if (this.drive.over) this.restart();
    this.running = !this.running;
    this.last = null;
    if (this.running) requestAnimationFrame((now) => this.frame(now));
    this.show();
  }

  frame(now) {
    if (!this.running) return;
    const passed = this.last === null ? 0 : (now - this.last) / 1000, wait = this.calm.matches ? CALM_S : 0;
    if (passed >= wait) {
      const steps = (Math.min(passed, wait + 0.25) * Number($("speed").value)) / SUBSTEP_S;
      for (let step = 0; step < steps && !this.drive.over; step += 1) this.drive.step();
      this.last = now;
      this.running = !this.drive.over;
      this.show();
    } else this.last ??= now;
    if (this.running) requestAnimationFrame((next) => this.frame(next));
  }

  finish() {
    if (this.drive.over) this.restart();
    while (!this.drive.over) this.drive.step();
    this.running = false;
    this.show();
  }

  push(dx, dy) {
    this.drive.push(dx, dy);
    this.show();
  }

  toggle(neuron) {
    if (!this.silenced.delete(neuron)) this.silenced.add(neuron);
    this.applySilence();
  }

  applySilence() {
    this.core.silence(this.silenced);
    this.show();
  }

  show() {
    const { drive, core, circuit, silenced } = this, currents = core.currents();
    if (drive.over) this.running = false;
    this.ground.update(drive);
    this.rows.update(drive);
    this.strongest = Math.max(this.strongest, ...currents.map(Math.abs));
    circuit.update({ potentials: [...core.potentials].map((mv) => [mv]), currents: currents.map((current) => [current]) }, 0, this.strongest);
    circuit.neurons.forEach((group, neuron) => {
      const off = silenced.has(neuron);
      group.classList.toggle("silenced", off);
      group.setAttribute("aria-pressed", String(off));
      if (off) group.querySelector(".value").textContent = "off";
    });
    const names = [...silenced].map((neuron) => data.circuit.neurons[neuron].name);
    $("silenced").textContent = names.length ? `Silenced: ${names.join(", ")}.` : "Click a neuron to silence it.";
    $("wake").hidden = !names.length;
    $("clock").textContent = `${number(drive.time, 1)} of ${number(drive.course.horizon)} s`;
    this.showState();
  }

  // The words of screen readers change only with the state.
  showState() {
    const { drive, running } = this, begun = drive.substep > 0;
    let state = ["ready", "", "Press Park. Then push the rover."], button = "Park";
    if (drive.over) {
      const { parked, words } = drive.verdict();
      state = [parked ? "parked" : "not parked", parked ? "good" : "bad", words];
      button = "Park again";
    } else if (running) [state, button] = [["driving", "", "The rover follows the green dot. Push it, or silence a neuron."], "Pause"];
    else if (begun) [state, button] = [["paused", "", ""], "Go on"];
    const [badge, kind, words] = state;
    if ($("badge").textContent !== badge) $("badge").textContent = badge;
    if ($("headline").textContent !== words) $("headline").textContent = words;
    $("badge").className = kind;
    $("park").textContent = button;
    $("aside").disabled = drive.over;
    $("again").disabled = !begun && !drive.poses.length;
  }
}

Core.load(data.core, data.circuit).then(
  (core) => (window.demo = new Demo(core)), // also for a browser's console
  (error) => ($("headline").textContent = `This browser does not run the circuit: ${error.message}`),
);
