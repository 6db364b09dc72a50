"use strict";
// What a frame draws: the machine in its views, how it moves, and the map.

const $ = (id) => document.getElementById(id);
const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
function digits(x, n = 3) {
  if (!Number.isFinite(x)) return "–";
  if (x !== 0 && (Math.abs(x) < 1e-3 || Math.abs(x) >= 1e6)) {
    const [mantissa, exponent] = x.toExponential(n - 1).split("e");
    return `${String(Number(mantissa)).replace("-", "−")}·10${[...String(Number(exponent))].map((c) => RAISED[c]).join("")}`;
  }
  return String(Number(x.toPrecision(n))).replace("-", "−");
}
// A coordinate, m or rad, where nobody could tell it from 0.
function coordinate(x) { return Math.abs(x) < 1e-7 ? 0 : x; }
// A text with its numbers as the page writes them: one gain is not to be read in two formats.
function inDigits(text) { return text.replace(/\d+(\.\d+)?e[+-]\d+/g, (x) => digits(Number(x), 4)); }
// How a mode is shown: displacement as a share of the machine's size, and how often, Hz.
const SHOWN_SIZE = 0.035, SHOWN_HZ = 0.7;

// The drawing half of the page: of an object that knows configuration, modes, map and theme.
class Pictures {
  layout() {
    const narrow = window.innerWidth < 700, planar = this.data.dimensions === 2;
    for (const view of this.views) view.resize(planar ? (narrow ? 0.85 : 0.72) : narrow ? 0.75 : 0.5);
    this.refit = true;
  }

  // The part of the plane that holds all that is drawn, and what the arm reaches from here, down to a little below ground.
  fit() {
    const { model, data, base } = this, d = data.dimensions, reached = [];
    const seed = { x: 1 }, random = () => { seed.x = (seed.x * 48271) % 2147483647; return seed.x / 2147483647; };
    for (let k = 0; k < 400; k++) {
      const posture = Float64Array.from(data.ranges, ([low, high]) => low + (high - low) * random());
      reached.push(...columns(model.skeleton(model.rest(base, posture), base), d));
    }
    for (const view of this.views) {
      view.face(this.shape.points);
      const flat = reached.map((p) => view.flat(p));
      const floor = view.flat(this.shape.points[0])[1] - 0.35 * data.size * Math.cos(view.elevation);
      if (view.upright) flat.forEach((p) => { p[1] = Math.max(p[1], floor); });
      flat.push(...this.drawn(view));
      const [low, high] = [Math.min, Math.max].map((most) => [0, 1].map((k) => most(...flat.map((p) => p[k]))));
      const room = SHOWN_SIZE * data.size, show = () => view.show(low.map((x) => x - room), high.map((x) => x + room));
      show();
      // Arrows are so many pixels long, whatever the scale: with more room for them it gets smaller.
      const tip = view.flat(this.shape.points.at(-1));
      for (let round = 0; round < 3; round++) {
        for (const { vector, length } of this.arrows(view)) {
          view.flat(vector).forEach((x, k) => {
            const end = tip[k] + length * x / (view.scale * (Math.hypot(...vector) || 1));
            low[k] = Math.min(low[k], end);
            high[k] = Math.max(high[k], end);
          });
        }
        show();
      }
    }
  }

  // Outlines of what is drawn, in the picture's plane, m: machine and ghosts with all that they stand on, and the target.
  drawn(view) {
    const { data } = this, round = ([x, y], w, h = w) => [[x - w, y - h], [x + w, y + h]];
    const flat = [this.shape, ...this.ghosts.map((ghost) => ghost.shape)].flatMap(({ points, capsules, support }) => [
      ...[...points, ...support].map((p) => view.flat(p)),
      ...capsules.flatMap(({ ends, radius }) => ends.flatMap((end) => round(view.flat(end), radius))),
      ...(support.length ? [] : round(view.flat(points[0]), 0.16 * data.size, (view.upright ? 0.12 : 0.16) * data.size)),
    ]);
    flat.push(...this.meshes.extent(this.shape.places).map((p) => view.flat(p)));
    // One far below is not in the picture.
    const [foot] = this.shape.points, low = foot.at(-1) - data.size;
    if (view.upright && data.ground > low) flat.push(view.flat([...foot.slice(0, -1), data.ground]));
    return data.target ? [...flat, view.flat(this.cross())] : flat;
  }

  // Where the target is; where the task leaves a coordinate open, beside the end-point.
  cross() {
    const { data, rows } = this;
    return this.shape.points.at(-1).map((x, k) => (rows.includes(k) ? data.target[rows.indexOf(k)] : x));
  }

  // Whether a part of a handle is not in the picture.
  beyond(view) {
    const { points } = this.shape, handles = [points.at(-1), ...(view.stand ? [points[0]] : [])];
    return handles.map((p) => view.at(p)).some(([x, y]) => Math.min(x, view.width - x, y, view.height - y) < HANDLE);
  }

  // Of all modes how they move the end-point and how feedback there drives them; lengths in pixels: in proportion, but
  // none so short that its direction is not seen, and those of the chosen mode as long as any.
  arrows(view) {
    const modes = this.modes || [], longest = 0.2 * Math.min(view.width, view.height) + 20;
    return ["a", "b"].flatMap((key) => {
      const most = Math.max(...modes.map((mode) => Math.hypot(...mode[key]))) || 1;
      return modes.map((mode, i) => ({ mode: i, key, vector: this.inSpace(mode[key], this.data.dimensions), length: this.unreached(i) ? 0 : longest * this.lengthOf(i, Math.hypot(...mode[key]) / most) }));
    });
  }

  lengthOf(mode, share) {
    if (share < 1e-9) return 0;
    return mode === this.mode ? 1 : Math.max(share, 0.4);
  }

  displayed(now) {
    const kind = $("motion").value, q = Float64Array.from(this.rest);
    if (kind === "off" || !this.modes || this.dragged) return q;
    if (kind === "loop") return this.played(now, q);
    const { shape } = this.modes[this.mode];
    const size = this.shown(shape) * Math.sin(2 * Math.PI * SHOWN_HZ * (now - this.phase) / 1e3);
    return q.map((x, k) => x + size * shape[k]);
  }

  // By which a displacement is to be multiplied to be seen.
  shown(shape) {
    const { model, data, base, rest } = this, d = data.dimensions, tiny = 1e-6, moved = rest.map((x, k) => x + tiny * shape[k]);
    const before = columns(model.skeleton(rest, base), d), after = columns(model.skeleton(moved, base), d);
    const most = Math.max(...before.map((p, k) => Math.hypot(...p.map((x, i) => x - after[k][i])))) / tiny;
    return SHOWN_SIZE * data.size / Math.max(most, 1e-30);
  }

  // The linear loop after a push into the chosen mode, in real time, enlarged; again once it is gone or too large.
  played(now, q) {
    const count = q.length, { period, to_q: toQ } = this.data.loop;
    if (this.playing === null) {
      const { matrix } = this.loop.sample(this.base, this.posture, this.gains), { shape } = this.modes[this.mode];
      const size = this.shown(shape), u = Linear.solve(Float64Array.from(toQ), shape.map((x) => size * x), count, 1);
      const x = new Matrix(matrix.m, 1);
      x.a.set(u);
      this.playing = { matrix, x, begun: now, done: 0, first: Math.hypot(...u) };
    }
    const play = this.playing, until = (now - play.begun) / 1e3 / period;
    for (; play.done < until && play.done < 1e5; play.done++) play.x = play.matrix.times(play.x);
    const size = Math.hypot(...play.x.a.subarray(0, count));
    if (!(size < 6 * play.first) || until * period > 8) { this.playing = null; return q; }
    const move = Linear.multiply(Float64Array.from(toQ), play.x.a.slice(0, count), count, count, 1);
    return q.map((x, k) => x + move[k]);
  }

  draw(now) {
    const q = this.displayed(now), shape = shapeOf(this.model, q, this.base), d = this.data.dimensions;
    this.views.forEach((view) => this.drawView(view, shape, d));
    if (this.axes !== null && (this.changed || this.recolour || this.resized)) this.drawMap();
    this.caption();
  }

  drawView(view, shape, d) {
    const { theme, data } = this, painter = new Painter(view, theme, data.segments, data.size), { points } = this.shape;
    painter.begin();
    const lifted = data.support.length === 0 && view.upright;
    if (view.upright) painter.ground(data.ground, points[0]);
    if (d === 2 && $("show-map").checked && this.map.shown !== null) this.underlay(view, painter.c, points[0]);
    if (lifted) painter.springs(shape.points[0], [...points[0].slice(0, -1), data.ground]);
    for (const ghost of this.ghosts) painter.machine(ghost.shape, theme.chosen, true);
    painter.machine(shape, theme.present, false, this.meshes.bodies.size && $("show-meshes").checked ? this.meshes : null);
    if (data.target) painter.cross(this.cross(), theme.text);
    const tip = shape.points[shape.points.length - 1];
    const shown = this.arrows(view).filter(({ mode }) => mode === this.mode || $("show-arrows").checked);
    for (const { mode, key, vector, length } of shown.sort((one, other) => (one.mode === this.mode) - (other.mode === this.mode))) {
      painter.arrow(tip, vector, length, theme.series[mode % theme.series.length], key === "b", mode === this.mode ? 3.5 : 2);
    }
    const put = (button, point) => { const [x, y] = view.at(point); button.style.left = `${x}px`; button.style.top = `${y}px`; };
    put(view.end, points[points.length - 1]);
    if (view.stand) put(view.stand, points[0]);
  }

  inSpace(rows, d) { return Array.from({ length: d }, (_, k) => (this.rows.includes(k) ? rows[this.rows.indexOf(k)] : 0)); }

  underlay(view, context, ground) {
    const { overlay } = view, elbow = this.data.joints.length > 1 ? this.branch() : 0;
    const key = [view.width, view.height, view.scale, ...view.origin, elbow, this.axes].join();
    if (this.recolour || key !== view.drawn) {
      const width = Math.round(view.width), height = Math.round(view.height);
      if (overlay.width !== width || overlay.height !== height) Object.assign(overlay, { width, height });
      view.drawn = key;
      view.ground = ground;
      const c = overlay.getContext("2d"), picture = c.createImageData(width, height);
      this.map.workspace(picture, this.posture, view.scale, ...view.at(ground));
      c.putImageData(picture, 0, 0);
    }
    const move = view.scale * (ground[0] - view.ground[0]);
    context.globalAlpha = 0.75;
    context.drawImage(overlay, move, -view.scale * (ground[1] - view.ground[1]), view.width, view.height);
    context.globalAlpha = 1;
  }

  // To which side the two joints of the map bend the arm.
  branch() {
    const { J } = this.model.about("reach", this.base, this.posture), { r, n_b } = this.model, [x, y] = this.axes;
    return r < 2 ? 0 : Math.sign(J[(n_b + x) * r] * J[(n_b + y) * r + 1] - J[(n_b + x) * r + 1] * J[(n_b + y) * r]);
  }

  drawMap() {
    const canvas = $("map"), scale = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect(), { data, theme, axes } = this;
    if (canvas.width !== Math.round(box.width * scale)) canvas.width = Math.round(box.width * scale);
    if (canvas.height !== Math.round(box.height * scale)) canvas.height = Math.round(box.height * scale);
    const c = canvas.getContext("2d"), left = 62, top = 6, width = box.width - left - 8, height = box.height - top - 38;
    this.frame = { left, top, width, height };
    c.setTransform(scale, 0, 0, scale, 0, 0);
    c.clearRect(0, 0, box.width, box.height);
    c.imageSmoothingEnabled = false;
    c.drawImage(this.map.image, left, top, width, height);
    c.strokeStyle = theme.muted;
    c.lineWidth = 1;
    c.strokeRect(left, top, width, height);
    c.fillStyle = theme.text;
    c.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    const [x, y] = axes, name = (k) => `${data.joints[k]}, ${data.joint_units[k]}`, place = (posture) => axes.map((joint, k) => {
      const [low, high] = data.ranges[joint], share = (posture[joint] - low) / (high - low);
      return k ? top + height * (1 - share) : left + width * share;
    });
    for (let k = 0; k <= 2; k++) {
      const share = k / 2, at = (joint) => digits(data.ranges[joint][0] + share * (data.ranges[joint][1] - data.ranges[joint][0]), 3);
      c.textAlign = k === 0 ? "left" : k === 1 ? "center" : "right";
      c.fillText(at(x), left + share * width, top + height + 15);
      c.textAlign = "right";
      c.fillText(at(y), left - 5, top + height * (1 - share) + (k === 0 ? 0 : k === 2 ? 10 : 4));
    }
    c.textAlign = "center";
    c.fillText(name(x), left + width / 2, top + height + 31);
    c.save();
    c.translate(10, top + height / 2);
    c.rotate(-Math.PI / 2);
    c.fillText(name(y), 0, 0);
    c.restore();
    const mark = ([u, v], colour) => {
      c.beginPath();
      c.arc(u, v, 6, 0, 2 * Math.PI);
      for (const [stroke, wide] of [["#ffffff", 5], [colour, 2.5]]) { c.strokeStyle = stroke; c.lineWidth = wide; c.stroke(); }
    };
    for (const ghost of this.ghosts) mark(place(ghost.posture), INKS.chosen);
    mark(place(this.posture), INKS.present);
  }

  caption() {
    if (this.note || !this.modes) return;
    const kind = $("motion").value, hz = digits(this.modes[this.mode].hz), mode = `mode ${this.mode + 1}`;
    const words = { mode: `Shown: ${mode}, ${hz} Hz, slowed and enlarged.`, loop: `Shown: the closed loop after a push into ${mode}, in real time, enlarged.`, off: "" };
    if ($("note").textContent !== words[kind]) $("note").textContent = words[kind];
  }
}
