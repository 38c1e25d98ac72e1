// The page while a rover drives: server-sent events bring new data; a request sends a stop.
const REDRAW_MS = 500;

class Live {
  constructor() {
    this.drawn = 0;
    this.follow = $("follow");
    $("stopbox").hidden = false;
    $("follow-box").hidden = false;
    for (const control of [$("time"), $("play")]) control.addEventListener("pointerdown", () => (this.follow.checked = false));
    $("stop").addEventListener("click", () => this.ask("stop"));
    $("release").addEventListener("click", () => this.ask("release"));
    headline("waiting", null, "for the bridge");
    const source = new EventSource("events");
    source.onmessage = (message) => this.hear(JSON.parse(message.data));
    source.onerror = () => {
      headline("no connection", false, "The server of this page does not answer; it is asked again and again.");
      $("stop").disabled = true;
    };
  }

  hear(news) {
    if (news.reset) this.reset();
    for (const name of ["ticks", "odometry", "asked", "letThrough"]) if (news[name]) this.append(model.drive[name], news[name]);
    if (news.events.length !== model.drive.events.length) {
      model.drive.events = news.events;
      eventList(news.events);
      this.drawn = 0;
    }
    if (news.findings) this.learn(news.findings);
    this.words(news);
    const { t } = model.drive.ticks, now = performance.now(), fresh = Boolean(news.ticks && news.ticks.t && news.ticks.t.length);
    if ((fresh && now - this.drawn > REDRAW_MS) || this.drawn === 0) {
      this.drawn = now;
      circuit.strongest = strongest();
      drawAll();
      show(player.t);
    }
    if (fresh && this.follow.checked && !player.playing) player.set(t.at(-1));
  }

  append(columns, more) {
    for (const [name, values] of Object.entries(more)) {
      if (name === "potentials" || name === "currents" || name === "pulls") values.forEach((column, k) => columns[name][k].push(...column));
      else columns[name].push(...values);
    }
  }

  reset() {
    const { drive } = model;
    for (const name of ["ticks", "odometry", "truth", "asked", "letThrough"]) for (const column of Object.values(drive[name])) {
      if (column.length && Array.isArray(column[0]) && column !== drive[name].ellipse) column.forEach((own) => (own.length = 0));
      else column.length = 0;
    }
    drive.events = [];
    model.findings = {};
    pair = null;
    for (const id of ["contributions", "pair"]) $(id).hidden = true;
    showFindings();
    eventList([]);
    this.drawn = 0;
    player.set(0);
  }

  learn(found) {
    model.findings = found;
    circuit.ring(found.rings);
    showFindings();
    this.drawn = 0;
  }

  words(news) {
    const { status, gate } = news, notes = [];
    const state = !news.bridge ? "no bridge" : status ? status.state : "waiting";
    const good = state === "parked" ? true : state === "fault" || state === "no bridge" ? false : null;
    if (status) notes.push(`policy ${status.policy} on course ${status.course}`);
    if (gate) notes.push(gate.lease ? `${gate.driver_name || "a driver without a name"} holds the lease` : "no driver holds the lease");
    if (gate && gate.held && gate.lease) notes.push(`the gate holds the rover: ${gate.held}`);
    if (news.foreign) notes.push("the driver's neurons are not those of this page's policy: start watch with --policy");
    headline(`${state}: ${[status && status.reason, news.verdict].filter(Boolean).join(", ")}`, good, notes.join("; "));
    definitions($("summary"), this.facts(news));
    const held = Boolean(gate && gate.held === "stopped");
    $("stop").disabled = !news.mayStop;
    $("release").hidden = !(held && news.mayStop);
    if (!news.mayStop) $("stopnote").textContent = news.bridge ? "You may look, but you are not authorised to stop this rover." : "No bridge, nothing to stop.";
    else if (held) $("stopnote").textContent = `Stopped until released: ${gate.stop_reason}`;
    else if (!this.asking) $("stopnote").textContent = "";
  }

  facts({ status, gate, verdict }) {
    const rows = [], { ticks } = model.drive;
    const sum = (counts) => Object.values(counts).reduce((all, count) => all + count, 0);
    const named = (counts) => (sum(counts) ? ` (${Object.entries(counts).map(([name, count]) => `${name} ${count}`).join(", ")})` : "");
    if (verdict) rows.push(["At the end", verdict]);
    if (status) rows.push(["Ticks", `${ticks.t.length}, ${status.overruns} late`]);
    if (gate) for (const name of ["dropped", "limited", "stops"]) rows.push([`Gate, ${name}`, `${sum(gate[name])}${named(gate[name])}`]);
    if (gate) rows.splice(-3, 0, ["Gate, accepted", String(gate.accepted)]);
    return rows;
  }

  async ask(what) {
    this.asking = true;
    $("stopnote").textContent = what === "stop" ? "Stopping…" : "Releasing…";
    try {
      const answer = await fetch(what, { method: "POST" });
      const said = await answer.json();
      $("stopnote").textContent = said.error || (said.stopped ? "Stopped until released." : "Released.");
    } catch (error) {
      $("stopnote").textContent = `The stop failed: ${error.message}`;
    }
    setTimeout(() => (this.asking = false), 3000);
  }
}

if (model.live) new Live();
