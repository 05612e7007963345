"use strict";
// Draws the plots of the page from the data inside it. Times are seconds since the log's first frame.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const whole = [data.extent[0], Math.max(data.extent[1], data.extent[0] + 0.001)];
  let view = whole.slice();
  let cursor = null, pinned = null; // pinned: the time that was chosen in the story
  let chosen = null; // [from, to] while a range is being dragged
  let LEFT = 44; // room for labels, the same in all panes so that instants stand below one another
  const RIGHT = 6, TOP = 4, BOTTOM = 18, ROW = 18;

  const unpack = (curve, digits) => {
    const t = new Float64Array(curve.dt.length);
    const v = new Float64Array(curve.v.length);
    const scale = 10 ** digits;
    let sum = 0;
    curve.dt.forEach((step, i) => { sum += step; t[i] = sum / 1e4; v[i] = curve.v[i] === null ? NaN : curve.v[i] / scale; });
    return { name: curve.name, quiet: curve.quiet, t, v };
  };
  const at = (t, x) => { // the last place not after x; -1 before the first
    let low = 0, high = t.length;
    while (low < high) { const mid = (low + high) >> 1; if (t[mid] <= x) low = mid + 1; else high = mid; }
    return low - 1;
  };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const nice = (span, count) => {
    const raw = span / count, power = 10 ** Math.floor(Math.log10(raw)), rest = raw / power;
    return power * (rest > 5 ? 10 : rest > 2 ? 5 : rest > 1 ? 2 : 1);
  };

  class Pane {
    constructor(canvas) {
      this.canvas = canvas;
      this.pointers = new Map();
      canvas.addEventListener("pointerdown", (e) => this.down(e));
      canvas.addEventListener("pointermove", (e) => this.move(e));
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => this.up(e));
      canvas.addEventListener("pointerleave", () => { if (!this.pointers.size) show(pinned); });
      canvas.addEventListener("dblclick", () => look(...whole));
      canvas.addEventListener("keydown", (e) => this.key(e));
    }
    get width() { return this.canvas.clientWidth; }
    time(e) { return this.timeAt(e.clientX - this.canvas.getBoundingClientRect().left); }
    timeAt(x) { return view[0] + (x - LEFT) / (this.width - LEFT - RIGHT) * (view[1] - view[0]); }
    x(t) { return LEFT + (t - view[0]) / (view[1] - view[0]) * (this.width - LEFT - RIGHT); }
    down(e) {
      try { this.canvas.setPointerCapture(e.pointerId); } catch { /* a pointer that is gone already */ }
      this.pointers.set(e.pointerId, e.clientX);
      if (this.pointers.size === 2) this.pinch = { xs: [...this.pointers.values()], view: view.slice() };
      else if (e.pointerType === "mouse") chosen = [this.time(e), this.time(e)];
      show(this.time(e));
    }
    move(e) {
      if (this.pointers.has(e.pointerId)) this.pointers.set(e.pointerId, e.clientX);
      if (this.pinch && this.pointers.size === 2) return this.squeeze();
      if (chosen && this.pointers.size) chosen[1] = this.time(e);
      return show(this.time(e));
    }
    squeeze() { // two fingers hold two instants
      const [a, b] = this.pinch.xs, [p, q] = [...this.pointers.values()];
      const box = this.canvas.getBoundingClientRect(), room = this.width - LEFT - RIGHT;
      const share = (x) => (x - box.left - LEFT) / room, [from, to] = this.pinch.view;
      const ta = from + share(a) * (to - from), tb = from + share(b) * (to - from);
      if (Math.abs(p - q) < 8) return;
      const span = (ta - tb) / (share(p) - share(q));
      const begin = ta - share(p) * span;
      if (span > 0) look(begin, begin + span);
    }
    up(e) {
      this.pointers.delete(e.pointerId);
      if (this.pointers.size < 2) this.pinch = null;
      if (chosen) {
        const [from, to] = chosen.slice().sort((p, q) => p - q);
        chosen = null;
        if (this.x(to) - this.x(from) > 6) look(from, to); else draw();
      }
    }
    key(e) {
      const span = view[1] - view[0], step = { ArrowLeft: -span / 50, ArrowRight: span / 50 }[e.key];
      if (step) show(Math.min(view[1], Math.max(view[0], (cursor ?? (view[0] + view[1]) / 2) + step)));
      else if (e.key === "+" || e.key === "=") act("in");
      else if (e.key === "-") act("out");
      else if (e.key === "0") act("all");
      else return;
      e.preventDefault();
    }
    begin() {
      const ratio = window.devicePixelRatio || 1, width = this.width, height = this.canvas.clientHeight;
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      const pen = this.canvas.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
      pen.lineWidth = 1;
      return [pen, width, height];
    }
    times(pen, width, height) {
      const step = nice(view[1] - view[0], Math.max(2, width / 110));
      pen.strokeStyle = colour("--line"); pen.fillStyle = colour("--soft"); pen.textAlign = "center"; pen.textBaseline = "top";
      const digits = Math.max(0, -Math.floor(Math.log10(step)));
      for (let t = Math.ceil(view[0] / step) * step; t <= view[1]; t += step) {
        const x = this.x(t);
        pen.beginPath(); pen.moveTo(x, TOP); pen.lineTo(x, height - BOTTOM); pen.stroke();
        if (x < width - 16) pen.fillText(`${t.toFixed(digits)} s`, Math.max(x, LEFT), height - BOTTOM + 4);
      }
    }
    marks(pen, height) {
      for (const [t, , bad] of data.marks) if (t >= view[0] && t <= view[1]) {
        pen.strokeStyle = colour(bad ? "--bad" : "--warn"); pen.setLineDash([4, 3]);
        pen.beginPath(); pen.moveTo(this.x(t), TOP); pen.lineTo(this.x(t), height - BOTTOM); pen.stroke(); pen.setLineDash([]);
      }
      if (chosen) {
        const [a, b] = chosen.map((t) => this.x(t)); pen.fillStyle = colour("--zoom"); pen.fillRect(Math.min(a, b), TOP, Math.abs(b - a), height - TOP - BOTTOM);
      }
      if (cursor !== null && cursor >= view[0] && cursor <= view[1]) {
        pen.strokeStyle = colour("--fg"); pen.beginPath(); pen.moveTo(this.x(cursor), TOP); pen.lineTo(this.x(cursor), height - BOTTOM); pen.stroke();
      }
    }
  }

  class Lines extends Pane {
    constructor(canvas, plot) {
      super(canvas);
      this.digits = plot.digits;
      this.curves = plot.curves.map((curve) => unpack(curve, plot.digits));
      this.keys = [...document.querySelectorAll(`#legend-${plot.slug} b`)];
    }
    range() {
      let low = 0, high = 0;
      for (const { t, v } of this.curves) {
        for (let i = Math.max(0, at(t, view[0])); i < t.length && (i === 0 || t[i - 1] <= view[1]); i++) {
          if (v[i] < low) low = v[i];
          if (v[i] > high) high = v[i];
        }
      }
      return low === high ? [low - 1, high + 1] : [low - (low < 0 ? 0.06 * (high - low) : 0), high + 0.06 * (high - low)];
    }
    draw() {
      const [pen, width, height] = this.begin();
      const [low, high] = this.range();
      const y = (v) => height - BOTTOM - (v - low) / (high - low) * (height - TOP - BOTTOM);
      this.times(pen, width, height);
      const step = nice(high - low, height / 36);
      pen.textAlign = "right"; pen.textBaseline = "middle";
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
        pen.strokeStyle = colour("--line"); pen.beginPath(); pen.moveTo(LEFT, y(v)); pen.lineTo(width - RIGHT, y(v)); pen.stroke();
        pen.fillStyle = colour("--soft"); pen.fillText(String(+v.toFixed(6)), LEFT - 5, y(v));
      }
      pen.save(); pen.beginPath(); pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1); pen.clip();
      this.curves.forEach(({ t, v, quiet }, number) => {
        pen.strokeStyle = colour(`--c${number}`); pen.lineWidth = quiet ? 1 : 1.6; pen.setLineDash(quiet ? [5, 3] : []);
        pen.beginPath();
        let down = false;
        for (let i = Math.max(0, at(t, view[0])); i < t.length; i++) {
          if (Number.isNaN(v[i])) { down = false; continue; }
          if (down) pen.lineTo(this.x(t[i]), y(v[i])); else pen.moveTo(this.x(t[i]), y(v[i]));
          down = true;
          if (t[i] > view[1]) break;
        }
        pen.stroke();
      });
      pen.setLineDash([]); pen.lineWidth = 1; pen.restore();
      this.marks(pen, height);
      this.curves.forEach(({ t, v }, number) => {
        const place = cursor === null ? -1 : at(t, cursor);
        const value = place < 0 || Number.isNaN(v[place]) ? "" : v[place].toFixed(this.digits);
        if (this.keys[number].textContent !== value) this.keys[number].textContent = value;
      });
    }
  }

  class Lanes extends Pane {
    constructor(canvas) { super(canvas); canvas.style.height = `${data.lanes.length * ROW + TOP + BOTTOM}px`; this.legend = document.getElementById("legend-lanes"); }
    short(pen, name) {
      let text = name;
      while (text.length > 2 && pen.measureText(text).width > LEFT - 7) text = `${text.replace("…", "").slice(0, -1)}…`;
      return text;
    }
    draw() {
      const [pen, width, height] = this.begin();
      this.times(pen, width, height);
      const names = { off: "--off", plain: "--plain", ready: "--ready", go: "--go", done: "--done", bad: "--alarm" };
      const now = [];
      data.lanes.forEach((lane, row) => {
        const top = TOP + row * ROW;
        for (const [from, to, text, kind] of lane.spans) {
          if (cursor !== null && cursor >= from && cursor < to) now.push(lane.name === text ? text : `${lane.name} ${text}`);
          if (to < view[0] || from > view[1]) continue;
          const a = Math.max(LEFT, this.x(from)), b = Math.min(width - RIGHT, Math.max(this.x(to), this.x(from) + 2));
          pen.fillStyle = colour(names[kind]); pen.fillRect(a, top + 1, Math.max(b - a, 2), ROW - 2);
          const words = lane.name === text ? text : `${lane.name}: ${text}`;
          pen.fillStyle = colour("--lane"); pen.textAlign = "left"; pen.textBaseline = "middle";
          const fits = (LEFT > 100 ? [text] : [words, text]).find((w) => pen.measureText(w).width < b - a - 6);
          if (fits) pen.fillText(fits, a + 4, top + ROW / 2 + 0.5);
        }
        pen.fillStyle = colour("--soft"); pen.textAlign = "right"; pen.textBaseline = "middle";
        pen.fillText(this.short(pen, lane.name), LEFT - 5, top + ROW / 2 + 0.5);
      });
      this.marks(pen, height);
      const words = now.join(", ");
      if (this.legend.textContent !== words) this.legend.textContent = words;
    }
  }

  const panes = [new Lanes(document.getElementById("lanes")),
    ...data.plots.map((plot) => new Lines(document.getElementById(`plot-${plot.slug}`), plot))];
  const range = document.getElementById("range");
  let due = false;
  function draw() {
    if (due) return;
    due = true;
    requestAnimationFrame(() => {
      due = false;
      LEFT = document.body.clientWidth < 640 ? 60 : 118;
      for (const pane of panes) pane.draw();
      const at = cursor === null ? "" : `at ${cursor.toFixed(3)} s, `;
      range.textContent = `${at}${view[0].toFixed(2)} to ${view[1].toFixed(2)} s`;
    });
  }
  function show(t) { cursor = t; draw(); }
  function look(from, to) {
    const least = 0.02, span = Math.min(Math.max(to - from, least), whole[1] - whole[0]);
    const begin = Math.min(Math.max(from, whole[0]), whole[1] - span);
    view = [begin, begin + span];
    draw();
  }
  function act(what) {
    const [from, to] = view, span = to - from, middle = cursor !== null && cursor > from && cursor < to ? cursor : (from + to) / 2;
    if (what === "all") look(...whole);
    else if (what === "in") look(middle - span / 4, middle + span / 4);
    else if (what === "out") look(middle - span, middle + span);
    else look(from + (what === "on" ? span / 2 : -span / 2), to + (what === "on" ? span / 2 : -span / 2));
  }
  document.addEventListener("click", (e) => {
    const button = e.target.closest("button");
    if (!button) return;
    if (button.dataset.do) act(button.dataset.do);
    else if (button.dataset.t) {
      const t = Number(button.dataset.t);
      pinned = t; look(t - 1, t + 1); show(t);
      document.getElementById("plots").scrollIntoView({ block: "start" });
    }
  });
  new ResizeObserver(draw).observe(document.body);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
})();
