// Definition 1: the table of signs, and one pair of neurons at a time.
const PLASMA = [[0, "#0d0887"], [0.25, "#7e03a8"], [0.5, "#cc4778"], [0.75, "#f89540"], [1, "#f0f921"]];
const PAIR_HEIGHT = 300;
const SIGN = { positive: "+", antagonistic: "−", "phase-switching": "±", none: "0" };

function signTable(table, findings, onPair) {
  const { sources, motors, contributions, driving, paper } = findings;
  const columns = motors.filter((motor) => sources.some((source) => paper[`${source} ${motor}`]));
  const head = element("tr", {}, element("th", { scope: "col" }, "from"), ...motors.flatMap((motor) => [
    element("th", { scope: "col" }, `to ${motor}`), ...(columns.includes(motor) ? [element("th", { scope: "col" }, "paper")] : [])]));
  const rows = sources.map((source) => element("tr", {}, element("th", { scope: "row" }, source), ...motors.flatMap((motor) => {
    const key = `${source} ${motor}`, [sign, up, down] = contributions[key], moving = driving[key][0];
    const words = `${source} to ${motor}: ${sign}, P ${up}, Q ${down}; while driving ${moving}`;
    const button = element("button", { type: "button", "aria-label": words, title: words }, element("span", { class: "sign" }, SIGN[sign]), ` ${up}/${down} `, element("small", {}, SIGN[moving]));
    button.addEventListener("click", () => onPair(source, motor));
    const cells = [element("td", { class: sign }, button)];
    if (columns.includes(motor)) cells.push(element("td", { title: paper[key] || "" }, element("span", { class: "sign" }, paper[key] ? SIGN[paper[key]] : "")));
    return cells;
  })));
  table.replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
}

function constantsTable(table, rows) {
  const time = (s) => (s < 0.0995 ? `${Number((1000 * s).toPrecision(2))} ms` : `${Number(s.toPrecision(2))} s`);
  const head = element("tr", {}, ...["neuron", "lowest", "highest"].map((words) => element("th", { scope: "col" }, words)));
  table.replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows.map(([name, low, high]) =>
    element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, time(low)), element("td", {}, time(high))))));
}

class Pair {
  constructor(model) {
    this.model = model;
    this.ends = [$("pair-from"), $("pair-to")];
    const names = model.circuit.neurons.map((neuron) => neuron.name);
    for (const select of this.ends) {
      select.append(...names.map((name) => element("option", {}, name)));
      select.addEventListener("change", () => this.draw());
    }
    const { sources, motors } = model.findings;
    this.ends[0].value = sources.at(-1);
    this.ends[1].value = motors[0];
  }

  choose(source, destination) {
    this.ends[0].value = source;
    this.ends[1].value = destination;
    this.draw();
    $("pair").scrollIntoView({ block: "nearest" });
  }

  draw() {
    const [source, destination] = this.ends.map((select) => select.value);
    const { circuit, drive, findings } = this.model, { ticks } = drive;
    const [a, b] = [source, destination].map((name) => ticks.potentials[circuit.neurons.findIndex((neuron) => neuron.name === name)]);
    const found = findings.contributions[`${source} ${destination}`];
    this.columns = [a, b];
    for (const id of ["pair-phase", "pair-slopes"]) hold($(id), PAIR_HEIGHT);
    const axis = { gridcolor: GRID, zeroline: false, fixedrange: true };
    const plain = { font: PLOT_FONT, plot_bgcolor: "#fff", paper_bgcolor: "rgba(0,0,0,0)", dragmode: false, height: PAIR_HEIGHT, showlegend: false };
    Plotly.react($("pair-phase"), [
      { x: a, y: b, mode: "lines+markers", line: { color: "#c5c9d0", width: 1.5 }, hovertemplate: "%{text} s<extra></extra>", text: ticks.t.map((t) => number(t, 1)),
        marker: { size: 5, color: ticks.t, colorscale: PLASMA, colorbar: { title: { text: "s" }, thickness: 10, outlinewidth: 0 } } },
      { x: [a[0]], y: [b[0]], mode: "markers", marker: { symbol: "circle-open", size: 11, color: COLOR.ink, line: { width: 2 } }, hoverinfo: "skip" },
      { x: [], y: [], mode: "markers", marker: { symbol: "x-thin", size: 15, color: COLOR.focus, line: { width: 3, color: COLOR.focus } }, hoverinfo: "skip" },
    ], { ...plain, margin: { l: 52, r: 10, t: 8, b: 44 }, xaxis: { ...axis, title: { text: `${source} (mV)`, standoff: 6 } }, yaxis: { ...axis, title: { text: `${destination} (mV)`, standoff: 4 } } }, PLOT_CONFIG);
    if (!found) {
      $("pair-words").textContent = "A neuron does not contribute to itself.";
      Plotly.react($("pair-slopes"), [], { ...plain }, PLOT_CONFIG);
      return;
    }
    const [sign, up, down, flat, bins] = found, width = 180 / bins.length;
    $("pair-words").textContent = `${source} to ${destination}: ${sign} (P ${up}, Q ${down}, ${flat} flat).`;
    Plotly.react($("pair-slopes"), [{
      type: "bar", x: bins.map((_, k) => (k + 0.5) * width - 90), y: bins, width: bins.map(() => 0.86 * width),
      marker: { color: bins.map((_, k) => (k < bins.length / 2 ? COLOR.red : COLOR.blue)), pattern: { shape: bins.map((_, k) => (k < bins.length / 2 ? "/" : "")) } }, hovertemplate: "%{y}<extra></extra>",
    }], { ...plain, margin: { l: 44, r: 8, t: 8, b: 44 }, xaxis: { ...axis, tickvals: [-90, -45, 0, 45, 90], ticksuffix: "°", range: [-92, 92], title: { text: "slope", standoff: 6 } }, yaxis: { ...axis, title: { text: "points", standoff: 4 } } }, PLOT_CONFIG);
  }

  update(i) {
    if (i < 0 || !this.columns) return;
    Plotly.restyle($("pair-phase"), { x: [[this.columns[0][i]]], y: [[this.columns[1][i]]] }, [2]);
  }
}
