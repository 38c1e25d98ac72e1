// One pair of neurons: their potentials against each other, and the slopes that Definition 1 counts.
const PLASMA = [[0, "#0d0887"], [0.25, "#7e03a8"], [0.5, "#cc4778"], [0.75, "#f89540"], [1, "#f0f921"]];

class Pair {
  constructor(model) {
    this.model = model;
    this.ends = [$("pair-from"), $("pair-to")];
    for (const select of this.ends) select.addEventListener("change", () => this.draw());
  }

  choose({ from, to }) {
    [this.ends[0].value, this.ends[1].value] = [from, to];
    this.draw();
    $("pair").scrollIntoView({ block: "nearest" });
  }

  draw() {
    const [source, destination] = this.ends.map((select) => select.value), { t, potentials } = this.model.drive.ticks;
    [this.x, this.y] = this.ends.map((select) => potentials[select.selectedIndex]);
    const found = data.contributions.find((one) => one.source === source && one.destination === destination);
    plot($("pair-phase"), 300, [
      {
        x: this.x, y: this.y, mode: "lines+markers", line: { color: COLOR.line, width: 1.5 }, text: t, hovertemplate: "%{text} s<extra></extra>",
        marker: { size: 5, color: t, colorscale: PLASMA, colorbar: { title: { text: "s" }, thickness: 10, outlinewidth: 0 } },
      },
      { x: [this.x[0]], y: [this.y[0]], mode: "markers", marker: { symbol: "circle-open", size: 11, color: COLOR.ink, line: { width: 2 } }, hoverinfo: "skip" },
      { x: [], y: [], mode: "markers", marker: { symbol: "x-thin", size: 15, line: { width: 3, color: COLOR.focus } }, hoverinfo: "skip" },
    ], { hovermode: "closest", xaxis: axis(`${source} (mV)`), yaxis: axis(`${destination} (mV)`) });
    if (!found) {
      $("pair-words").textContent = "A neuron does not contribute to itself.";
      plot($("pair-slopes"), 300, [], {});
      return;
    }
    const { sign, positive, negative, flat, bins } = found, width = 180 / bins.length, falling = bins.map((_, k) => k < bins.length / 2);
    $("pair-words").textContent = `${source} to ${destination}: ${sign} (P ${positive}, Q ${negative}, ${flat} flat).`;
    plot($("pair-slopes"), 300, [{
      type: "bar", x: bins.map((_, k) => (k + 0.5) * width - 90), y: bins, width: 0.86 * width, hovertemplate: "%{y}<extra></extra>",
      marker: { color: falling.map((down) => (down ? COLOR.red : COLOR.blue)), pattern: { shape: falling.map((down) => (down ? "/" : "")) } },
    }], { hovermode: "closest", xaxis: axis("slope (°)", { tickvals: [-90, -45, 0, 45, 90], range: [-92, 92] }), yaxis: axis("points") });
  }

  update(i) {
    if (i >= 0 && this.x) Plotly.restyle($("pair-phase"), { x: [[this.x[i]]], y: [[this.y[i]]] }, [2]);
  }
}
