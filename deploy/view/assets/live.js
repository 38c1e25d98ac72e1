// The page while a rover drives. One WebSocket brings updates and carries requests to stop: an event stream would
// take one of the six connections that a browser has to a host, and with six pages open no request could leave.
const REDRAW_MS = 500, UPDATES_MS = 100, SILENT_MS = 3000, RECONNECT_MS = 500;
let socket, title, outdated = false, next = 0, pending = null, silence, unanswered;

for (const control of [$("time"), $("play")]) control.addEventListener("pointerdown", () => ($("follow").checked = false));
for (const action of ["stop", "release"]) $(action).addEventListener("click", () => ask(action));
connect();

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.onopen = () => request("updates");
  socket.onclose = () => {
    lost();
    $("stop").disabled = true;
    setTimeout(connect, RECONNECT_MS);
  };
  socket.onmessage = (message) => {
    const received = JSON.parse(message.data);
    if (received.answer) return answered(received.answer);
    clearTimeout(silence);
    receive(received);
    setTimeout(request, UPDATES_MS, "updates");
  };
}

function request(what) {
  if (socket.readyState !== WebSocket.OPEN) return;
  socket.send(what);
  if (what === "updates") silence = setTimeout(lost, SILENT_MS);
}

function lost() {
  title = title ?? $("title").innerHTML;
  $("badge").textContent = "no connection";
  $("badge").className = "bad";
  $("headline").textContent = "The server of this page does not answer; the page keeps trying.";
}

function receive(updates) {
  if (title !== undefined) $("title").innerHTML = title;
  title = undefined;
  const changed = take(updates), fresh = Boolean(updates.ticks?.t?.length), now = performance.now();
  player.stretch();
  if (updates.reset) player.set(0);
  outdated = outdated || changed || fresh;
  if (outdated && now >= next) {
    drawAll();
    outdated = false;
    next = performance.now() + Math.max(REDRAW_MS, 2 * (performance.now() - now)); // a slow machine keeps time for updates
  }
  if (fresh && $("follow").checked && !player.playing) player.set(model.drive.ticks.t.at(-1));
  if (updates.view) showTags(updates.view);
  stopControls(updates);
}

function showTags(jpeg) {
  const { pictures } = model, t = model.drive.ticks.t.at(-1) ?? 0;
  if (pictures.at(-1)?.t === t || pictures.length === KEPT_PICTURES) pictures.splice(pictures.at(-1).t === t ? -1 : 0, 1);
  pictures.push({ t, jpeg });
  $("tags").hidden = false;
  document.querySelector("main").classList.add("seen");
  showPicture(player.t);
}

function stopControls({ bridge, mayStop, gate }) {
  const held = gate?.held === "stopped";
  $("stop").disabled = !mayStop;
  $("release").hidden = !(held && mayStop);
  if (pending) return;
  if (!bridge) note("No bridge, nothing to stop.");
  else if (!mayStop) note("You may watch this rover, but you are not authorised to stop it.");
  else note(held ? `Stopped until released, by ${gate.stop_reason || "an unnamed client"}.` : "");
}

const note = (words) => ($("stopnote").textContent = words);

function ask(action) {
  pending = action;
  request(action);
  note(action === "stop" ? "Stopping…" : "Releasing…");
  clearTimeout(unanswered);
  unanswered = setTimeout(answered, SILENT_MS, { error: `No answer within ${SILENT_MS / 1000} s: the rover may still drive.` });
}

function answered({ error, stopped }) {
  clearTimeout(unanswered);
  note(error || (stopped ? "Stopped until released." : "Released."));
  unanswered = setTimeout(() => (pending = null), 3000);
}
