// The native library's circuit as WebAssembly, with one policy in its memory.
const PAGE = 65536, MIDPOINT_MV = -40, INHIBITORY_MV = -90;
const decoded = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

class Core {
  static async load(data, circuit) {
    const { instance } = await WebAssembly.instantiate(decoded(data.module));
    return new Core(data, circuit, instance.exports);
  }

  constructor(data, circuit, library) {
    this.data = data;
    this.circuit = circuit;
    this.library = library;
    const image = decoded(data.memory), { memory } = library;
    if (library.__heap_base.value > data.address) throw new Error("the module's own data reaches into the policy");
    memory.grow(Math.ceil((data.address + image.length) / PAGE) - memory.buffer.byteLength / PAGE);
    new Uint8Array(memory.buffer).set(image, data.address);
    const array = (name, length) => new Float64Array(memory.buffer, data.arrays[name], length);
    this.potentials = array("circuits.potentials", circuit.neurons.length); // mV
    this.observation = array("observations", data.inputs.length);
    this.command = array("commands", data.outputs);
    this.parameters = array("vectors", data.parameters.length);
    this.silence(new Set());
  }

  // Cut all synapses of these neurons and hold them at the lowest potential; wake the others.
  silence(neurons) {
    this.silenced = neurons;
    const { structures, blocks, parameters, silent } = this.data, own = this.parameters;
    own.set(parameters);
    this.circuit.synapses.forEach(({ source, destination }, synapse) => {
      if (neurons.has(source) || neurons.has(destination)) own[blocks.weight + synapse] = 0;
    });
    for (const neuron of neurons) {
      own[blocks.leak_potential + neuron] = silent;
      own[blocks.leak + neuron] = 1;
      own[blocks.capacitance + neuron] = 0; // the leak alone decides, at once
      this.potentials[neuron] = silent;
    }
    this.library.rover_ncp_fill_lanes(structures.circuits, structures.vectors, 0n);
  }

  // Put every neuron at rest.
  reset() {
    this.potentials.fill(this.data.resting);
    for (const neuron of this.silenced) this.potentials[neuron] = this.data.silent;
  }

  // Run a control tick on an observation and return the outputs.
  tick(observation) {
    const { circuits, observations, commands } = this.data.structures;
    this.observation.set(observation);
    this.library.rover_ncp_tick_lanes(circuits, observations, commands);
    return [...this.command];
  }

  // The current of each synapse in mA, for the drawing alone.
  currents() {
    const { blocks } = this.data, v = this.potentials;
    let chemical = 0;
    return this.circuit.synapses.map(({ kind, source, destination }, synapse) => {
      const weight = this.parameters[blocks.weight + synapse];
      if (kind === "gap") return weight * (v[source] - v[destination]);
      const sigma = this.parameters[blocks.sigma + chemical];
      chemical += 1;
      const reversal = kind === "inhibitory" ? INHIBITORY_MV : 0;
      return (weight / (1 + Math.exp(-sigma * (v[source] - MIDPOINT_MV)))) * (reversal - v[destination]);
    });
  }
}
