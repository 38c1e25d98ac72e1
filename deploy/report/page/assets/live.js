// The page while a rover drives: server-sent events bring news; a request stops the rover or releases the stop.
const REDRAW_MS = 500;
let outdated = false, next = 0, asking = false;

for (const control of [$("time"), $("play")]) control.addEventListener("pointerdown", () => ($("follow").checked = false));
for (const action of ["stop", "release"]) $(action).addEventListener("click", () => ask(action));

const source = new EventSource("events");
source.onmessage = (message) => receive(JSON.parse(message.data));
source.onerror = () => {
  $("badge").textContent = "no connection";
  $("badge").className = "bad";
  $("headline").textContent = "The server of this page does not answer; the page keeps trying.";
  $("stop").disabled = true;
};

function receive(news) {
  const changed = take(news), fresh = Boolean(news.ticks?.t?.length), now = performance.now();
  if (news.reset) player.set(0);
  outdated = outdated || changed || fresh;
  if (outdated && now >= next) {
    drawAll();
    outdated = false;
    next = performance.now() + Math.max(REDRAW_MS, 2 * (performance.now() - now)); // a slow machine keeps time for news
  }
  if (fresh && $("follow").checked && !player.playing) player.set(model.drive.ticks.t.at(-1));
  stopControls(news);
}

function stopControls({ bridge, mayStop, gate }) {
  const held = gate?.held === "stopped";
  $("stop").disabled = !mayStop;
  $("release").hidden = !(held && mayStop);
  if (!bridge) $("stopnote").textContent = "No bridge, nothing to stop.";
  else if (!mayStop) $("stopnote").textContent = "You may watch this rover, but you are not authorised to stop it.";
  else if (held) $("stopnote").textContent = `Stopped until released: ${gate.stop_reason}`;
  else if (!asking) $("stopnote").textContent = "";
}

async function ask(action) {
  asking = true;
  $("stopnote").textContent = action === "stop" ? "Stopping…" : "Releasing…";
  try {
    const answer = await (await fetch(action, { method: "POST" })).json();
    $("stopnote").textContent = answer.error || (answer.stopped ? "Stopped until released." : "Released.");
  } catch (error) {
    $("stopnote").textContent = `The request failed: ${error.message}`;
  }
  setTimeout(() => (asking = false), 3000);
}
