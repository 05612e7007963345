"use strict";
// What the server sends becomes text, attributes and sizes, never markup.
const SILENT_MS = 1500; // without an event the values are old
const RETRY_MS = 4000; // without an event a new connection is tried
const by = (id) => document.getElementById(id);
const number = (value, digits = 1) => (value == null ? "–" : value.toFixed(digits));
const span = (s) => (s < 60 ? `${s.toFixed(s < 10 ? 1 : 0)} s` : `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`);
let source, triedMs, heardMs = null, quickestMs, silentS = null, channel = "", story = {};

function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

function list(id, rows) { // rows: [text, kind, second line]
  const shown = JSON.stringify(rows), target = by(id);
  if (target.shown === shown) return;
  target.shown = shown;
  target.replaceChildren(...rows.map(([text, kind, below]) => {
    const item = document.createElement("li");
    item.className = kind || "";
    item.textContent = text;
    if (below) item.append(Object.assign(document.createElement("small"), { textContent: below }));
    return item;
  }));
}

function connect() {
  if (source) source.close();
  triedMs = performance.now();
  source = new EventSource("events");
  source.onopen = () => { quickestMs = Infinity; };
  for (const [name, show] of [["state", showState], ["story", showStory]]) {
    source.addEventListener(name, (event) => {
      const data = JSON.parse(event.data), behindMs = performance.now() - 1000 * data.sent_s;
      quickestMs = Math.min(quickestMs, behindMs);
      heardMs = performance.now() - (behindMs - quickestMs); // less what the network held it back
      show(data);
      look();
    });
  }
}

function look() { // is what is shown of now?
  const now = performance.now(), age = heardMs === null ? null : now - heardMs;
  const lost = age === null || age > SILENT_MS;
  if (lost && now - triedMs > RETRY_MS) connect();
  let text = "";
  if (age === null) text = now > SILENT_MS ? "no connection to the server yet" : "connecting …";
  else if (lost) text = `connection lost since ${span(age / 1000)}: these values are old`;
  else if (silentS === null) text = `nothing is received on ${channel}`;
  else if (silentS > 1) text = `${channel} has been silent for ${span(silentS)}`;
  document.body.classList.toggle("stale", lost);
  by("banner").hidden = !text;
  say(by("banner"), text);
  if (lost) document.title = `connection lost · ${channel}`;
}

function showState(s) {
  const state = s.as_state || (s.as_state_heard ? "car silent" : "no AS state");
  channel = s.channel;
  silentS = s.silent_s;
  document.title = `${state} · ${channel}`;
  say(by("channel"), channel);
  say(by("mission"), `mission ${s.mission ?? "unknown"}`);
  say(by("clock"), s.clock);
  say(by("state"), state);
  by("state-tile").dataset.light = s.light.colour;
  by("state-tile").classList.toggle("flashes", s.light.flashes);
  const lit = s.light.colour === "unknown" ? "lights unknown" : `lights ${s.light.colour}${s.light.flashes ? ", flashing" : ""}`;
  const held = s.as_state ? `for ${span(s.as_state_s)} · ` : s.as_state_heard ? `last AS state ${s.as_state_heard} · ` : "";
  say(by("held"), held + lit);
  const onOff = (name, on) => [`${name} ${on == null ? "–" : on ? "on" : "off"}`, on == null ? "" : on ? "good" : "warning"];
  list("chips", [
    onOff("ASMS", s.as_switch), onOff("TSMS", s.ts_switch), onOff("Go", s.go),
    [`mode ${s.mode}`], [`AI ${s.mission_status ? `${s.mission_status} ${s.direction}` : "silent"}`, s.mission_status ? "" : "fault"],
    ...(s.estop_request ? [["ESTOP_REQUEST", "fault"]] : []),
    ...Object.entries(s.states).map(([name, word]) => [word.includes("_") ? word : `${name} ${word}`]),
  ]);
  say(by("speed").firstElementChild, number(s.speed_mps));
  say(by("counts"), `lap ${s.lap ?? "–"} · ${s.cones ?? "–"} cones seen · ${s.speed_mps == null ? "–" : (3.6 * s.speed_mps).toFixed(0)} km/h`);
  document.body.classList.toggle("driving", s.driving);
  list("why", s.why_not_driving.map((one) => [one.text, "", one.remedy]));
  showActuators(s.actuators);
  list("faults", [
    ...s.faults.map((one) => [`fault: ${one.names.join(", ")}`, "fault", [one.text, one.remedy].filter(Boolean).join(": ")]),
    ...s.warnings.map((name) => [`warning: ${name}`, "warning"]),
    ...(s.faults.length + s.warnings.length ? [] : [s.as_state ? ["none", "good"] : ["unknown"]]),
  ]);
  const echo = s.handshake?.response_ms;
  list("bus", [
    ...s.link.map((text) => [text, "fault"]),
    [`load ${s.load == null ? "–" : `${(100 * s.load).toFixed(0)} %`} · ${s.received} messages received`],
    [echo?.max_ms == null ? "handshake: no answers" : `handshake answered in ${number(echo.p50_ms)} ms, at most ${number(echo.max_ms)} ms`, echo?.max_ms == null ? "warning" : ""],
    ...(s.nodes || []),
    ...s.missing.map((text) => [text, "warning"]),
  ]);
  showTrack(s);
}

function showActuators(actuators) {
  const table = by("actuators");
  for (const [name, one] of Object.entries(actuators)) {
    let row = table.querySelector(`tr[data-name="${CSS.escape(name)}"]`);
    if (!row) {
      row = by("row").content.firstElementChild.cloneNode(true);
      row.dataset.name = row.cells[0].textContent = name;
      table.append(row);
    }
    const both = name === "steering", full = one.limit || (both ? 25 : one.unit === "%" ? 100 : 200);
    const place = (value) => Math.max(0, Math.min(100, both ? 50 - (50 * value) / full : (100 * value) / full)); // left is positive
    const [given, asked] = row.cells[1].firstElementChild.children, zero = both ? 50 : 0, end = place(one.given ?? 0);
    given.style.left = `${Math.min(zero, end)}%`;
    given.style.width = `${Math.abs(end - zero)}%`;
    asked.hidden = one.asked == null;
    asked.style.left = `${place(one.asked ?? 0)}%`;
    say(row.cells[2], `${number(one.asked)}`);
    say(row.cells[3], `${number(one.given)} ${one.unit}`);
  }
}

function showStory(told) {
  story = told;
  list("events", story.events.map((one) => [`${one.at}  ${one.text}`, one.kind]));
}

function rows(numbers = [], width = 2) { // cm to m; SVG's y axis points down
  const found = [];
  for (let at = 0; at < numbers.length; at += width) found.push([numbers[at] / 100, -numbers[at + 1] / 100, numbers[at + 2]]);
  return found;
}

function showTrack(s) {
  const of = story.run === s.run ? story : {}, drawn = "seen_cm" in s; // do the nodes tell more?
  const [x, y, heading] = s.pose, here = [x, -y], way = [...rows(of.way_cm), here], path = rows(s.path_cm);
  const cones = { before: rows(drawn ? of.cones_cm : [], 3), seen: rows(s.seen_cm, 3) };
  const all = [...way, ...path, ...cones.before, ...cones.seen], svg = by("track");
  const xs = all.map((point) => point[0]), ys = all.map((point) => point[1]);
  const left = Math.min(...xs), top = Math.min(...ys), width = Math.max(...xs) - left, height = Math.max(...ys) - top;
  const size = Math.max(width, height, 20), [dx, dy] = [width, height].map((side) => Math.max(size / 15, (size - side) / 4));
  const line = (name, points) => by(name).setAttribute("points", points.map((point) => `${point[0]},${point[1]}`).join(" "));
  svg.setAttribute("viewBox", `${left - dx} ${top - dy} ${width + 2 * dx} ${height + 2 * dy}`);
  line("way", way);
  line("path", path.slice(0, s.borne_out));
  line("doubted", path.slice(Math.max(0, s.borne_out - 1)));
  line("stop", s.stop == null ? [] : [path[s.stop], path[s.stop]]); // a dot
  for (const dots of svg.querySelectorAll("path[data-color]")) {
    const own = cones[dots.parentNode.id].filter((cone) => cone[2] === Number(dots.dataset.color));
    dots.setAttribute("d", own.map((cone) => `M${cone[0]} ${cone[1]}h0`).join(""));
  }
  by("car").setAttribute("transform", `translate(${here}) rotate(${(-180 * heading) / Math.PI}) scale(${size / 110})`);
  document.body.classList.toggle("nodes", drawn);
  say(by("track-name"), drawn ? "track" : "way driven");
  say(by("track-words"), drawn ? "pale: seen before, green: path, grey: driven" : "by the wheels, last 500 m");
  say(by("bus-name"), s.nodes ? "bus and nodes" : "bus");
}

connect();
setInterval(look, 250);
