"use strict";
// Meshes of bodies, drawn into an array of pixels with a depth for each: no graphics card is asked for, and all browsers
// draw the same. Without perspective, flat shades, light from the upper left of who looks.

const LIGHT = [-0.35, 0.55, 0.76], SHADES = 64;
// Pixels of a picture, at most; where there is room each is drawn as four.
const PIXELS_MAX = 1.2e6;

function bytesOf(text) { return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer; }

class BodyMesh {
  constructor({ body, low, step, wide, corners, triangles }) {
    const at = new Uint16Array(bytesOf(corners));
    this.body = body;
    this.triangles = wide ? new Uint32Array(bytesOf(triangles)) : new Uint16Array(bytesOf(triangles));
    this.corners = Float32Array.from(at, (x, k) => low[k % 3] + step[k % 3] * x);
    this.seen = new Float32Array(this.corners.length);
    this.normals = new Float32Array(this.triangles.length);
    const c = this.corners, n = this.normals;
    for (let t = 0; t < n.length; t += 3) {
      const [i, j, k] = [3 * this.triangles[t], 3 * this.triangles[t + 1], 3 * this.triangles[t + 2]];
      const [ax, ay, az] = [c[j] - c[i], c[j + 1] - c[i + 1], c[j + 2] - c[i + 2]];
      const [bx, by, bz] = [c[k] - c[i], c[k + 1] - c[i + 1], c[k + 2] - c[i + 2]];
      const [x, y, z] = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], size = Math.hypot(x, y, z) || 1;
      n[t] = x / size; n[t + 1] = y / size; n[t + 2] = z / size;
    }
  }
}

// The meshes of a machine, and where each view draws them.
class MeshPainter {
  constructor(list) {
    this.meshes = list.map((each) => new BodyMesh(each));
    this.bodies = new Set(this.meshes.map(({ body }) => body));
    this.pictures = new Map();
    this.colour = null;
  }

  // Corners of the boxes round the meshes, in space.
  extent(places) {
    return this.meshes.flatMap(({ body, corners }) => {
      const { rotation: R, origin } = places[body < 0 ? places.length - 1 : body], ends = [[], []];
      for (let j = 0; j < 3; j++) {
        let [low, high] = [Infinity, -Infinity];
        for (let k = j; k < corners.length; k += 3) { low = Math.min(low, corners[k]); high = Math.max(high, corners[k]); }
        ends[0][j] = low;
        ends[1][j] = high;
      }
      return Array.from({ length: 8 }, (_, n) => [0, 1, 2].map((i) => [0, 1, 2].reduce(
        (s, j) => s + R[3 * j + i] * ends[(n >> j) & 1][j], origin[i])));
    });
  }

  // Shades of a colour, the darkest first, as pixels.
  shadesOf(colour, theme) {
    if (this.colour !== colour) {
      this.colour = colour;
      this.shades = packed(Array.from({ length: SHADES }, (_, k) => {
        const light = k / (SHADES - 1);
        return light < 0.5 ? blend(colour, theme.edge, 0.55 - 1.1 * light) : blend(colour, "#ffffff", 1.1 * (light - 0.5));
      }));
    }
    return this.shades;
  }

  picture(view) {
    const fine = view.width * view.height * 4 <= PIXELS_MAX ? 2 : 1;
    const width = Math.max(1, Math.round(fine * view.width)), height = Math.max(1, Math.round(fine * view.height));
    let found = this.pictures.get(view);
    if (!found || found.canvas.width !== width || found.canvas.height !== height) {
      const canvas = Object.assign(document.createElement("canvas"), { width, height }), context = canvas.getContext("2d");
      const image = context.createImageData(width, height);
      found = { canvas, context, image, pixels: new Uint32Array(image.data.buffer), depth: new Float32Array(width * height) };
      this.pictures.set(view, found);
    }
    return Object.assign(found, { fine });
  }

  // Onto a view: bodies at `places`, a rotation by columns and an origin each, the anchor frame's last.
  draw(context, view, places, colour, theme) {
    const picture = this.picture(view), { pixels, depth, fine, canvas } = picture, { width, height } = canvas;
    const [u, v] = view.axes, shades = this.shadesOf(colour, theme), box = [width, height, 0, 0];
    const w = [0, 1, 2].map((k) => u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
    const turned = this.meshes.map((mesh) => {
      const { rotation: R, origin } = places[mesh.body < 0 ? places.length - 1 : mesh.body];
      // Of each picture axis its components in the body's axes, and where the body's origin is.
      const axes = [u, v, w].map((axis) => [0, 1, 2].map((j) => axis[0] * R[3 * j] + axis[1] * R[3 * j + 1] + axis[2] * R[3 * j + 2]));
      project(mesh, axes, [u, v, w].map((axis) => axis[0] * origin[0] + axis[1] * origin[1] + axis[2] * origin[2]), view, fine, box);
      return axes;
    });
    const [left, top] = [Math.max(0, Math.floor(box[0])), Math.max(0, Math.floor(box[1]))];
    const [right, low] = [Math.min(width, Math.ceil(box[2]) + 1), Math.min(height, Math.ceil(box[3]) + 1)];
    if (!(left < right && top < low)) return;
    for (let row = top; row < low; row++) {
      pixels.fill(0, row * width + left, row * width + right);
      depth.fill(-Infinity, row * width + left, row * width + right);
    }
    this.meshes.forEach((mesh, index) => {
      const { seen, triangles, normals } = mesh, [a, b, c] = turned[index];
      const l = [0, 1, 2].map((k) => LIGHT[0] * a[k] + LIGHT[1] * b[k] + LIGHT[2] * c[k]);
      for (let t = 0; t < triangles.length; t += 3) {
        const nx = normals[t], ny = normals[t + 1], nz = normals[t + 2];
        let lit = nx * l[0] + ny * l[1] + nz * l[2];
        // Files do not agree on which side of a triangle is outside: the one that is seen is lit.
        if (nx * c[0] + ny * c[1] + nz * c[2] < 0) lit = -lit;
        const shade = shades[Math.max(0, Math.min(SHADES - 1, Math.round((SHADES - 1) * (0.15 + 0.85 * lit))))];
        nearer(pixels, depth, width, height, seen, 3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2], shade);
      }
    });
    const size = [right - left, low - top];
    picture.context.putImageData(picture.image, 0, 0, left, top, ...size);
    context.drawImage(canvas, left, top, ...size, left / fine, top / fine, ...size.map((x) => x / fine));
  }
}

// Corners in pixels and nearness, into `seen`; `box` grows round them.
function project({ corners, seen }, [a, b, c], [x0, y0, z0], view, fine, box) {
  const scale = fine * view.scale, px = fine * view.origin[0] + scale * x0, py = fine * view.origin[1] - scale * y0;
  let [left, top, right, low] = box;
  for (let k = 0; k < corners.length; k += 3) {
    const x = corners[k], y = corners[k + 1], z = corners[k + 2];
    const i = px + scale * (a[0] * x + a[1] * y + a[2] * z), j = py - scale * (b[0] * x + b[1] * y + b[2] * z);
    seen[k] = i;
    seen[k + 1] = j;
    seen[k + 2] = z0 + c[0] * x + c[1] * y + c[2] * z;
    if (i < left) left = i;
    if (i > right) right = i;
    if (j < top) top = j;
    if (j > low) low = j;
  }
  box.splice(0, 4, left, top, right, low);
}

// All pixels whose middles are in a triangle and nearer than what is there; corners x, y, depth from i, j, k on.
function nearer(pixels, depth, width, height, at, i, j, k, colour) {
  const x0 = at[i], y0 = at[i + 1], x1 = at[j], y1 = at[j + 1], x2 = at[k], y2 = at[k + 1];
  const low = Math.max(0, Math.ceil(Math.min(y0, y1, y2) - 0.5)), high = Math.min(height - 1, Math.floor(Math.max(y0, y1, y2) - 0.5));
  if (low > high) return;
  const area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
  if (area === 0) return;
  const z0 = at[i + 2], da = at[j + 2] - z0, db = at[k + 2] - z0;
  const aside = (da * (y2 - y0) - db * (y1 - y0)) / area, down = (db * (x1 - x0) - da * (x2 - x0)) / area;
  for (let v = low; v <= high; v++) {
    const y = v + 0.5;
    let left = Infinity, right = -Infinity;
    if ((y0 <= y) !== (y1 <= y)) { const x = across(x0, y0, x1, y1, y); if (x < left) left = x; if (x > right) right = x; }
    if ((y1 <= y) !== (y2 <= y)) { const x = across(x1, y1, x2, y2, y); if (x < left) left = x; if (x > right) right = x; }
    if ((y2 <= y) !== (y0 <= y)) { const x = across(x2, y2, x0, y0, y); if (x < left) left = x; if (x > right) right = x; }
    const first = Math.max(0, Math.ceil(left - 0.5)), last = Math.min(width - 1, Math.floor(right - 0.5));
    let z = z0 + aside * (first + 0.5 - x0) + down * (y - y0);
    for (let n = v * width + first, end = v * width + last; n <= end; n++, z += aside) {
      if (z > depth[n]) { depth[n] = z; pixels[n] = colour; }
    }
  }
}
