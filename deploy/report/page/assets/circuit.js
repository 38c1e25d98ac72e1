// The circuit as a graph: a neuron is a vessel filled up to its potential, a synapse as thick as its current.
const EDGE = {
  excitatory: { color: COLOR.blue, dash: "", words: "excitatory, ends in an arrow" },
  inhibitory: { color: COLOR.red, dash: "", words: "inhibitory, ends in a bar" },
  gap: { color: COLOR.ink, dash: "5 4", words: "gap junction, dashed" },
};

function marker(kind) {
  const shape = {
    excitatory: svg("path", { d: "M-9,-7 L6,0 L-9,7 Z" }),
    inhibitory: svg("path", { d: "M-1,-9 L3,-9 L3,9 L-1,9 Z" }),
    gap: svg("circle", { r: 5 }),
  }[kind];
  shape.setAttribute("fill", EDGE[kind].color);
  return svg("marker", { id: `end-${kind}`, markerUnits: "userSpaceOnUse", orient: "auto", markerWidth: 24, markerHeight: 24, viewBox: "-12 -12 24 24" }, shape);
}

class Circuit {
  constructor(holder, circuit, rings, strongest, onChoose) {
    this.circuit = circuit;
    this.strongest = strongest;
    this.chosen = -1;
    const [width, height, radius] = circuit.size;
    this.radius = radius;
    const drawing = svg("svg", { viewBox: `-14 -6 ${width + 22} ${height + 34}`, role: "group", "aria-label": "Circuit; choose a neuron to see what drives it" });
    const definitions = svg("defs", {}, ...Object.keys(EDGE).map(marker));
    drawing.append(definitions);
    const rows = new Map(circuit.neurons.map((neuron) => [neuron.layer, neuron.y]));
    for (const [layer, y] of rows) drawing.append(svg("text", { class: "layer", transform: `translate(2 ${y}) rotate(-90)` }, layer));
    this.rings = svg("g");
    drawing.append(this.rings);
    this.ring(rings);
    this.edges = circuit.synapses.map((synapse) => this.edge(synapse));
    drawing.append(...this.edges.map((edge) => edge.path));
    this.neurons = circuit.neurons.map((neuron, index) => this.neuron(neuron, index, definitions, onChoose));
    drawing.append(...this.neurons.map((neuron) => neuron.group));
    holder.replaceChildren(drawing);
  }

  // Amber rings from the least to the largest time constant.
  ring(rings) {
    this.rings.replaceChildren(...this.circuit.neurons.filter(({ name }) => rings[name]).map(({ name, x, y }) => {
      const [inner, outer] = rings[name], thick = Math.max(outer - inner, 1.5);
      return svg("circle", { cx: x, cy: y, r: inner + thick / 2, fill: "none", stroke: COLOR.amber, "stroke-opacity": 0.35, "stroke-width": thick },
        svg("title", {}, `range of the time constant of ${name}`));
    }));
  }

  edge({ kind, source, destination, curve }) {
    const [x0, y0, cx, cy, x1, y1] = curve;
    const { color, dash } = EDGE[kind];
    const path = svg("path", { d: `M${x0},${y0} Q${cx},${cy} ${x1},${y1}`, fill: "none", stroke: color, "stroke-dasharray": dash, "marker-end": `url(#end-${kind})` });
    const names = [source, destination].map((end) => this.circuit.neurons[end].name);
    const title = svg("title");
    path.append(title);
    return { path, title, words: `${kind === "gap" ? "gap junction" : kind} ${names[0]} → ${names[1]}` };
  }

  neuron({ name, label, layer, x, y }, index, definitions, onChoose) {
    const r = this.radius;
    const level = svg("rect", { x: x - r, y: y + r, width: 2 * r, height: 0 });
    definitions.append(svg("clipPath", { id: `in-${index}` }, svg("circle", { cx: x, cy: y, r })));
    const value = svg("text", { class: "value", x, y: y + 15 });
    const group = svg("g", { class: "neuron", tabindex: 0, role: "button", "data-neuron": name, "aria-pressed": "false" },
      svg("circle", { cx: x, cy: y, r, fill: "#fff" }),
      svg("g", { "clip-path": `url(#in-${index})` }, level),
      svg("circle", { class: "rim", cx: x, cy: y, r, fill: "none", stroke: COLOR.ink, "stroke-width": 2 }),
      svg("text", { class: "name", x, y: y - 3 }, name), value);
    if (label) group.append(svg("text", { class: "label", x, y: layer === "sensory" ? y - r - 12 : y + r + 30 }, label));
    const choose = () => onChoose(this.chosen === index ? -1 : index);
    group.addEventListener("click", choose);
    group.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      event.stopPropagation();
      choose();
    });
    return { group, level, value, name, y };
  }

  choose(index) {
    this.chosen = index;
    this.neurons.forEach(({ group }, own) => {
      group.classList.toggle("chosen", own === index);
      group.setAttribute("aria-pressed", String(own === index));
    });
  }

  // Show tick i of the columns; before the first tick all values are unknown.
  update(ticks, i) {
    const r = this.radius;
    this.neurons.forEach((neuron, index) => {
      const mv = i < 0 ? LOW_MV : ticks.potentials[index][i];
      const part = share(mv);
      neuron.level.setAttribute("y", neuron.y + r - 2 * r * part);
      neuron.level.setAttribute("height", 2 * r * part);
      neuron.level.setAttribute("fill", viridis(part));
      neuron.value.textContent = i < 0 ? "" : number(mv);
      neuron.group.setAttribute("aria-label", `${neuron.name}, ${i < 0 ? "unknown" : number(mv) + " mV"}`);
    });
    this.edges.forEach((edge, index) => {
      const current = i < 0 ? 0 : ticks.currents[index][i];
      const part = Math.sqrt(Math.abs(current) / this.strongest);
      const { source, destination } = this.circuit.synapses[index];
      const own = this.chosen < 0 || source === this.chosen || destination === this.chosen;
      edge.path.setAttribute("stroke-width", (0.6 + 6.4 * part).toFixed(2));
      edge.path.setAttribute("opacity", own ? (0.25 + 0.75 * Math.min(1, 1.6 * part)).toFixed(2) : "0.06");
      edge.title.textContent = `${edge.words}: ${signed(current, 1)} mA`;
    });
  }

  // The pulls on a neuron at tick i, the strongest first.
  words(ticks, i, index) {
    const neuron = this.circuit.neurons[index];
    const start = `${neuron.name} ${number(ticks.potentials[index][i])} mV`;
    if (neuron.layer === "sensory") return `${start}, set by ${neuron.label}`;
    const pulls = this.circuit.synapses
      .map((synapse, place) => ({ from: this.circuit.neurons[synapse.source].name, to: synapse.destination, pull: ticks.pulls[place][i] }))
      .filter((row) => row.to === index && Math.abs(row.pull) >= 0.5)
      .sort((a, b) => Math.abs(b.pull) - Math.abs(a.pull))
      .map((row) => `${row.from} ${signed(row.pull)} mV`);
    return pulls.length ? `${start}, pulled by ${pulls.join(", ")}` : `${start}, pulled by its own leak only`;
  }
}

function circuitLegend(list) {
  for (const [kind, { color, dash, words }] of Object.entries(EDGE)) {
    const line = svg("line", { x1: 1, y1: 7, x2: 26, y2: 7, stroke: color, "stroke-width": 3, "stroke-dasharray": dash, "marker-end": `url(#end-${kind})` });
    list.append(element("li", {}, svg("svg", { width: 36, height: 14, "aria-hidden": "true" }, line), words));
  }
  list.append(element("li", {}, "thickness: current"), element("li", {}, "filled and coloured up to the potential, −90 to 0 mV"),
    element("li", {}, "amber ring: range of the time constant, logarithmic"));
}
