// The circuit's drawing over time: neurons fill up to their potentials, synapses are as thick as their currents.
class Circuit {
  constructor(circuit, onChoose) {
    this.circuit = circuit;
    this.chosen = -1;
    this.neurons = [...document.querySelectorAll("#circuit .neuron")];
    this.synapses = [...document.querySelectorAll("#circuit .synapse")];
    this.neurons.forEach((group, index) => {
      const choose = () => onChoose(this.chosen === index ? -1 : index);
      group.addEventListener("click", choose);
      group.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        event.stopPropagation();
        choose();
      });
    });
  }

  choose(index) {
    this.chosen = index;
    this.neurons.forEach((group, own) => {
      group.classList.toggle("chosen", own === index);
      group.setAttribute("aria-pressed", String(own === index));
    });
  }

  // Show tick i of the columns; before the first tick all values are unknown. The strongest current is the thickest.
  update(ticks, i, strongest) {
    const { neurons, synapses, size: [, , radius] } = this.circuit;
    this.neurons.forEach((group, index) => {
      const { name, y } = neurons[index], mv = i < 0 ? LOW_MV : ticks.potentials[index][i], part = share(mv);
      const level = group.querySelector("rect");
      level.setAttribute("y", y + radius - 2 * radius * part);
      level.setAttribute("height", 2 * radius * part);
      level.setAttribute("fill", viridis(part));
      group.querySelector(".value").textContent = i < 0 ? "" : number(mv);
      group.setAttribute("aria-label", `${name}, ${i < 0 ? "unknown" : `${number(mv)} mV`}`);
    });
    this.synapses.forEach((path, index) => {
      const { kind, source, destination } = synapses[index], current = i < 0 ? 0 : ticks.currents[index][i];
      const part = Math.sqrt(Math.abs(current) / strongest);
      const own = this.chosen < 0 || source === this.chosen || destination === this.chosen;
      path.setAttribute("stroke-width", (0.6 + 6.4 * part).toFixed(2));
      path.setAttribute("opacity", own ? (0.25 + 0.75 * Math.min(1, 1.6 * part)).toFixed(2) : "0.06");
      const words = current === null ? "unknown" : `${signed(current, 1)} mA`;
      path.querySelector("title").textContent = `${kind} ${neurons[source].name} → ${neurons[destination].name}: ${words}`;
    });
  }

  // The pulls on the chosen neuron at tick i, the strongest first.
  words(ticks, i) {
    if (i < 0) return "";
    if (this.chosen < 0) return `Choose a neuron to see what drives it${data.course ? ", and to paint the path with it" : ""}.`;
    const { neurons, synapses } = this.circuit, { name, layer, label } = neurons[this.chosen];
    const start = `${name} ${number(ticks.potentials[this.chosen][i])} mV`;
    if (ticks.pulls[0]?.[i] === null) return `${start}; what drives it is unknown.`; // another circuit drove
    if (layer === "sensory") return `${start}, set by ${label}.`;
    const pulls = synapses.map(({ source, destination }, k) => ({ source, destination, mv: ticks.pulls[k][i] }))
      .filter(({ destination, mv }) => destination === this.chosen && Math.abs(mv) >= 0.5)
      .sort((a, b) => Math.abs(b.mv) - Math.abs(a.mv))
      .map(({ source, mv }) => `${neurons[source].name} ${signed(mv)} mV`);
    return pulls.length ? `${start}, pulled by ${pulls.join(", ")}.` : `${start}, pulled by its own leak only.`;
  }
}
