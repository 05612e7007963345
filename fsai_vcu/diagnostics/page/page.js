"use strict";
// One page for a bus as it is now and for a log at any of its moments. What is shown becomes text, attributes and sizes,
// never markup. Times are seconds: of a log since its first frame, of a bus on the server's clock.
const SILENT_MS = 1500; // without an event the values are old
const RETRY_MS = 4000; // without an event a new connection is tried
const TREND_S = 10;
const BREAK_S = 0.25; // a value so old is not shown
const EVENTS = 30;
const RIGHT = 6, TOP = 4, BOTTOM = 18, ROW = 18;
const by = (id) => document.getElementById(id);
const log = by("data") ? JSON.parse(by("data").textContent) : null;
const number = (value, digits = 1) => (value == null ? "–" : value.toFixed(digits));
const span = (s) => (s < 60 ? `${s.toFixed(s < 10 ? 1 : 0)} s` : `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const trends = new Map(); // by tile: the curve whose last seconds stand beside the number

// ---------------------------------------------------------------- curves, and drawing them

function at(t, x) { // the last place not after x; -1 before the first
  let low = 0, high = t.length;
  while (low < high) { const mid = (low + high) >> 1; if (t[mid] <= x) low = mid + 1; else high = mid; }
  return low - 1;
}

function valueAt(curve, x) {
  const place = curve ? at(curve.t, x) : -1;
  const known = place >= 0 && !Number.isNaN(curve.v[place]) && (place < curve.t.length - 1 || x - curve.t[place] <= BREAK_S);
  return known ? curve.v[place] : null;
}

function unpacked(curve, digits) {
  let sum = 0;
  const t = Float64Array.from(curve.dt, (step) => (sum += step) / 1e4);
  return { ...curve, t, v: Float64Array.from(curve.v, (v) => (v === null ? NaN : v / 10 ** digits)) };
}

function extremes(curves, from, to, low = 0, high = 0) {
  for (const { t, v } of curves) {
    for (let i = Math.max(0, at(t, from)); i < t.length && (i === 0 || t[i - 1] <= to); i++) {
      if (v[i] < low) low = v[i];
      if (v[i] > high) high = v[i];
    }
  }
  return [low, high];
}

function penOn(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  return pen;
}

function stroke(pen, { t, v }, x, y, from, to) {
  let down = false;
  pen.beginPath();
  for (let i = Math.max(0, at(t, from)); i < t.length; i++) {
    if (Number.isNaN(v[i])) { down = false; continue; }
    if (down) pen.lineTo(x(t[i]), y(v[i])); else pen.moveTo(x(t[i]), y(v[i]));
    down = true;
    if (t[i] > to) break;
  }
  pen.stroke();
}

function rule(pen, x1, y1, x2, y2) {
  pen.beginPath(); pen.moveTo(x1, y1); pen.lineTo(x2, y2); pen.stroke();
}

function drawTrends(now) {
  const line = colour("--line"), colours = [colour("--soft"), colour("--given")];
  for (const canvas of document.querySelectorAll("canvas.trend")) {
    const curves = canvas.dataset.of.split("|").map((name) => trends.get(name)).filter(Boolean);
    const width = canvas.clientWidth, height = canvas.clientHeight, pen = penOn(canvas, width, height);
    const [low, high] = extremes(curves, now - TREND_S, now, Number(canvas.dataset.low), Number(canvas.dataset.high));
    const x = (t) => width + ((t - now) / TREND_S) * width;
    const y = (v) => height - 2 - ((v - low) / (high - low)) * (height - 4);
    pen.lineWidth = 1; pen.strokeStyle = line;
    rule(pen, 0, y(0), width, y(0));
    curves.forEach((curve, place) => {
      const last = valueAt(curve, now);
      pen.strokeStyle = colours[curves.length > 1 ? place : 1]; pen.lineWidth = 1.5;
      stroke(pen, curve, x, y, now - TREND_S, now);
      if (last !== null) rule(pen, x(curve.t[at(curve.t, now)]), y(last), width, y(last)); // held until now
    });
  }
}

// ---------------------------------------------------------------- the board

function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

function list(id, rows) { // rows: [text, kind, second line]; whether there are any
  const shown = JSON.stringify(rows), target = by(id);
  if (target.shown === shown) return rows.length > 0;
  target.shown = shown;
  target.replaceChildren(...rows.map(([text, kind, below]) => {
    const item = document.createElement("li");
    item.className = kind || "";
    item.textContent = text;
    if (below) item.append(Object.assign(document.createElement("small"), { textContent: below }));
    return item;
  }));
  return rows.length > 0;
}

function showState(s) {
  const state = s.as_state || (s.as_state_heard ? "car silent" : "no AS state"), { light } = s, tile = by("state-tile");
  say(by("mission"), `mission ${s.mission ?? "unknown"}`);
  say(by("clock"), s.clock);
  say(by("state-name"), state);
  tile.dataset.light = light.colour;
  tile.style.background = light.colour === "unknown" ? "" : light.fill;
  tile.style.color = light.colour === "unknown" ? "" : light.ink;
  by("lamp").classList.toggle("flashes", light.flashes);
  const lit = light.colour === "unknown" ? "lights unknown" : `lights ${light.colour}${light.flashes ? ", flashing" : ""}`;
  const held = s.as_state ? `for ${span(s.as_state_s)} · ` : s.as_state_heard ? `last AS state ${s.as_state_heard} · ` : "";
  say(by("held"), held + lit);
  const onOff = (name, on) => [`${name} ${on == null ? "–" : on ? "on" : "off"}`, on == null ? "" : on ? "good" : "warning"];
  const wrong = s.faults.length;
  list("chips", [
    onOff("ASMS", s.as_switch), onOff("TSMS", s.ts_switch), onOff("Go", s.go),
    s.as_state ? [wrong ? `${wrong} fault${wrong > 1 ? "s" : ""}` : "no faults", wrong ? "fault" : "good"] : ["faults unknown"],
    [`mode ${s.mode}`], [`AI ${s.mission_status ? `${s.mission_status} ${s.direction}` : "silent"}`, s.mission_status ? "" : "fault"],
    ...(s.estop_request ? [["ESTOP_REQUEST", "fault"]] : []),
    ...Object.entries(s.states).map(([name, word]) => [word.includes("_") ? word : `${name} ${word}`]),
  ]);
  say(by("speed").firstElementChild, number(s.speed_mps));
  say(by("kmh"), `${s.speed_mps == null ? "–" : (3.6 * s.speed_mps).toFixed(0)} km/h`);
  showLaps(s);
  showActuators(s.actuators);
  by("why-name").hidden = !list("why", s.why_not_driving.map((one) => [one.text, "", one.remedy]));
  by("faults-name").hidden = !list("faults", [
    ...s.faults.map((one) => [`fault: ${one.names.join(", ")}`, "fault", [one.text, one.remedy].filter(Boolean).join(": ")]),
    ...s.warnings.map((name) => [`warning: ${name}`, "warning"]),
  ]);
  const [middle, most] = s.response_ms;
  say(by("load"), `load ${s.load == null ? "–" : `${(100 * s.load).toFixed(0)} %`} of ${s.bitrate / 1000} kbit/s`);
  by("load-bar").style.width = `${Math.min(100, 100 * (s.load ?? 0))}%`;
  say(by("response"), most == null ? "handshake: no answers" : `handshake ${number(middle)} ms, at most ${number(most)}`);
  by("response").className = most == null ? "warning" : "";
  list("bus", [
    ...s.link.map((text) => [text, "fault"]),
    ...(s.nodes || []),
    ...s.missing.map((text) => [text, "warning"]),
    [`${s.received} messages received`],
  ]);
  say(by("bus-name"), s.nodes ? "bus and nodes" : "bus");
}

function showLaps(s) {
  const times = s.lap_times_s, best = Math.min(...times.slice(1)), drives = s.laps && s.mission_status !== "FINISHED";
  say(by("lap").firstElementChild, s.lap == null ? "–" : `${drives ? Math.min(s.lap + 1, s.laps) : s.lap}`);
  say(by("lap").lastElementChild, drives ? `of ${s.laps}` : "driven");
  const rows = times.map((time, place) => [`${place + 1}: ${time.toFixed(1)} s${place ? "" : " from rest"}`, time === best ? "good" : ""]);
  list("laps", rows.slice(-3).reverse());
  say(by("cones"), `${s.cones ?? "–"} cones seen`);
}

function showActuators(actuators) {
  const table = by("actuators");
  for (const [name, one] of Object.entries(actuators)) {
    const both = name === "steering", full = both ? 35 : one.unit === "%" ? 100 : 200;
    let row = table.querySelector(`tr[data-name="${CSS.escape(name)}"]`);
    if (!row) {
      row = by("row").content.firstElementChild.cloneNode(true);
      row.dataset.name = row.cells[0].textContent = name;
      Object.assign(row.querySelector("canvas").dataset, { of: `${name} asked|${name} given`, low: both ? -5 : 0, high: both ? 5 : full / 10 });
      table.append(row);
    }
    const place = (value) => Math.max(0, Math.min(100, both ? 50 - (50 * value) / full : (100 * value) / full)); // left is positive
    const [given, ...limits] = row.cells[1].firstElementChild.children, asked = limits.pop();
    const zero = both ? 50 : 0, end = place(one.given ?? 0);
    given.style.left = `${Math.min(zero, end)}%`;
    given.style.width = `${Math.abs(end - zero)}%`;
    asked.hidden = one.asked == null;
    asked.style.left = `${place(one.asked ?? 0)}%`;
    limits.forEach((limit, side) => { // beyond it the car follows no more
      const edge = place((side ? -1 : 1) * (one.limit ?? 0)), first = both ? side === 0 : false;
      limit.hidden = one.limit == null || (side === 1 && !both);
      limit.className = first ? "below" : "beyond";
      limit.style.left = first ? "0" : `${edge}%`;
      limit.style.width = first ? `${edge}%` : `${100 - edge}%`;
    });
    say(row.cells[2], number(one.asked));
    say(row.cells[3], `${number(one.given)} ${one.unit}`);
  }
}

function showEvents(events) {
  list("events", events.map((one) => [`${one.at}  ${one.text}`, one.kind]));
}

function drawTrack({ whole = [], before = [], way, seen = [], path = [], bornOut, stop, pose, words }) { // points: [x, y, colour], m
  const up = (points) => points.map(([x, y, kind]) => [x, -y, kind]); // SVG's y axis points down
  const cones = { before: up(before), seen: up(seen) }, [x, y, heading] = pose;
  const driven = up([...way, pose]), planned = up(path), all = [...up(whole), ...driven, ...planned, ...cones.before, ...cones.seen];
  const xs = all.map((point) => point[0]), ys = all.map((point) => point[1]);
  const left = Math.min(...xs), top = Math.min(...ys), width = Math.max(...xs) - left, height = Math.max(...ys) - top;
  const size = Math.max(width, height, 20), [dx, dy] = [width, height].map((side) => Math.max(size / 15, (20 - side) / 2));
  const line = (name, points) => by(name).setAttribute("points", points.map((point) => `${point[0]},${point[1]}`).join(" "));
  by("track").setAttribute("viewBox", `${left - dx} ${top - dy} ${width + 2 * dx} ${height + 2 * dy}`);
  line("whole", up(whole));
  line("way", driven);
  line("path", planned.slice(0, bornOut));
  line("doubted", planned.slice(Math.max(0, bornOut - 1)));
  line("stop", stop == null ? [] : [planned[stop], planned[stop]]); // a dot
  for (const dots of by("track").querySelectorAll("path[data-color]")) {
    const own = cones[dots.parentNode.id].filter((cone) => cone[2] === Number(dots.dataset.color));
    dots.setAttribute("d", own.map((cone) => `M${cone[0]} ${cone[1]}h0`).join(""));
  }
  by("car").setAttribute("transform", `translate(${x} ${-y}) rotate(${(-180 * heading) / Math.PI}) scale(${size / 110})`);
  words.forEach((text, place) => say(by(place ? "track-words" : "track-name"), text));
}

// ---------------------------------------------------------------- a bus: what the server sends

let source, triedMs, heardMs = null, quickestMs, silentS = null, channel = "", story = {};

function connect() {
  if (source) source.close();
  triedMs = performance.now();
  source = new EventSource("events");
  source.onopen = () => { quickestMs = Infinity; };
  for (const [name, show] of [["state", hearState], ["story", (told) => { story = told; showEvents(told.events); }]]) {
    source.addEventListener(name, (event) => {
      const data = JSON.parse(event.data), behindMs = performance.now() - 1000 * data.sent_s;
      quickestMs = Math.min(quickestMs, behindMs);
      heardMs = performance.now() - (behindMs - quickestMs); // less what the network held it back
      show(data);
      isOfNow();
    });
  }
}

function isOfNow() {
  const now = performance.now(), age = heardMs === null ? null : now - heardMs;
  const lost = age === null || age > SILENT_MS;
  if (lost && now - triedMs > RETRY_MS) connect();
  let text = "";
  if (age === null) text = now > SILENT_MS ? "no connection to the server yet" : "connecting …";
  else if (lost) text = `no data for ${span(age / 1000)}: values are outdated`;
  else if (silentS === null) text = `nothing is received on ${channel}`;
  else if (silentS > 1) text = `${channel} has been silent for ${span(silentS)}`;
  document.body.classList.toggle("stale", lost);
  by("banner").hidden = !text;
  say(by("banner"), text);
  if (lost) document.title = `no data · ${channel}`;
}

function hearState(s) {
  channel = s.channel;
  silentS = s.silent_s;
  document.title = `${s.as_state || (s.as_state_heard ? "car silent" : "no AS state")} · ${channel}`;
  say(by("channel"), channel);
  const [middle] = s.response_ms;
  remember("speed", s.sent_s, s.speed_mps);
  remember("load", s.sent_s, s.load == null ? null : 100 * s.load);
  remember("handshake", s.sent_s, middle);
  for (const [name, one] of Object.entries(s.actuators)) for (const which of ["asked", "given"]) remember(`${name} ${which}`, s.sent_s, one[which]);
  showState(s);
  drawTrends(s.sent_s);
  const of = story.run === s.run ? story : {}, drawn = "seen_cm" in s; // do the nodes tell more?
  document.body.classList.toggle("nodes", drawn);
  drawTrack({
    before: points(drawn ? of.cones_cm : [], 3), way: points(of.way_cm), seen: points(s.seen_cm, 3), path: points(s.path_cm),
    bornOut: s.borne_out, stop: s.stop, pose: s.pose,
    words: drawn ? ["track", "pale: seen before, green: path, grey: driven"] : ["driven path", "by the wheels, last 500 m"],
  });
}

function remember(name, t, value) {
  let curve = trends.get(name);
  if (!curve || curve.t[curve.t.length - 1] > t) trends.set(name, curve = { t: [], v: [] }); // another server
  if (1000 * (t - curve.t[curve.t.length - 1]) > 2 * SILENT_MS) { curve.t.push(t); curve.v.push(NaN); }
  curve.t.push(t);
  curve.v.push(value ?? NaN);
  const old = at(curve.t, t - TREND_S);
  if (old > 0) { curve.t.splice(0, old); curve.v.splice(0, old); }
}

function points(numbers = [], width = 2) { // cm to m
  const found = [];
  for (let place = 0; place < numbers.length; place += width) found.push([numbers[place] / 100, numbers[place + 1] / 100, numbers[place + 2]]);
  return found;
}

// ---------------------------------------------------------------- a log: any of its moments, and its plots

function play() {
  const whole = [log.extent[0], Math.max(log.extent[1], log.extent[0] + 0.001)];
  const bands = (log.lanes.find((lane) => lane.name === "AS state") || { spans: [] }).spans.filter((span) => log.lights[span[3]]);
  const moments = log.states.map(([t]) => t), states = [], way = [];
  for (const [, changes] of log.states) states.push({ ...states[states.length - 1], ...changes });
  log.way.t.forEach((_, i) => way.push([log.way.x[i] / 100, log.way.y[i] / 100]));
  const wayTimes = log.way.t.map((t) => t / 1e4);
  const events = [...document.querySelectorAll("#timeline li:not(.note)")].map((item) => {
    const button = item.querySelector("button");
    return { t: Number(button.dataset.t), at: button.textContent, text: item.lastElementChild.firstChild.textContent, kind: item.className };
  });
  const plots = log.plots.map((plot) => ({ ...plot, curves: plot.curves.map((curve) => unpacked(curve, plot.digits)) }));
  for (const { curves } of plots) for (const curve of curves) if (curve.tile) trends.set(curve.tile, curve);
  const bad = log.marks.find((mark) => mark[2]);
  const slider = by("time"), rate = by("rate");
  let now = log.rate ? whole[0] : bad ? bad[0] : log.heard, playing = Boolean(log.rate), cursor = null;
  let view = whole.slice(), dragged = null; // [from, to] while a range is chosen
  let LEFT = 44; // room for labels, the same in all panes so that instants stand below one another
  let due = false, tickMs = 0;

  if (log.rate && ![...rate.options].some((option) => Number(option.value) === log.rate)) rate.add(new Option(`${log.rate}×`, log.rate));
  if (log.rate) rate.value = log.rate;
  [slider.min, slider.max] = whole;

  function showMoment() {
    const place = Math.max(0, at(moments, now + 1e-6)), s = { ...states[place], clock: "" };
    if (s.as_state_s != null) s.as_state_s += Math.max(0, now - moments[place]);
    s.speed_mps = valueAt(trends.get("speed"), now);
    const load = valueAt(trends.get("load"), now);
    s.load = load == null ? null : load / 100;
    s.actuators = Object.fromEntries(Object.entries(s.actuators).map(([name, one]) => [
      name, { ...one, asked: valueAt(trends.get(`${name} asked`), now), given: valueAt(trends.get(`${name} given`), now) },
    ]));
    showState(s);
    drawTrends(now);
    showEvents(events.slice(0, at(events.map((one) => one.t), now + 1e-6) + 1).slice(-EVENTS).reverse());
    drawTrack({ whole: way, way: way.slice(0, at(wayTimes, now) + 1), pose: poseAt(now), words: ["driven path", "by the wheels"] });
    slider.value = now;
    say(by("now"), `${now.toFixed(2)} s`);
    say(by("play"), playing ? "❚❚" : "▶");
  }
  function poseAt(t) {
    const i = at(wayTimes, t), { x, y, heading } = log.way;
    if (i < 0) return [0, 0, 0];
    const j = Math.min(i + 1, wayTimes.length - 1), share = j > i ? (t - wayTimes[i]) / (wayTimes[j] - wayTimes[i]) : 0;
    return [x, y, heading].map((list, k) => (list[i] + share * (list[j] - list[i])) / (k < 2 ? 100 : 1000));
  }
  const nice = (length, count) => {
    const raw = length / count, power = 10 ** Math.floor(Math.log10(raw)), rest = raw / power;
    return power * (rest > 5 ? 10 : rest > 2 ? 5 : rest > 1 ? 2 : 1);
  };

  class Pane { // `paint` draws what stands still, once for each part of the log that is looked at
    constructor(canvas) {
      this.canvas = canvas;
      this.still = document.createElement("canvas");
      this.pointers = new Map();
      canvas.addEventListener("pointerdown", (e) => this.down(e));
      canvas.addEventListener("pointermove", (e) => this.move(e));
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => this.up(e));
      canvas.addEventListener("pointerleave", () => { if (!this.pointers.size) point(null); });
      canvas.addEventListener("dblclick", () => look(...whole));
      canvas.addEventListener("keydown", (e) => this.key(e));
    }
    time(e) { return this.timeAt(e.clientX - this.canvas.getBoundingClientRect().left); }
    timeAt(x) { return view[0] + (x - LEFT) / (this.width - LEFT - RIGHT) * (view[1] - view[0]); }
    x(t) { return LEFT + (t - view[0]) / (view[1] - view[0]) * (this.width - LEFT - RIGHT); }
    down(e) {
      try { this.canvas.setPointerCapture(e.pointerId); } catch { /* a pointer that is gone already */ }
      this.pointers.set(e.pointerId, e.clientX);
      if (this.pointers.size === 2) this.pinch = { xs: [...this.pointers.values()], view: view.slice() };
      else dragged = [this.time(e), this.time(e)];
      point(this.time(e));
    }
    move(e) {
      if (this.pointers.has(e.pointerId)) this.pointers.set(e.pointerId, e.clientX);
      if (this.pinch && this.pointers.size === 2) return this.squeeze();
      if (dragged && this.pointers.size && e.pointerType === "mouse") dragged[1] = this.time(e);
      return point(this.time(e));
    }
    squeeze() { // two fingers hold two instants
      const [a, b] = this.pinch.xs, [p, q] = [...this.pointers.values()];
      const box = this.canvas.getBoundingClientRect(), room = this.width - LEFT - RIGHT;
      const share = (x) => (x - box.left - LEFT) / room, [from, to] = this.pinch.view;
      const ta = from + share(a) * (to - from), tb = from + share(b) * (to - from);
      if (Math.abs(p - q) < 8) return;
      const length = (ta - tb) / (share(p) - share(q)), begin = ta - share(p) * length;
      if (length > 0) look(begin, begin + length);
    }
    up(e) {
      this.pointers.delete(e.pointerId);
      if (this.pinch) dragged = null;
      if (!this.pointers.size) this.pinch = null;
      if (!dragged) return;
      const [from, to] = dragged.slice().sort((p, q) => p - q);
      dragged = null;
      if (this.x(to) - this.x(from) > 6) look(from, to);
      else if (e.type === "pointerup") go(this.time(e));
    }
    key(e) {
      const length = view[1] - view[0], step = { ArrowLeft: -length / 50, ArrowRight: length / 50 }[e.key];
      if (step) { cursor = null; go(Math.min(view[1], Math.max(view[0], now + step))); }
      else if (e.key === "+" || e.key === "=") act("in");
      else if (e.key === "-") act("out");
      else if (e.key === "0") act("all");
      else return;
      e.preventDefault();
    }
    draw(scheme) {
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight, shown = [...view, width, height, LEFT, scheme].join();
      this.width = width;
      if (this.shown !== shown) this.paint(penOn(this.still, width, height), width, height);
      this.shown = shown;
      const pen = penOn(this.canvas, width, height);
      pen.drawImage(this.still, 0, 0, width, height);
      this.marks(pen, height);
    }
    times(pen, width, height) {
      const step = nice(view[1] - view[0], Math.max(2, width / 110)), digits = Math.max(0, -Math.floor(Math.log10(step)));
      pen.strokeStyle = colour("--line"); pen.fillStyle = colour("--soft"); pen.textAlign = "center"; pen.textBaseline = "top";
      for (let t = Math.ceil(view[0] / step) * step; t <= view[1]; t += step) {
        const x = this.x(t);
        rule(pen, x, TOP, x, height - BOTTOM);
        if (x < width - 16) pen.fillText(`${t.toFixed(digits)} s`, Math.max(x, LEFT), height - BOTTOM + 4);
      }
    }
    marks(pen, height) {
      const line = (t, name) => {
        pen.strokeStyle = colour(name);
        if (t >= view[0] && t <= view[1]) rule(pen, this.x(t), TOP, this.x(t), height - BOTTOM);
      };
      pen.setLineDash([4, 3]);
      for (const [t, , isBad] of log.marks) line(t, isBad ? "--fault" : "--warning");
      pen.setLineDash([]);
      if (dragged) {
        const [a, b] = dragged.map((t) => this.x(t));
        pen.fillStyle = colour("--zoom"); pen.fillRect(Math.min(a, b), TOP, Math.abs(b - a), height - TOP - BOTTOM);
      }
      if (cursor !== null) line(cursor, "--soft");
      pen.lineWidth = 2; line(now, "--fg"); pen.lineWidth = 1;
    }
  }

  class Lines extends Pane {
    constructor(plot) {
      super(by(`plot-${plot.slug}`));
      this.digits = plot.digits;
      const values = document.querySelectorAll(`#legend-${plot.slug} b`);
      this.curves = plot.curves.filter((curve) => curve.drawn).map((curve, place) => ({ ...curve, colour: `--c${place}`, value: values[place] }));
    }
    paint(pen, width, height) {
      let [low, high] = extremes(this.curves, ...view);
      [low, high] = low === high ? [low - 1, high + 1] : [low - (low < 0 ? 0.06 * (high - low) : 0), high + 0.06 * (high - low)];
      const x = (t) => this.x(t), y = (v) => height - BOTTOM - (v - low) / (high - low) * (height - TOP - BOTTOM);
      pen.save(); pen.beginPath(); pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1); pen.clip();
      pen.globalAlpha = log.band;
      for (const [from, to, , state] of bands) { pen.fillStyle = log.lights[state][0]; pen.fillRect(x(from), TOP, x(to) - x(from), height - TOP - BOTTOM); }
      pen.restore();
      this.times(pen, width, height);
      const step = nice(high - low, height / 36);
      pen.textAlign = "right"; pen.textBaseline = "middle"; pen.strokeStyle = colour("--line"); pen.fillStyle = colour("--soft");
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
        rule(pen, LEFT, y(v), width - RIGHT, y(v));
        pen.fillText(String(+v.toFixed(6)), LEFT - 5, y(v));
      }
      pen.save(); pen.beginPath(); pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1); pen.clip();
      for (const curve of [...this.curves].reverse()) { // the first on top
        pen.strokeStyle = colour(curve.colour); pen.lineWidth = curve.quiet ? 1 : 1.6; pen.setLineDash(curve.quiet ? [5, 3] : []);
        stroke(pen, curve, x, y, ...view);
      }
      pen.restore();
    }
    marks(pen, height) {
      super.marks(pen, height);
      for (const curve of this.curves) {
        const value = valueAt(curve, cursor ?? now);
        say(curve.value, value === null ? "" : value.toFixed(this.digits));
      }
    }
  }

  class Lanes extends Pane {
    constructor() {
      super(by("lanes"));
      this.canvas.style.height = `${log.lanes.length * ROW + TOP + BOTTOM}px`;
    }
    short(pen, name) {
      let text = name;
      while (text.length > 2 && pen.measureText(text).width > LEFT - 7) text = `${text.replace("…", "").slice(0, -1)}…`;
      return text;
    }
    paint(pen, width, height) {
      this.times(pen, width, height);
      log.lanes.forEach((lane, row) => {
        const top = TOP + row * ROW;
        pen.textAlign = "left"; pen.textBaseline = "middle";
        for (const [from, to, text, kind] of lane.spans) {
          if (to < view[0] || from > view[1]) continue;
          const a = Math.max(LEFT, this.x(from)), b = Math.min(width - RIGHT, Math.max(this.x(to), this.x(from) + 2));
          const [fill, ink] = log.lights[kind] || [colour(`--${kind}`), colour("--lane")], words = lane.name === text ? text : `${lane.name}: ${text}`;
          pen.fillStyle = fill; pen.fillRect(a, top + 1, Math.max(b - a, 2), ROW - 2);
          pen.fillStyle = ink;
          const fits = (LEFT > 100 ? [text] : [words, text]).find((w) => pen.measureText(w).width < b - a - 6);
          if (fits) pen.fillText(fits, a + 4, top + ROW / 2 + 0.5);
        }
        pen.fillStyle = colour("--soft"); pen.textAlign = "right";
        pen.fillText(this.short(pen, lane.name), LEFT - 5, top + ROW / 2 + 0.5);
      });
    }
    marks(pen, height) {
      super.marks(pen, height);
      const t = cursor ?? now, words = log.lanes.flatMap(({ name, spans }) => spans
        .filter(([from, to], i) => t >= from && (t < to || (i === spans.length - 1 && t < to + BREAK_S)))
        .map(([, , text]) => (name === text ? text : `${name} ${text}`)));
      say(by("legend-lanes"), words.join(", "));
    }
  }

  const panes = [new Lanes(), ...plots.map((plot) => new Lines(plot))];
  function draw() {
    if (due) return;
    due = true;
    requestAnimationFrame(() => {
      due = false;
      LEFT = document.body.clientWidth < 640 ? 60 : 118;
      const scheme = colour("--bg");
      for (const pane of panes) pane.draw(scheme);
      showMoment();
      say(by("range"), `${view[0].toFixed(2)} to ${view[1].toFixed(2)} s`);
    });
  }
  function point(t) { cursor = t; draw(); }
  function go(t) {
    now = Math.min(whole[1], Math.max(whole[0], t));
    const length = view[1] - view[0];
    if (now < view[0] || now > view[1]) look(now - length / 10, now + 0.9 * length);
    draw();
  }
  function look(from, to) {
    const length = Math.min(Math.max(to - from, 0.02), whole[1] - whole[0]);
    const begin = Math.min(Math.max(from, whole[0]), whole[1] - length);
    view = [begin, begin + length];
    draw();
  }
  function act(what) {
    const [from, to] = view, length = to - from, middle = now > from && now < to ? now : (from + to) / 2;
    if (what === "all") look(...whole);
    else if (what === "in") look(middle - length / 4, middle + length / 4);
    else if (what === "out") look(middle - length, middle + length);
    else if (what === "play") start(!playing);
    else look(from + (what === "on" ? length / 2 : -length / 2), to + (what === "on" ? length / 2 : -length / 2));
  }
  function start(plays) {
    playing = plays;
    if (playing && now >= whole[1]) go(whole[0]);
    tickMs = performance.now();
    if (playing) setTimeout(tick, 50);
    draw();
  }
  function tick() {
    if (!playing) return;
    const ms = performance.now(), next = now + Number(rate.value) * (ms - tickMs) / 1000;
    tickMs = ms;
    if (next >= whole[1] && !log.loop) playing = false;
    go(next >= whole[1] && log.loop ? whole[0] : next);
    if (playing) setTimeout(tick, 50);
  }
  document.addEventListener("click", (e) => {
    const button = e.target.closest("button");
    if (!button) return;
    if (button.dataset.do) act(button.dataset.do);
    else if (button.dataset.t) {
      const t = Number(button.dataset.t);
      look(t - 1, t + 1); go(t);
      document.querySelector(".tools").scrollIntoView({ block: "start" });
    }
  });
  slider.addEventListener("input", () => { playing = false; cursor = null; go(Number(slider.value)); });
  new ResizeObserver(draw).observe(document.body);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  by("banner").hidden = true;
  start(playing);
}

if (log) play();
else {
  connect();
  setInterval(isOfNow, 250);
}
