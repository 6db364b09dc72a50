"use strict";
// A measure, or the decay of the loop, over two joints, the others and the base held: computed in slices, so that no frame
// waits for it.

const CELLS = 100;
// Loops take longer than modes: they are looked at in every so manyth posture first, and in all at last.
const STRIDES = [10, 5, 2, 1];
// What is shown by number: w_i from 0 on, their weighted sum, the decay.
const SUM = -1, DECAY = -2;
// Of the regular cells this share is drawn in the colour of the worst: near singular postures measures fall without end.
const WORST_SHOWN = 0.25;
// Dark blue to yellow, also for those who do not tell red from green (after Nuñez, Anderton and Renslow, 2018).
const ANCHORS = [[0, 34, 78], [46, 68, 109], [96, 100, 112], [140, 137, 120], [193, 180, 108], [254, 232, 56]];
// From purple, what grows, to green, what settles (after Brewer's PRGn).
const TWO_SIDED = [[64, 0, 75], [153, 112, 171], [247, 247, 247], [90, 174, 97], [0, 68, 27]];
const shades = (anchors) => Array.from({ length: 256 }, (_, k) => {
  const x = k / 255 * (anchors.length - 1), i = Math.min(anchors.length - 2, Math.floor(x));
  return anchors[i].map((low, c) => Math.round(low + (x - i) * (anchors[i + 1][c] - low)));
});
// The same as four bytes of a picture, opaque, in the order that this machine has them.
const packed = (rgbs) => Uint32Array.from(rgbs, (rgb) => new Uint32Array(Uint8Array.of(...rgb, 255).buffer)[0]);
const OF_MEASURES = shades(ANCHORS), OF_DECAY = shades(TWO_SIDED);

class JointMap {
  constructor(model, loop) {
    this.model = model;
    this.loop = loop;
    const cells = CELLS * CELLS, blank = () => ({
      w: Array.from({ length: model.m }, () => new Float64Array(cells)), decay: new Float64Array(cells),
      corners: new Float64Array(2 * (CELLS + 1) ** 2), key: "", base: new Float64Array(model.n_b),
    });
    // Of V = Σ α w: a problem's, or all alike.
    const { objective, weights } = model.data;
    this.weights = objective === "V" && weights.some((x) => x > 0) ? weights : new Array(model.m).fill(1);
    this.shown = null;
    this.shades = OF_MEASURES;
    this.spare = [blank(), blank()];
    this.job = null;
    this.image = document.createElement("canvas");
    this.image.width = this.image.height = CELLS;
    this.shade = new Uint8Array(cells);
    this.regular = new Uint8Array(cells);
    this.milliseconds = 0;
    this.points = null;
  }

  // What the values depend on: where it changes, the map is computed again.
  key(base, posture, x, y, gains) {
    const held = Array.from(posture).map((v, k) => (k === x || k === y ? null : v));
    return JSON.stringify([x, y, held, this.model.data.moving.map((k) => base[k]), Array.from(this.model.p), gains]);
  }

  value(axis, k, count) {
    const [low, high] = this.model.data.ranges[axis];
    return low + (high - low) * k / count;
  }

  // Begin again where something changed; a map that is being computed is finished first, so that it follows a drag, but
  // not one of thousands of loops. `gains`: of the loop whose decay is asked for, or null.
  want(base, posture, x, y, gains) {
    const key = this.key(base, posture, x, y, gains), begun = this.shown !== null && this.shown.key === key;
    if (this.job !== null) {
      if (this.job.into.key === key || this.job.into.gains === null || this.job.into.stride === STRIDES[0]) return;
      this.spare.push(this.job.into);
      this.job = null;
    }
    if (begun && this.shown.stride === 1) return;
    const next = begun ? STRIDES.indexOf(this.shown.stride) + 1 : 0;
    const into = this.spare.pop(), stride = gains === null ? 1 : STRIDES[next];
    Object.assign(into, { key, x, y, gains, stride });
    into.base.set(base);
    this.job = { into, at: 0, posture: Float64Array.from(posture), p: Float64Array.from(this.model.p), spent: 0 };
  }

  // One posture in the middle of stride × stride of them, for which it stands.
  cell(into, posture, k) {
    const { stride } = into, across = CELLS / stride, [i, j] = [stride * (k % across), stride * Math.floor(k / across)];
    posture[into.x] = this.value(into.x, i + stride / 2, CELLS);
    posture[into.y] = this.value(into.y, j + stride / 2, CELLS);
    const good = this.model.solve(into.base, posture), { w } = this.model.scratch;
    const decay = good && into.gains !== null ? this.loop.verdict(into.base, posture, into.gains, true).decay : NaN;
    for (let v = j; v < j + stride; v++) {
      for (let u = i; u < i + stride; u++) {
        into.decay[v * CELLS + u] = decay;
        for (let n = 0; n < this.model.m; n++) into.w[n][v * CELLS + u] = good ? w[n] : NaN;
      }
    }
  }

  // Go on for some milliseconds; true where the map is complete.
  step(budget) {
    const { job, model } = this;
    if (job === null) return false;
    const { into, posture } = job, { x, y } = into, cells = (CELLS / into.stride) ** 2, all = cells + (CELLS + 1) ** 2;
    const often = into.gains === null ? 63 : 0;
    const begun = performance.now(), kept = Float64Array.from(model.p);
    model.p.set(job.p);
    while (job.at < all && !((job.at & often) === 0 && performance.now() - begun > budget)) {
      if (job.at < cells) {
        this.cell(into, posture, job.at);
      } else if (model.data.dimensions === 2) {
        const corner = job.at - cells;
        posture[x] = this.value(x, corner % (CELLS + 1), CELLS);
        posture[y] = this.value(y, Math.floor(corner / (CELLS + 1)), CELLS);
        const points = model.skeleton(model.rest(into.base, posture), into.base);
        into.corners[2 * corner] = points[points.length - 2] - points[0];
        into.corners[2 * corner + 1] = points[points.length - 1] - points[1];
      } else {
        job.at = all - 1;
      }
      job.at++;
    }
    model.p.set(kept);
    job.spent += performance.now() - begun;
    if (job.at < all) return false;
    if (this.shown !== null) this.spare.push(this.shown);
    this.shown = into;
    this.milliseconds = job.spent;
    this.job = null;
    return true;
  }

  // Colours of one measure, by its number; false where it is not computed yet.
  colour(measure) {
    if (this.shown === null || (measure === DECAY && this.shown.gains === null)) return false;
    const cells = CELLS * CELLS, { w } = this.shown, two = measure === DECAY;
    const values = two ? this.shown.decay : measure === SUM ? new Float64Array(cells) : w[measure];
    if (measure === SUM) w.forEach((each, i) => { for (let k = 0; k < cells; k++) values[k] += this.weights[i] * each[k]; });
    const sorted = (two ? values.map((v) => -Math.abs(v)) : values).filter((v) => !Number.isNaN(v)).sort();
    this.worst = sorted.length ? sorted[Math.floor(WORST_SHOWN * (sorted.length - 1))] : 0;
    this.shades = two ? OF_DECAY : OF_MEASURES;
    const context = this.image.getContext("2d"), picture = context.createImageData(CELLS, CELLS);
    for (let k = 0; k < cells; k++) {
      const v = values[k], good = !Number.isNaN(v), row = CELLS - 1 - Math.floor(k / CELLS);
      this.regular[k] = good;
      // By the square root: what matters lies near 0.
      const share = Math.sqrt(Math.min(1, this.worst < 0 ? Math.abs(v / this.worst) : 0));
      this.shade[k] = good ? Math.round(255 * (two ? (1 + Math.sign(v) * share) / 2 : v < 0 ? 1 - share : 1)) : 0;
      const at = 4 * (row * CELLS + k % CELLS), colour = this.shades[this.shade[k]];
      for (let c = 0; c < 3; c++) picture.data[at + c] = colour[c];
      picture.data[at + 3] = good ? 255 : 0;
    }
    context.putImageData(picture, 0, 0);
    return true;
  }

  // The cells where the end-point is in them, of the branch of a posture, into a picture: planar arms. A point x, y away
  // from the ground point is at u = u0 + scale x, v = v0 − scale y. Thousands of cells: no object is made for one.
  workspace(picture, posture, scale, u0, v0) {
    const { x, y, corners } = this.shown, { width, height } = picture, side = CELLS + 1, count = side * side;
    const pixels = new Uint32Array(picture.data.buffer), colours = packed(this.shades), place = this.place ??= new Float64Array(2 * count);
    pixels.fill(0);
    for (let k = 0; k < count; k++) {
      place[2 * k] = u0 + scale * corners[2 * k];
      place[2 * k + 1] = v0 - scale * corners[2 * k + 1];
    }
    const cell = (axis) => {
      const [low, high] = this.model.data.ranges[axis];
      return Math.max(0, Math.min(CELLS - 1, Math.floor(CELLS * (posture[axis] - low) / (high - low))));
    };
    const here = cell(y) * side + cell(x), branch = Math.sign(turn(place, here, side));
    for (let j = 0; j < CELLS; j++) {
      for (let i = 0; i < CELLS; i++) {
        const k = j * CELLS + i, p = j * side + i;
        if (this.regular[k] === 0 || Math.sign(turn(place, p, side)) !== branch) continue;
        const colour = colours[this.shade[k]];
        triangle(pixels, width, height, place, p, p + 1, p + 1 + side, colour);
        triangle(pixels, width, height, place, p, p + 1 + side, p + side, colour);
      }
    }
  }
}

// Twice the signed area of a cell whose first corner is p.
function turn(place, p, side) {
  const q = p + 1 + side, a = p + 1, b = p + side;
  return (place[2 * q] - place[2 * p]) * (place[2 * b + 1] - place[2 * a + 1])
    - (place[2 * b] - place[2 * a]) * (place[2 * q + 1] - place[2 * p + 1]);
}

// All pixels whose middles are in a triangle of corners i, j, k, row by row between its edges.
function triangle(pixels, width, height, place, i, j, k, colour) {
  const x0 = place[2 * i], y0 = place[2 * i + 1], x1 = place[2 * j], y1 = place[2 * j + 1], x2 = place[2 * k], y2 = place[2 * k + 1];
  const top = Math.max(0, Math.ceil(Math.min(y0, y1, y2) - 0.5)), low = Math.min(height - 1, Math.floor(Math.max(y0, y1, y2) - 0.5));
  for (let v = top; v <= low; v++) {
    const y = v + 0.5;
    let left = Infinity, right = -Infinity;
    if ((y0 <= y) !== (y1 <= y)) { const x = across(x0, y0, x1, y1, y); left = Math.min(left, x); right = Math.max(right, x); }
    if ((y1 <= y) !== (y2 <= y)) { const x = across(x1, y1, x2, y2, y); left = Math.min(left, x); right = Math.max(right, x); }
    if ((y2 <= y) !== (y0 <= y)) { const x = across(x2, y2, x0, y0, y); left = Math.min(left, x); right = Math.max(right, x); }
    const end = Math.min(width - 1, Math.floor(right - 0.5));
    for (let u = Math.max(0, Math.ceil(left - 0.5)); u <= end; u++) pixels[v * width + u] = colour;
  }
}

// Where an edge is at the height y, from its lower end, so that it is the same for both triangles beside it.
function across(x0, y0, x1, y1, y) { return y0 < y1 ? x0 + (x1 - x0) * ((y - y0) / (y1 - y0)) : x1 + (x0 - x1) * ((y - y1) / (y0 - y1)); }
