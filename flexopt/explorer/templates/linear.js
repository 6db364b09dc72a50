"use strict";
// Dense linear algebra, matrices column by column in Float64Arrays. Knows no machine.

function copysign(x, y) { return (y < 0 || Object.is(y, -0)) ? -Math.abs(x) : Math.abs(x); }

// A machine's graph: `run` writes into `o`, which stays the same array; `call` gives the outputs by name.
function graph(inputs, outputs, kept, pieces) {
  const w = new Float64Array(Math.max(1, kept));
  const o = outputs.map(([, rows, columns]) => new Float64Array(rows * columns));
  const named = {};
  outputs.forEach(([name], k) => { named[name] = o[k]; });
  function run(i) { for (let k = 0; k < pieces.length; k++) pieces[k](i, o, w); return named; }
  return { inputs, outputs, run };
}

const Linear = {
  // L of A = L Lᵀ, lower, NaN where A is not positive definite.
  cholesky(A, n, L) {
    L.fill(0);
    for (let j = 0; j < n; j++) {
      let d = A[j + j * n];
      for (let k = 0; k < j; k++) d -= L[j + k * n] * L[j + k * n];
      d = Math.sqrt(d);
      L[j + j * n] = d;
      for (let i = j + 1; i < n; i++) {
        let s = A[i + j * n];
        for (let k = 0; k < j; k++) s -= L[i + k * n] * L[j + k * n];
        L[i + j * n] = s / d;
      }
    }
    return L;
  },

  // A⁻¹ B in the place of B, from A = L Lᵀ.
  choleskySolve(L, n, B, columns) {
    for (let c = 0; c < columns; c++) {
      const at = c * n;
      for (let i = 0; i < n; i++) {
        let s = B[at + i];
        for (let k = 0; k < i; k++) s -= L[i + k * n] * B[at + k];
        B[at + i] = s / L[i + i * n];
      }
      for (let i = n - 1; i >= 0; i--) {
        let s = B[at + i];
        for (let k = i + 1; k < n; k++) s -= L[k + i * n] * B[at + k];
        B[at + i] = s / L[i + i * n];
      }
    }
    return B;
  },

  // Eigenvalues, ascending, and orthonormal eigenvectors of a symmetric A, which is overwritten: Jacobi's rotations
  // keep the small eigenvalues of graded matrices to full relative accuracy.
  jacobi(A, n, values, V) {
    V.fill(0);
    for (let i = 0; i < n; i++) V[i + i * n] = 1;
    for (let sweep = 0; sweep < 40; sweep++) {
      let turned = false;
      for (let p = 0; p < n - 1; p++) {
        for (let q = p + 1; q < n; q++) {
          const off = A[p + q * n], app = A[p + p * n], aqq = A[q + q * n];
          if (!(off * off > 1.21e-32 * Math.abs(app * aqq))) continue;
          turned = true;
          const half = (aqq - app) / 2;
          const t = (half < 0 ? -off : off) / (Math.abs(half) + Math.sqrt(half * half + off * off));
          const c = 1 / Math.sqrt(1 + t * t), s = t * c;
          A[p + p * n] = app - t * off;
          A[q + q * n] = aqq + t * off;
          A[p + q * n] = A[q + p * n] = 0;
          for (let k = 0; k < n; k++) {
            if (k !== p && k !== q) {
              const x = A[k + p * n], y = A[k + q * n];
              A[k + p * n] = A[p + k * n] = c * x - s * y;
              A[k + q * n] = A[q + k * n] = s * x + c * y;
            }
            const u = V[k + p * n], v = V[k + q * n];
            V[k + p * n] = c * u - s * v;
            V[k + q * n] = s * u + c * v;
          }
        }
      }
      if (!turned) break;
    }
    for (let i = 0; i < n; i++) values[i] = A[i + i * n];
    for (let i = 0; i < n - 1; i++) {
      let least = i;
      for (let k = i + 1; k < n; k++) if (values[k] < values[least]) least = k;
      if (least === i) continue;
      const v = values[i]; values[i] = values[least]; values[least] = v;
      for (let k = 0; k < n; k++) { const x = V[k + i * n]; V[k + i * n] = V[k + least * n]; V[k + least * n] = x; }
    }
  },

  identity(n) { const I = new Float64Array(n * n); for (let i = 0; i < n; i++) I[i + i * n] = 1; return I; },

  // A (m × k) B (k × n).
  multiply(A, B, m, k, n) {
    const C = new Float64Array(m * n);
    for (let j = 0; j < n; j++) {
      for (let l = 0; l < k; l++) {
        const b = B[l + j * k];
        if (b === 0) continue;
        for (let i = 0; i < m; i++) C[i + j * m] += A[i + l * m] * b;
      }
    }
    return C;
  },

  transpose(A, m, n) {
    const B = new Float64Array(m * n);
    for (let j = 0; j < n; j++) for (let i = 0; i < m; i++) B[j + i * n] = A[i + j * m];
    return B;
  },

  // X of A X = B, B (n × columns); A and B stay.
  solve(A, B, n, columns) {
    const L = A.slice(), X = B.slice();
    for (let j = 0; j < n; j++) {
      let p = j;
      for (let i = j + 1; i < n; i++) if (Math.abs(L[i + j * n]) > Math.abs(L[p + j * n])) p = i;
      if (p !== j) {
        for (let k = 0; k < n; k++) { const x = L[j + k * n]; L[j + k * n] = L[p + k * n]; L[p + k * n] = x; }
        for (let c = 0; c < columns; c++) { const x = X[j + c * n]; X[j + c * n] = X[p + c * n]; X[p + c * n] = x; }
      }
      const d = L[j + j * n];
      for (let i = j + 1; i < n; i++) {
        const f = L[i + j * n] / d;
        if (f === 0) continue;
        for (let k = j + 1; k < n; k++) L[i + k * n] -= f * L[j + k * n];
        for (let c = 0; c < columns; c++) X[i + c * n] -= f * X[j + c * n];
      }
    }
    for (let c = 0; c < columns; c++) {
      for (let i = n - 1; i >= 0; i--) {
        let s = X[i + c * n];
        for (let k = i + 1; k < n; k++) s -= L[i + k * n] * X[k + c * n];
        X[i + c * n] = s / L[i + i * n];
      }
    }
    return X;
  },

  // e^A by scaling and squaring, Padé approximant of degree 13. Source: Higham, Functions of Matrices, 2008, 10.3. Balanced
  // first: rows in unlike units would ask for many squarings, each of which rounds.
  exponential(A, n) {
    const { matrix, scale } = this.balance(A, n);
    return this.balancedExponential(matrix, n).map((x, k) => x * scale[k % n] / scale[Math.floor(k / n)]);
  },

  balancedExponential(A, n) {
    let norm = 0;
    for (let j = 0; j < n; j++) {
      let s = 0;
      for (let i = 0; i < n; i++) s += Math.abs(A[i + j * n]);
      if (!(s <= norm)) norm = s;
    }
    if (!isFinite(norm)) return A.map(() => NaN);
    const squarings = Math.max(0, Math.ceil(Math.log2(norm / 5.371920351148152)));
    const X = A.map((x) => x / 2 ** squarings), I = this.identity(n);
    const b = [64764752532480000, 32382376266240000, 7771770303897600, 1187353796428800, 129060195264000,
      10559470521600, 670442572800, 33522128640, 1323241920, 40840800, 960960, 16380, 182, 1];
    const times = (P, Q) => this.multiply(P, Q, n, n, n);
    const X2 = times(X, X), X4 = times(X2, X2), X6 = times(X4, X2);
    const sum = (w6, w4, w2, w0) => X6.map((x, k) => w6 * x + w4 * X4[k] + w2 * X2[k] + w0 * I[k]);
    const odd = times(X6, sum(b[13], b[11], b[9], 0)), even = times(X6, sum(b[12], b[10], b[8], 0));
    const u = sum(b[7], b[5], b[3], b[1]).map((x, k) => x + odd[k]);
    const U = times(X, u), W = sum(b[6], b[4], b[2], b[0]).map((x, k) => x + even[k]);
    let E = this.solve(W.map((x, k) => x - U[k]), W.map((x, k) => x + U[k]), n, n);
    for (let k = 0; k < squarings; k++) E = times(E, E);
    return E;
  },

  // D⁻¹ A D with rows and columns of like size, and the diagonal of D, powers of 2.
  balance(A, n) {
    const B = A.slice(), d = new Float64Array(n).fill(1);
    for (let again = true, round = 0; again && round < 100; round++) {
      again = false;
      for (let i = 0; i < n; i++) {
        let c = 0, r = 0;
        for (let k = 0; k < n; k++) {
          if (k === i) continue;
          c += B[k + i * n] ** 2;
          r += B[i + k * n] ** 2;
        }
        if (!(c > 0) || !(r > 0)) continue;
        c = Math.sqrt(c);
        r = Math.sqrt(r);
        const f = 2 ** Math.round(Math.log2(r / c) / 2);
        if (f === 1 || !(c * f + r / f < 0.95 * (c + r))) continue;
        again = true;
        d[i] *= f;
        for (let k = 0; k < n; k++) { B[k + i * n] *= f; B[i + k * n] /= f; }
      }
    }
    return { matrix: B, scale: d };
  },

  // Singular values, largest first, and right singular vectors as columns of V, by one-sided Jacobi rotations.
  singular(A, n) {
    const U = A.slice(), V = this.identity(n);
    for (let sweep = 0; sweep < 60; sweep++) {
      let turned = false;
      for (let p = 0; p < n - 1; p++) {
        for (let q = p + 1; q < n; q++) {
          let app = 0, aqq = 0, apq = 0;
          for (let k = 0; k < n; k++) {
            const x = U[k + p * n], y = U[k + q * n];
            app += x * x; aqq += y * y; apq += x * y;
          }
          if (!(Math.abs(apq) > 1e-15 * Math.sqrt(app * aqq))) continue;
          turned = true;
          const half = (aqq - app) / 2, t = (half < 0 ? -apq : apq) / (Math.abs(half) + Math.hypot(half, apq));
          const c = 1 / Math.sqrt(1 + t * t), s = t * c;
          for (const X of [U, V]) {
            for (let k = 0; k < n; k++) {
              const x = X[k + p * n], y = X[k + q * n];
              X[k + p * n] = c * x - s * y;
              X[k + q * n] = s * x + c * y;
            }
          }
        }
      }
      if (!turned) break;
    }
    const sizes = Array.from({ length: n }, (_, j) => Math.hypot(...U.subarray(j * n, j * n + n)));
    const order = sizes.map((_, j) => j).sort((i, j) => sizes[j] - sizes[i]);
    const sorted = new Float64Array(n * n);
    order.forEach((j, k) => sorted.set(V.subarray(j * n, j * n + n), k * n));
    return { sizes: order.map((j) => sizes[j]), vectors: sorted };
  },

  // Eigenvalues [real, imaginary] of a real matrix: to Hessenberg form by reflections, then QR steps with Wilkinson's
  // shifts in complex numbers.
  eigenvalues(A, n) {
    const H = A.slice(), at = (i, j) => i + j * n;
    for (let k = 0; k < n - 2; k++) {
      let size = 0;
      for (let i = k + 1; i < n; i++) size = Math.hypot(size, H[at(i, k)]);
      if (size === 0) continue;
      const v = new Float64Array(n), sign = H[at(k + 1, k)] < 0 ? -1 : 1;
      for (let i = k + 1; i < n; i++) v[i] = H[at(i, k)];
      v[k + 1] += sign * size;
      let square = 0;
      for (let i = k + 1; i < n; i++) square += v[i] * v[i];
      for (let j = 0; j < n; j++) {
        let s = 0;
        for (let i = k + 1; i < n; i++) s += v[i] * H[at(i, j)];
        s *= 2 / square;
        for (let i = k + 1; i < n; i++) H[at(i, j)] -= s * v[i];
      }
      for (let i = 0; i < n; i++) {
        let s = 0;
        for (let j = k + 1; j < n; j++) s += H[at(i, j)] * v[j];
        s *= 2 / square;
        for (let j = k + 1; j < n; j++) H[at(i, j)] -= s * v[j];
      }
      for (let i = k + 2; i < n; i++) H[at(i, k)] = 0;
    }
    return this.hessenbergEigenvalues(H, new Float64Array(n * n), n);
  },

  // An eigenvalue [real, imaginary] refined: μ = yᴴ A x / yᴴ x of its left and right vectors by inverse iteration, which
  // errs by the square of what they do.
  refined(A, n, [re, im]) {
    const x = this.eigenvector(A, n, re, im), y = this.eigenvector(this.transpose(A, n, n), n, re, -im);
    const inner = (u, v) => {
      let real = 0, imaginary = 0;
      for (let k = 0; k < n; k++) {
        real += u[k] * v[k] + u[n + k] * v[n + k];
        imaginary += u[k] * v[n + k] - u[n + k] * v[k];
      }
      return [real, imaginary];
    };
    const moved = this.multiply(A, x, n, n, 2), [a, b] = inner(y, moved), [c, d] = inner(y, x), size = c * c + d * d;
    if (!(Math.sqrt(size) > 1e-7)) return [re, im];
    return [(a * c + b * d) / size, (b * c - a * d) / size];
  },

  // A unit x of (A − μ) x = 0: its real parts, then its imaginary ones.
  eigenvector(A, n, re, im) { return this.nullVector(A, n, () => [re, im]); },

  // The like of (A − diag d) x = 0, d(j) = [real, imaginary].
  nullVector(A, n, d) {
    const size = d(0)[1] === 0 ? n : 2 * n, M = new Float64Array(size * size);
    for (let j = 0; j < n; j++) {
      const [re, im] = d(j);
      for (let i = 0; i < n; i++) {
        M[i + j * size] = A[i + j * n] - (i === j ? re * (1 + 1e-14) : 0);
        if (size > n) M[n + i + (n + j) * size] = M[i + j * size];
      }
      if (size > n) { M[j + (n + j) * size] = im; M[n + j + j * size] = -im; }
    }
    let x = Float64Array.from({ length: size }, (_, k) => 1 + 0.1 * Math.sin(k));
    for (let turn = 0; turn < 3; turn++) {
      x = this.solve(M, x, size, 1);
      const length = Math.hypot(...x);
      x = x.map((z) => z / length);
    }
    const whole = new Float64Array(2 * n);
    whole.set(x);
    return whole;
  },

  // To each row another column so that the values (rows × columns, row by row) sum up to the most; −1: none is left.
  // Source: Kuhn's method by shortest ways, Burkard, Dell'Amico and Martello, Assignment Problems, 2009, 4.4.
  assignment(values, rows, columns) {
    const width = Math.max(rows, columns), cost = (i, j) => (j < columns ? -values[i * columns + j] : 0);
    const u = new Float64Array(rows + 1), v = new Float64Array(width + 1), owner = new Array(width + 1).fill(rows);
    for (let row = 0; row < rows; row++) {
      const least = new Array(width).fill(Infinity), before = new Array(width), used = new Array(width + 1).fill(false);
      let at = width;
      owner[width] = row;
      do {
        used[at] = true;
        let next = -1;
        for (let j = 0; j < width; j++) {
          if (used[j]) continue;
          const left = cost(owner[at], j) - u[owner[at]] - v[j];
          if (left < least[j]) { least[j] = left; before[j] = at; }
          if (next < 0 || least[j] < least[next]) next = j;
        }
        const step = least[next];
        for (let j = 0; j <= width; j++) {
          if (used[j]) { u[owner[j]] += step; v[j] -= step; } else least[j] -= step;
        }
        at = next;
      } while (owner[at] !== rows);
      for (; at !== width; at = before[at]) owner[at] = owner[before[at]];
    }
    const found = new Array(rows).fill(-1);
    for (let j = 0; j < columns; j++) if (owner[j] < rows) found[owner[j]] = j;
    return found;
  },

  hessenbergEigenvalues(R, I, n) {
    const at = (i, j) => i + j * n, size = (k) => Math.abs(R[k]) + Math.abs(I[k]), found = new Array(n);
    let high = n - 1, steps = 0;
    while (high >= 0) {
      let low = high;
      while (low > 0 && size(at(low, low - 1)) > 2.3e-16 * (size(at(low, low)) + size(at(low - 1, low - 1)))) low--;
      if (low === high || steps > 300) {
        found[high] = [R[at(high, high)], I[at(high, high)]];
        high--;
        steps = 0;
        continue;
      }
      steps++;
      const [sr, si] = steps % 11 === 10 ? [size(at(high, high - 1)) + R[at(high, high)], I[at(high, high)]]
        : this.shift(R, I, at, high);
      for (let k = low; k <= high; k++) { R[at(k, k)] -= sr; I[at(k, k)] -= si; }
      const turns = [];
      for (let k = low; k < high; k++) {
        // [c̄ s; −s c] with a real s turns (x, y) into (ρ, 0).
        const xr = R[at(k, k)], xi = I[at(k, k)], yr = R[at(k + 1, k)], yi = I[at(k + 1, k)];
        const rho = Math.hypot(xr, xi, yr, yi) || 1;
        const c = [xr / rho, xi / rho], s = [yr / rho, yi / rho];
        turns.push([c, s]);
        for (let j = k; j <= high; j++) {
          const ar = R[at(k, j)], ai = I[at(k, j)], br = R[at(k + 1, j)], bi = I[at(k + 1, j)];
          R[at(k, j)] = c[0] * ar + c[1] * ai + s[0] * br + s[1] * bi;
          I[at(k, j)] = c[0] * ai - c[1] * ar + s[0] * bi - s[1] * br;
          R[at(k + 1, j)] = -(s[0] * ar - s[1] * ai) + c[0] * br - c[1] * bi;
          I[at(k + 1, j)] = -(s[0] * ai + s[1] * ar) + c[0] * bi + c[1] * br;
        }
      }
      turns.forEach(([c, s], index) => {
        const k = low + index;
        for (let i = low; i <= Math.min(k + 1, high); i++) {
          const ar = R[at(i, k)], ai = I[at(i, k)], br = R[at(i, k + 1)], bi = I[at(i, k + 1)];
          R[at(i, k)] = c[0] * ar - c[1] * ai + s[0] * br - s[1] * bi;
          I[at(i, k)] = c[0] * ai + c[1] * ar + s[0] * bi + s[1] * br;
          R[at(i, k + 1)] = -(s[0] * ar + s[1] * ai) + c[0] * br + c[1] * bi;
          I[at(i, k + 1)] = -(s[0] * ai - s[1] * ar) + c[0] * bi - c[1] * br;
        }
      });
      for (let k = low; k <= high; k++) { R[at(k, k)] += sr; I[at(k, k)] += si; }
    }
    return found;
  },

  // The eigenvalue of the last two rows and columns that is nearer to the last entry.
  shift(R, I, at, k) {
    const [a, b, c, d] = [at(k - 1, k - 1), at(k - 1, k), at(k, k - 1), at(k, k)];
    const hr = (R[a] - R[d]) / 2, hi = (I[a] - I[d]) / 2;
    const pr = R[b] * R[c] - I[b] * I[c], pi = R[b] * I[c] + I[b] * R[c];
    let [qr, qi] = this.root(hr * hr - hi * hi + pr, 2 * hr * hi + pi);
    if (hr * qr + hi * qi < 0) { qr = -qr; qi = -qi; }
    // λ = d − bc / (h + √(h² + bc)), the larger denominator.
    const nr = hr + qr, ni = hi + qi, square = nr * nr + ni * ni;
    if (square === 0) return [R[d], I[d]];
    return [R[d] - (pr * nr + pi * ni) / square, I[d] - (pi * nr - pr * ni) / square];
  },

  root(x, y) {
    const size = Math.hypot(x, y), re = Math.sqrt((size + Math.abs(x)) / 2);
    if (re === 0) return [0, 0];
    const im = y / (2 * re);
    return x >= 0 ? [re, im] : [Math.abs(im), y < 0 ? -re : re];
  },
};

// A matrix with its shape, where brevity matters more than time.
class Matrix {
  constructor(m, n, a = new Float64Array(m * n)) { this.m = m; this.n = n; this.a = a; }
  times(B) { return new Matrix(this.m, B.n, Linear.multiply(this.a, B.a, this.m, this.n, B.n)); }
  plus(B) { return new Matrix(this.m, this.n, this.a.map((x, k) => x + B.a[k])); }
  scaled(f) { return new Matrix(this.m, this.n, this.a.map((x) => f * x)); }
  get T() { return new Matrix(this.n, this.m, Linear.transpose(this.a, this.m, this.n)); }
  // Columns from `first` to before `last`.
  columns(first, last) {
    return new Matrix(this.m, last - first, this.a.slice(first * this.m, last * this.m));
  }
  block(i, j, m, n) {
    const B = new Matrix(m, n);
    for (let c = 0; c < n; c++) for (let r = 0; r < m; r++) B.a[r + c * m] = this.a[i + r + (j + c) * this.m];
    return B;
  }
  put(i, j, B) {
    for (let c = 0; c < B.n; c++) for (let r = 0; r < B.m; r++) this.a[i + r + (j + c) * this.m] = B.a[r + c * B.m];
    return this;
  }
}
