"use strict";
// The machine drawn: a view of a planar machine, or of one in space from where one likes or from above. Without perspective,
// so that capsules are strokes with round ends and lengths are as they are.


// From a handle's middle to its edge, px.
const HANDLE = 18;
// From where to where above the anchor point the box of a machine without a support is drawn, in sizes of the machine.
const BOX = [0.04, 0.11];
// At first so far from the arm's plane, and so far from above, rad; the ground is moved on from so far above it on.
const TURNED = [-0.5, 0.35], FLAT = 0.15;

class View {
  // `axes`: two directions in the machine's space, to the right and up. `upright`: seen from the side; in space it turns.
  constructor(name, dimensions, upright) {
    this.name = name;
    this.d = dimensions;
    this.upright = upright;
    this.turns = upright && dimensions === 3;
    this.axes = upright ? [[1, 0, 0], dimensions === 2 ? [0, 1, 0] : [0, 0, 1]] : [[1, 0, 0], [0, 1, 0]];
    [this.azimuth, this.elevation] = this.turns ? TURNED : [0, 0];
    this.heading = 0;
    this.box = document.createElement("div");
    this.box.className = "view";
    this.canvas = document.createElement("canvas");
    this.box.append(this.canvas);
    if (name) {
      const label = document.createElement("div");
      label.className = "name";
      label.textContent = name;
      this.box.append(label);
    }
    this.overlay = document.createElement("canvas");
    this.width = this.height = 0;
  }

  // Turned about the plane through the ground point and the end-point.
  face(points) {
    if (!this.turns) return;
    const tip = points[points.length - 1], x = tip[0] - points[0][0], y = tip[1] - points[0][1];
    if (Math.hypot(x, y) > 1e-3) this.heading = Math.atan2(y, x);
    this.look();
  }

  look() {
    const angle = this.heading + this.azimuth, [c, s] = [Math.cos(angle), Math.sin(angle)];
    const [high, out] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    this.axes = [[c, s, 0], [-out * s, out * c, high]];
  }

  // By so much, about a point that keeps its place in the picture.
  turn(azimuth, elevation, pivot) {
    const [x, y] = this.at(pivot);
    this.azimuth += azimuth;
    this.elevation = Math.max(0, Math.min(Math.PI / 2, this.elevation + elevation));
    this.look();
    const [u, v] = this.at(pivot);
    this.origin = [this.origin[0] + x - u, this.origin[1] + y - v];
  }

  resize(ratio) {
    const width = this.box.clientWidth, height = Math.round(width * ratio), scale = window.devicePixelRatio || 1;
    this.canvas.style.height = `${height}px`;
    if (this.canvas.width !== Math.round(width * scale) || this.canvas.height !== Math.round(height * scale)) {
      this.canvas.width = Math.round(width * scale);
      this.canvas.height = Math.round(height * scale);
    }
    this.width = width;
    this.height = height;
    this.pixels = scale;
  }

  // The part of the plane that is seen: holds low to high, in the middle, and a handle about each point.
  show(low, high) {
    this.scale = Math.min((this.width - 2 * HANDLE) / (high[0] - low[0]), (this.height - 2 * HANDLE) / (high[1] - low[1]));
    this.origin = [this.width / 2 - this.scale * (low[0] + high[0]) / 2, this.height / 2 + this.scale * (low[1] + high[1]) / 2];
  }

  flat(point) { return this.axes.map((axis) => point.reduce((s, x, k) => s + x * axis[k], 0)); }
  pixel([x, y]) { return [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y]; }
  at(point) { return this.pixel(this.flat(point)); }
  // How near to who looks.
  depth(point) {
    if (this.d === 2) return 0;
    const [u, v] = this.axes;
    return [0, 1, 2].reduce((s, k) => s + point[k] * (u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]), 0);
  }

  // A move of some pixels as one in space: in the picture's plane; to the side and in height; on the ground.
  world(dx, dy) { return this.along(dx, dy, this.axes[1]); }
  risen(dx, dy) { return this.along(dx, dy, this.turns ? [0, 0, 1] : this.axes[1]); }
  level(dx, dy) {
    const [, up] = this.axes, length = Math.hypot(up[0], up[1]);
    if (!this.turns) return this.world(dx, dy);
    return this.along(dx, length > FLAT ? dy / length : 0, [up[0] / (length || 1), up[1] / (length || 1), 0]);
  }
  along(dx, dy, up) { return Array.from({ length: this.d }, (_, k) => (this.axes[0][k] * dx - up[k] * dy) / this.scale); }
}

// Between two colours: red, green, blue.
function blend(from, to, share) {
  const part = (text, k) => parseInt(text.slice(1 + 2 * k, 3 + 2 * k), 16);
  return [0, 1, 2].map((k) => Math.round((1 - share) * part(from, k) + share * part(to, k)));
}
function mixed(from, to, share) { return `rgb(${blend(from, to, share).join()})`; }

function columns(points, d) { return Array.from({ length: points.length / d }, (_, k) => Array.from(points.subarray(k * d, k * d + d))); }

// Where the machine is at q: points, capsules, frames of its bodies and the corners of its support.
function shapeOf(model, q, base) {
  const { data } = model, d = data.dimensions, points = columns(model.skeleton(q, base), d);
  let capsules = [], places = [];
  if (model.graphs.frames) {
    const { origins, rotations } = model.graphs.frames.run([q, base, model.p]);
    places = Array.from({ length: data.frames.length }, (_, k) => ({
      rotation: rotations.slice(k * d * d, (k + 1) * d * d), origin: origins.slice(k * d, (k + 1) * d),
    }));
    capsules = data.capsules.map(({ body, start, end, radius }) => {
      const place = (point) => Array.from({ length: d }, (_, i) => origins[body * d + i]
        + point.reduce((s, x, j) => s + rotations[(body * d + j) * d + i] * x, 0));
      return { ends: [place(start), place(end)], radius, body };
    });
  }
  const named = Object.fromEntries(data.placement.map((name, k) => [name, base[k]])), yaw = named.yaw ?? 0;
  // Last the anchor frame, which nothing but the placement moves.
  if (d === 3) places.push({ rotation: [Math.cos(yaw), Math.sin(yaw), 0, -Math.sin(yaw), Math.cos(yaw), 0, 0, 0, 1], origin: points[0] });
  const support = data.support.map((corner) => {
    const height = model.skeleton(model.unloaded(base, new Float64Array(model.n)), base)[d - 1];
    if (d === 2) return [corner[0] + (named.x ?? 0), height];
    return [Math.cos(yaw) * corner[0] - Math.sin(yaw) * corner[1] + (named.x ?? 0),
      Math.sin(yaw) * corner[0] + Math.cos(yaw) * corner[1] + (named.y ?? 0), height];
  });
  return { points, capsules, support, places };
}

class Painter {
  constructor(view, theme, segments, size) {
    this.view = view; this.theme = theme; this.segments = segments; this.size = size;
    this.c = view.canvas.getContext("2d");
  }

  begin() {
    const { c, view } = this;
    c.setTransform(view.pixels, 0, 0, view.pixels, 0, 0);
    c.clearRect(0, 0, view.width, view.height);
    c.lineJoin = c.lineCap = "round";
  }

  // Seen from above a sheet of it around the machine, else all that is below.
  ground(height, [x0, y0]) {
    const { c, view, theme, size } = this;
    if (view.turns && Math.sin(view.elevation) > FLAT) {
      const reach = 0.9 * size, step = reach / 4, at = (x, y) => view.at([x0 + x, y0 + y, height]);
      this.polygon([at(-reach, -reach), at(reach, -reach), at(reach, reach), at(-reach, reach)], theme.ground, theme.groundLine);
      c.globalAlpha = 0.35;
      for (let k = -3; k <= 3; k++) {
        this.line([at(-reach, k * step), at(reach, k * step)]);
        this.line([at(k * step, -reach), at(k * step, reach)]);
      }
      c.globalAlpha = 1;
      return;
    }
    const y = view.pixel([0, height * Math.cos(view.elevation)])[1];
    c.fillStyle = theme.ground;
    c.fillRect(0, y, view.width, Math.max(0, view.height - y));
    c.strokeStyle = theme.groundLine;
    c.lineWidth = 1.2;
    this.line([[0, y], [view.width, y]]);
  }

  line(points) {
    const { c } = this;
    c.beginPath();
    points.forEach(([x, y], k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.stroke();
  }

  polygon(points, fill, stroke, width = 0.8) {
    const { c } = this;
    c.beginPath();
    points.forEach(([x, y], k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.closePath();
    if (fill) { c.fillStyle = fill; c.fill(); }
    if (stroke) { c.strokeStyle = stroke; c.lineWidth = width; c.stroke(); }
  }

  // Springs between the ground and the box above the anchor point, which moves by what the base gives.
  springs(anchor, ground) {
    const { c, view, theme, size } = this;
    if (!view.upright) return;
    const [x, y] = view.at(anchor), [x0, y0] = view.at(ground), s = view.scale * size, top = y - BOX[0] * s;
    c.strokeStyle = theme.undercarriage;
    c.lineWidth = 1.3;
    for (const side of [-0.11, 0.11]) {
      const from = [x0 + side * s, y0], to = [x + side * s, top], steps = 9;
      this.line(Array.from({ length: steps + 1 }, (_, k) => {
        const t = k / steps, wave = k === 0 || k === steps ? 0 : (k % 2 ? 1 : -1) * 0.012 * s;
        return [from[0] + t * (to[0] - from[0]) + wave, from[1] + t * (to[1] - from[1])];
      }));
    }
  }

  // A capsule as a body: strokes that are narrower and lighter towards the light; in the plane, or of a ghost, a veil.
  capsule({ ends, radius }, colour, ghost) {
    const { c, view, theme } = this, [p, q] = ends.map((end) => view.at(end)), r = radius * view.scale;
    if (ghost || view.d === 2) {
      c.globalAlpha = ghost ? 0.1 : 0.22;
      c.strokeStyle = colour;
      c.lineWidth = 2 * r;
      this.line([p, q]);
      return;
    }
    c.globalAlpha = 1;
    for (let k = 0; k < 5; k++) {
      c.strokeStyle = mixed(colour, k === 0 ? theme.edge : "#ffffff", k === 0 ? 0.35 : 0.08 + 0.13 * k);
      c.lineWidth = Math.max(1, 2 * r * (1 - 0.2 * k) - (k === 1 ? 0 : 1));
      this.line([p, q].map(([x, y]) => [x - 0.08 * k * r, y - 0.1 * k * r]));
    }
  }

  // `meshes`: drawn with the capsules of their bodies as a veil, or null.
  machine(shape, colour, ghost, meshes = null) {
    const { c, view, theme, size } = this, { points, capsules, support } = shape, flat = points.map((p) => view.at(p));
    c.globalAlpha = ghost ? 0.4 : 1;
    if (support.length) {
      const corners = support.map((p) => view.at(p));
      if (view.upright && Math.sin(view.elevation) <= FLAT) {
        const xs = corners.map(([x]) => x), y = corners[0][1];
        c.strokeStyle = theme.undercarriage;
        c.lineWidth = 4;
        this.line([[Math.min(...xs), y], [Math.max(...xs), y]]);
      } else {
        this.polygon(corners, "rgba(128,128,128,0.2)", theme.undercarriage, 1.2);
      }
    } else {
      const [x, y] = flat[0], s = size * view.scale, w = 0.16 * s, [low, high] = view.upright ? BOX : [-0.16, 0.16];
      this.polygon([[x - w, y - high * s], [x + w, y - high * s], [x + w, y - low * s], [x - w, y - low * s]],
        view.upright ? theme.undercarriage : "rgba(128,128,128,0.25)", theme.edge);
    }
    const veiled = capsules.filter(({ body }) => meshes !== null && meshes.bodies.has(body));
    const far = capsules.filter((capsule) => !veiled.includes(capsule)).map((capsule) => [view.depth(capsule.ends[0]) + view.depth(capsule.ends[1]), capsule]);
    far.sort((one, other) => one[0] - other[0]).forEach(([, capsule]) => this.capsule(capsule, colour, ghost));
    if (meshes !== null) {
      c.globalAlpha = 1;
      meshes.draw(c, view, shape.places, colour, theme);
      veiled.forEach((capsule) => this.capsule(capsule, colour, true));
    }
    c.globalAlpha = ghost ? 0.4 : (capsules.length || meshes !== null) && view.d === 3 ? 0.55 : 1;
    this.links(points, flat, colour, ghost);
    c.globalAlpha = ghost ? 0.4 : 1;
    this.pins(flat);
    c.globalAlpha = 1;
  }

  // The skeleton, thinner towards the end-point.
  links(points, flat, colour, ghost) {
    const { view, theme, size, segments } = this;
    const before = new Array(points.length).fill(0);
    segments.forEach(([i, j]) => { before[j] = before[i] + Math.hypot(...points[j].map((x, k) => x - points[i][k])); });
    const longest = Math.max(...before) || 1;
    segments.forEach(([i, j], k) => {
      const length = before[j] - before[i];
      if (length < 1e-3 * size) return;
      const [x0, y0] = flat[i], [x1, y1] = flat[j], seen = Math.hypot(x1 - x0, y1 - y0) || 1;
      const across = [-(y1 - y0) / seen, (x1 - x0) / seen];
      const [thick, thin] = [i, j].map((n) => view.scale * size * (0.027 - 0.016 * before[n] / longest));
      this.polygon([[x0 + thick * across[0], y0 + thick * across[1]], [x1 + thin * across[0], y1 + thin * across[1]],
        [x1 - thin * across[0], y1 - thin * across[1]], [x0 - thick * across[0], y0 - thick * across[1]]],
      k === 0 && !ghost ? theme.base : colour, theme.edge);
    });
  }

  pins(flat) {
    const { c, view, theme, size } = this;
    for (const [x, y] of flat.slice(1, -1)) {
      c.beginPath();
      c.arc(x, y, Math.max(2, 0.009 * size * view.scale), 0, 2 * Math.PI);
      c.fillStyle = theme.halo;
      c.fill();
      c.strokeStyle = theme.edge;
      c.lineWidth = 1;
      c.stroke();
    }
  }

  arrow(from, vector, length, colour, dashed, width) {
    const { c, view } = this, flat = view.flat(vector), size = Math.hypot(...flat);
    if (!(size > 0) || !(length > 4)) return;
    const [x, y] = view.at(from), share = size / Math.hypot(...vector);
    const u = flat[0] / size, v = -flat[1] / size, reach = length * share, end = [x + reach * u, y + reach * v];
    // A halo keeps it apart from map and machine.
    for (const [stroke, wide] of [[this.theme.halo, width + 2.5], [colour, width]]) {
      c.strokeStyle = stroke;
      c.lineWidth = wide;
      c.setLineDash(dashed && stroke === colour ? [6, 5] : []);
      this.line([[x, y], end]);
      c.setLineDash([]);
      const h = 9;
      this.line([[end[0] - h * (u - 0.5 * v), end[1] - h * (v + 0.5 * u)], end, [end[0] - h * (u + 0.5 * v), end[1] - h * (v - 0.5 * u)]]);
    }
  }

  cross(point, colour) {
    const { c, view } = this, [x, y] = view.at(point);
    c.strokeStyle = colour;
    c.lineWidth = 2;
    this.line([[x - 8, y], [x + 8, y]]);
    this.line([[x, y - 8], [x, y + 8]]);
  }
}
