"use strict";
// The machine: its graphs, and what is no graph. Draws nothing.

const CONDITION_MAX = 1e6, NOTHING = new Float64Array(0);

class Model {
  constructor(data, graphs) {
    this.data = data;
    this.graphs = graphs;
    this.m = data.n_passive;
    this.r = data.n_task;
    this.n = data.joints.length;
    this.n_b = data.placement.length;
    this.p = Float64Array.from(data.parameters);
    this.held = true;
    const { m, r } = this;
    this.scratch = {
      L: new Float64Array(m * m), X: new Float64Array(m * m), S: new Float64Array(m * m), z: new Float64Array(m * m),
      squares: new Float64Array(m), phi: new Float64Array(m * m), f: new Float64Array(2 * r * m),
      turned: new Float64Array(2 * r * m), row: new Float64Array(m), sum: new Float64Array(r * r),
      least: new Float64Array(r), vectors: new Float64Array(r * r), w: new Float64Array(m),
    };
  }

  // The machine's own parameters with springs times `soil` and another payload, kg.
  setParameters(soil, payload) {
    this.p.set(this.data.parameters);
    for (const k of this.data.springs) this.p[k] *= soil;
    if (this.data.payload !== null && payload !== null) this.p[this.data.payload] = payload;
  }

  unloaded(base, posture) { return this.graphs.unloaded.run([base, posture, this.p]).q; }
  // Passive coordinates under the weight, by Newton's steps; none where the page leaves the weight out.
  deflection(base, posture) {
    const { weight } = this.data;
    if (weight === null) return NOTHING;
    let q = this.unloaded(base, posture).slice(0, this.m);
    for (let step = 0; step < weight.steps; step++) {
      const next = this.graphs.sink.run([q, base, posture, this.p]).next.slice();
      const moved = next.some((x, k) => Math.abs(x - q[k]) > 1e-15 * this.data.size);
      q = next;
      if (!moved) break;
    }
    return q;
  }

  // A graph about rest, under the weight where the page has it.
  about(name, base, posture) { return this.graphs[name].run([base, posture, this.p, this.deflection(base, posture)]); }
  // Where it would fall without end, without its weight.
  rest(base, posture) {
    const { q } = this.about("rest", base, posture);
    return q.every(Number.isFinite) ? q : this.unloaded(base, posture);
  }
  skeleton(q, base) { return this.graphs.skeleton.run([q, base, this.p]).points; }
  endPoint(base, posture) { return this.about("reach", base, posture).r; }

  // w_i into `scratch.w`, ω² and φ_p beside them; false in a singular posture, or one that the springs do not hold. One
  // arithmetic for maps and tables.
  solve(base, posture) {
    const { m, r } = this, c = this.scratch, at = this.about("reduced", base, posture), { weight } = this.data;
    Linear.cholesky(at.K, m, c.L);
    this.held = weight === null || (at.left_over[0] <= weight.tolerance && c.L[m * m - 1] > 0);
    if (!this.held) return false;
    if (!this.data.damped && !(at.screen[0] > 1 / CONDITION_MAX ** 2)) return false;
    // With K = L Lᵀ and X = M̄⁻¹ L the symmetric S = Lᵀ X has S z = ω² z, and φ = X z / ω.
    c.X.set(c.L);
    Linear.cholesky(at.M, m, c.S);
    Linear.choleskySolve(c.S, m, c.X, m);
    for (let j = 0; j < m; j++) {
      for (let i = 0; i <= j; i++) {
        let s = 0, t = 0;
        for (let k = 0; k < m; k++) { s += c.L[k + i * m] * c.X[k + j * m]; t += c.L[k + j * m] * c.X[k + i * m]; }
        c.phi[i + j * m] = c.phi[j + i * m] = (s + t) / 2;
      }
    }
    c.S.set(c.phi);
    Linear.jacobi(c.S, m, c.squares, c.z);
    for (let i = 0; i < m; i++) {
      const omega = Math.sqrt(c.squares[i]);
      for (let k = 0; k < m; k++) {
        let s = 0;
        for (let l = 0; l < m; l++) s += c.X[k + l * m] * c.z[l + i * m];
        c.phi[k + i * m] = s / omega;
      }
      for (let k = 0; k < 2 * r; k++) {
        let s = 0;
        for (let l = 0; l < m; l++) s += at.F[k + l * 2 * r] * c.phi[l + i * m];
        c.f[k + i * 2 * r] = s;
      }
    }
    for (let i = 0; i < m; i++) this.measure(i);
    return true;
  }

  measure(i) {
    const { m, r } = this, c = this.scratch;
    let place = 1, alone = true;
    c.turned.set(c.f.subarray(i * 2 * r, (i + 1) * 2 * r));
    c.row.fill(0);
    c.row[0] = 1;
    for (let k = 0; k < m; k++) {
      if (k === i) continue;
      c.turned.set(c.f.subarray(k * 2 * r, (k + 1) * 2 * r), place * 2 * r);
      if (this.together(i, k)) { c.row[place] = 1; alone = false; }
      place++;
    }
    if (!alone) {
      c.sum.set(this.graphs.symmetric.run([c.turned, c.row]).S);
      Linear.jacobi(c.sum, r, c.least, c.vectors);
    }
    c.w[i] = this.graphs.measure.run([c.turned, c.row, c.vectors]).w[0];
    return alone;
  }

  // Whether two frequencies are one: neighbours from the one to the other are.
  together(i, k) {
    const s = this.scratch.squares;
    for (let j = Math.min(i, k); j < Math.max(i, k); j++) {
      if (!(s[j + 1] - s[j] <= this.data.cluster_tolerance * (s[j + 1] + s[j]) / 2)) return false;
    }
    return true;
  }

  // D with the damping of velocity servos, a copy; null of joints that have none.
  braked(base, posture) {
    const { braking } = this.data.loop;
    if (braking === null) return null;
    const p = this.p.map((x, k) => x + braking[k]);
    return this.graphs.more.run([base, posture, p, this.deflection(base, posture)]).D.slice();
  }

  // All that is shown of the modes in a configuration; null in a singular posture.
  modes(base, posture) {
    if (!this.solve(base, posture)) return null;
    const { m, r, n } = this, c = this.scratch, braked = this.braked(base, posture);
    const { follow, D } = this.about("more", base, posture);
    return Array.from({ length: m }, (_, i) => {
      const a = Array.from(c.f.subarray(i * 2 * r, i * 2 * r + r)), b = Array.from(c.f.subarray(i * 2 * r + r, (i + 1) * 2 * r));
      const passive = c.phi.subarray(i * m, (i + 1) * m), q = m + n, shape = new Float64Array(q);
      shape.set(passive);
      for (let k = 0; k < n; k++) for (let l = 0; l < m; l++) shape[m + k] += follow[k + l * n] * passive[l];
      const damped = (by) => {
        let sum = 0;
        for (let k = 0; k < q; k++) for (let l = 0; l < q; l++) sum += shape[k] * by[k + l * q] * shape[l];
        return sum;
      };
      const damping = damped(D), served = braked === null ? damping : damped(braked);
      const omega = Math.sqrt(c.squares[i]), dot = a.reduce((s, x, k) => s + x * b[k], 0);
      const size = Math.hypot(...a) * Math.hypot(...b);
      let alone = true;
      for (let k = 0; k < m; k++) alone = alone && (k === i || !this.together(i, k));
      return {
        omega, hz: omega / (2 * Math.PI), zeta: damping / (2 * omega), own: served / 2, w: c.w[i], a, b, dot, size, shape, alone,
        kappa: dot < 0 ? served / -dot : Infinity,
        angle: Math.acos(Math.max(-1, Math.min(1, dot / size))),
      };
    });
  }

  // The posture that puts the end-point nearest to a target, near a posture, within the limits: damped Newton steps.
  place(target, base, posture, steps = 60) {
    const { r, n, n_b } = this, q = Float64Array.from(posture), limits = this.data.limits;
    const away = (point) => target.map((t, k) => t - point[k]), size = (e) => Math.hypot(...e);
    let now = this.about("reach", base, q);
    let e = away(now.r), J = now.J.slice(), error = size(e), damping = 1e-6;
    for (let step = 0; step < steps && error > 1e-13 * this.data.size; step++) {
      const free = Array.from({ length: n }, (_, j) => {
        let g = 0;
        for (let k = 0; k < r; k++) g += J[k + (n_b + j) * r] * e[k];
        const [low, high] = limits[j];
        return !((low !== null && q[j] <= low && g < 0) || (high !== null && q[j] >= high && g > 0));
      });
      const gram = new Float64Array(r * r);
      let trace = 0;
      for (let j = 0; j < n; j++) {
        if (!free[j]) continue;
        const at = (n_b + j) * r;
        for (let k = 0; k < r; k++) {
          for (let l = 0; l < r; l++) gram[k + l * r] += J[at + k] * J[at + l];
          trace += J[at + k] ** 2;
        }
      }
      if (trace === 0) break;
      for (let k = 0; k < r; k++) gram[k + k * r] += damping * trace;
      const y = Linear.solve(gram, Float64Array.from(e), r, 1), next = Float64Array.from(q), move = new Float64Array(n);
      for (let j = 0; j < n; j++) if (free[j]) for (let k = 0; k < r; k++) move[j] += J[k + (n_b + j) * r] * y[k];
      const longest = Math.max(...move.map(Math.abs)), cut = longest > 0.5 ? 0.5 / longest : 1;
      for (let j = 0; j < n; j++) {
        const [low, high] = limits[j];
        next[j] += cut * move[j];
        if (low !== null) next[j] = Math.max(low, next[j]);
        if (high !== null) next[j] = Math.min(high, next[j]);
      }
      now = this.about("reach", base, next);
      const left = away(now.r), tried = size(left);
      if (tried < error) {
        const gained = 1 - tried / error;
        q.set(next); e = left; error = tried; J = now.J.slice();
        damping = Math.max(1e-15, damping * (gained > 0.5 ? 0.05 : 0.5));
        if (gained < 1e-6 && damping > 1e-3) break;
      } else {
        damping *= 20;
        if (damping > 1e6) break;
      }
    }
    return { posture: q, error };
  }
}

// The loop for small motions, sampled: the counterpart of flexopt's loop/assembly.py and loop/spectrum.py.
class Loop {
  constructor(model) { this.model = model; this.data = model.data.loop; }

  // One sample's Φ of x = [s, law, forces on their way], how many states s and the law have, forces there are, and samples
  // they are on their way.
  sample(base, posture, numbers) {
    const { outputs } = this.model.graphs.motions, values = this.graph("motions", base, posture, numbers);
    const P = Object.fromEntries(outputs.map(([name, m, n]) => [name, new Matrix(m, n, values[name].slice())]));
    const { flow, drive, direct, spread, force, law, measured } = P, T = this.data.period;
    const n = flow.m, k = law.m, r = force.m, [waiting, early] = this.waiting(numbers.dead_time);
    const span = (h) => {
      const size = n + drive.n, block = new Matrix(size, size).put(0, 0, flow.scaled(h)).put(0, n, drive.scaled(h));
      const E = new Matrix(size, size, Linear.exponential(block.a, size));
      return [E.block(0, 0, n, n), E.block(0, n, n, drive.n)];
    };
    const [held, push] = span(T), [held2, push2] = early > 0 ? span(T - early) : [held, push];
    const oldest = waiting ? r : 0, size = n + k + r * waiting;
    const ofState = early > 0 ? measured.times(held2.plus(push2.times(direct))) : measured;
    const ofForce = early > 0 ? measured.times(push2).times(spread) : new Matrix(measured.m, r);
    const asked = law.columns(k, law.n), drawn = force.columns(k, force.n), open = new Matrix(size, size);
    open.put(0, 0, held.plus(push.times(direct))).put(n, 0, asked.times(ofState)).put(n, n, law.columns(0, k));
    if (waiting) {
      open.put(0, n + k, push.times(spread)).put(n, n + k, asked.times(ofForce));
      for (let j = n + k; j < size - r; j++) open.a[j + (j + r) * size] = 1;
    }
    const into = new Matrix(size, r), F = new Matrix(r, size);
    if (waiting) for (let j = 0; j < r; j++) into.a[size - r + j + j * size] = 1;
    else into.put(0, 0, push.times(spread));
    F.put(0, 0, drawn.times(ofState)).put(0, n, force.columns(0, k));
    if (oldest) F.put(0, n + k, drawn.times(ofForce));
    return { matrix: open.plus(into.times(F)), states: n + k, r, waiting };
  }

  // What a graph of the loop gives.
  graph(name, base, posture, numbers) {
    const { graphs, p } = this.model, { run, inputs } = graphs[name];
    const given = { base, posture, p, held: this.model.deflection(base, posture), period: [this.data.period], ...this.data.numbers, ...numbers };
    return run(inputs.map(([name, size]) => given[name] ?? new Float64Array(size)));
  }

  waiting(deadTime) {
    const samples = deadTime / this.data.period, whole = Math.round(samples);
    if (Math.abs(samples - whole) <= this.data.part_of_sample) return [whole, 0];
    return [Math.floor(samples) + 1, deadTime - Math.floor(samples) * this.data.period];
  }

  // Decay of the slowest motion, 1/s, its frequency, and what nearer to zero is neither growth nor decay; the sample and its
  // multipliers. `rough`: to the digits that a colour shows.
  verdict(base, posture, numbers, rough = false) {
    const sample = this.sample(base, posture, numbers), { matrix } = sample, T = this.data.period, size = matrix.m;
    if (!matrix.a.every(isFinite)) return { decay: -Infinity, hz: NaN, rounding: 0, drift: [], sample, values: [] };
    const { matrix: balanced, scale } = Linear.balance(matrix.a, size);
    let M = new Matrix(size, size, balanced), U = new Matrix(size, size, Linear.identity(size)), most = this.data.neutral;
    for (let round = 0; round < 2 && most; round++) {
      const shifted = M.plus(new Matrix(M.n, M.n, Linear.identity(M.n)).scaled(-1));
      const { sizes, vectors } = Linear.singular(shifted.a, M.n);
      most = sizes.slice(-most).filter((s) => s < this.data.invariant * sizes[0]).length;
      const kept = new Matrix(M.n, M.n, vectors).columns(0, M.n - most).T;
      M = kept.times(M).times(kept.T);
      U = kept.times(U);
    }
    // The real ones among them come with a rounded imaginary part.
    let values = Linear.eigenvalues(M.a, M.n).map(([x, y]) => [x, Math.abs(y) <= 1e-11 * Math.abs(x) ? 0 : y]);
    // Other directions that rest anywhere are of integrals and rows without gain.
    const removed = Math.max(size - M.n - (this.data.neutral - this.data.excess), 0), drift = [];
    if (this.data.excess > 0 && removed < 2 * this.data.excess) {
      const own = this.drifting(base, posture, numbers, M, U, scale, values, 2 * this.data.excess - removed);
      own.forEach((k) => drift.push(Math.log(values[k][0]) / T));
      values = values.filter((_, k) => !own.includes(k));
    }
    const found = values.reduce((x, y) => (Math.hypot(...y) > Math.hypot(...x) ? y : x));
    const slowest = rough ? found : Linear.refined(balanced, size, found);
    return {
      decay: -Math.log(Math.hypot(...slowest)) / T, hz: Math.abs(Math.atan2(slowest[1], slowest[0])) / (2 * Math.PI * T),
      rounding: 10 * size * 2.220446049250313e-16 * Math.hypot(...balanced) / T, drift, sample, values,
    };
  }

  // Of each mode its decay in the sampled loop, 1/s, NaN where no oscillation is left of it, to first order under the late
  // feedback, NaN of one that shares its frequency, and whether that fails: flexopt's LoopPoint.poles, LaggedModes and
  // Outcome.first_order_fails.
  ofModes(base, posture, numbers, modes, verdict) {
    const { M, Jv } = this.model.about("own", base, posture), exact = this.modeDecays(modes, verdict, M), { rounding } = verdict;
    const all = (part) => Float64Array.from(modes.flatMap(part)), { run, inputs } = this.model.graphs.first_order;
    const given = {
      own: all((x) => x.own), omega: all((x) => x.omega), a: all((x) => x.a), joints: all((x) => [...x.shape.subarray(this.model.m)]),
      Jv, period: [this.data.period], ...this.data.numbers, ...numbers, dead_time: [numbers.dead_time],
    };
    const found = run(inputs.map(([name, size]) => given[name] ?? new Float64Array(size))).first_order_decay;
    return modes.map(({ alone }, i) => {
      const first = alone ? found[i] : NaN, decay = exact[i];
      const off = Math.abs(first - decay) > Math.min(Math.abs(first), Math.abs(decay)) + rounding;
      return { first, decay, fails: off || (isNaN(decay) && isFinite(first)) };
    });
  }

  // Of the oscillations to which modes are given so that the shares of the modes' springs in their energy sum up to the most.
  modeDecays(modes, { sample: { matrix, states, r, waiting }, values }, M) {
    const T = this.data.period, strains = this.data.strains, q = this.model.m + this.model.n;
    // Of the forces on their way the oldest alone: after `waiting` samples each is the newest.
    const size = states + (waiting ? r : 0), held = new Matrix(size, size).put(0, 0, matrix.block(0, 0, states, size));
    if (waiting) held.put(states, 0, matrix.block(matrix.m - r, 0, r, size));
    const { matrix: balanced, scale } = Linear.balance(held.a, size);
    const toQ = new Matrix(q, q, Float64Array.from(this.data.to_q)), mass = new Matrix(q, q, M.slice());
    const shapes = new Matrix(q, modes.length, Float64Array.from(modes.flatMap((x) => [...x.shape])));
    const poles = values.filter(([x, y]) => y > 0 || (y === 0 && x < 0)).map(([x, y]) => {
      const size = Math.log(Math.hypot(x, y)), angle = Math.atan2(y, x);
      return { x, y, decay: -size / T, speed: Math.hypot(size, angle) / T, late: [Math.exp(waiting * size), waiting * angle] };
    });
    // Of a faster one no springs have their share: it is at most ω²/(ω² + |s|²).
    const slow = poles.filter(({ speed }) => speed < Math.max(...modes.map((x) => x.omega)) / Math.sqrt(strains));
    const shares = slow.flatMap(({ x, y, speed, late: [far, turn] }) => {
      const late = y === 0 ? [far * Math.cos(turn), 0] : [far * Math.cos(turn), far * Math.sin(turn)];
      const v = Linear.nullVector(balanced, size, (j) => (j < states ? [x, y] : late));
      const parts = [0, size].map((at) => toQ.times(new Matrix(q, 1, v.slice(at, at + q).map((z, k) => z * scale[k]))));
      const moved = parts.map((part) => mass.times(part)), along = moved.map((part) => shapes.T.times(part).a);
      const moving = speed ** 2 * parts.reduce((sum, part, k) => sum + part.T.times(moved[k]).a[0], 0);
      const strained = modes.map(({ omega }, i) => omega ** 2 * (along[0][i] ** 2 + along[1][i] ** 2));
      const whole = strained.reduce((sum, x) => sum + x, moving);
      return strained.map((x) => x / Math.max(whole, Number.MIN_VALUE));
    });
    const share = (i, j) => shares[j * modes.length + i];
    const ordered = modes.flatMap((_, i) => slow.map((_, j) => share(i, j)));
    return Linear.assignment(ordered, modes.length, slow.length).map((j, i) => (j >= 0 && share(i, j) > strains ? slow[j].decay : NaN));
  }

  // Which eigenvalues belong to an arm that drifts along its self-motion: real ones, and its the kinetic energy. Pairs are
  // none where the controller knows the weight, as here.
  drifting(base, posture, numbers, M, U, scale, values, most) {
    const { m, r, n } = this.model, data = this.model.data, q = m + n;
    const at = this.model.about("own", base, posture), mass = new Matrix(q, q, at.M.slice());
    const square = new Matrix(n, n).put(0, 0, new Matrix(r, n, at.Jv.slice()));
    const alone = new Matrix(q, n - r).put(m, 0, new Matrix(n, n, Linear.singular(square.a, n).vectors).columns(r, n));
    const sets = [alone, ...this.creeping(base, posture, numbers)].map((own) => ({ own, inner: own.T.times(mass).times(own) }));
    const toQ = new Matrix(q, q, Float64Array.from(data.loop.to_q));
    const shares = values.map(([x, y], index) => {
      if (y !== 0 || x <= 0) return { index, share: 0 };
      const v = Linear.eigenvector(M.a, M.n, x, 0).subarray(0, M.n);
      const lifted = U.T.times(new Matrix(M.n, 1, v)).a.map((z, k) => z * scale[k]);
      const rates = toQ.times(new Matrix(q, 1, lifted.slice(q, 2 * q))), whole = rates.T.times(mass).times(rates).a[0];
      const [part, ...creeps] = sets.map(({ own, inner }) => {
        const along = own.T.times(mass).times(rates);
        return along.T.times(new Matrix(n - r, 1, Linear.solve(inner.a, along.a, n - r, 1))).a[0];
      });
      const onBase = new Matrix(q, 1).put(0, 0, rates.block(0, 0, m, 1)), base = onBase.T.times(mass).times(onBase).a[0];
      return { index, share: Math.max(part, ...creeps.map((x) => Math.min(x, whole - base))) / Math.max(whole, Number.MIN_VALUE) };
    });
    return shares.filter(({ share }) => share > data.loop.own).sort((x, y) => y.share - x.share).slice(0, most).map((x) => x.index);
  }

  // Under the weight along what the loop comes to rest all the way, the base and the end-point as they then are.
  creeping(base, posture, numbers) {
    if (!this.model.graphs.resting_rows) return [];
    const { m, r, n } = this.model, q = m + n, square = new Float64Array(q * q), { rows } = this.graph("resting_rows", base, posture, numbers);
    for (let i = 0; i < m + r; i++) {
      const row = Array.from({ length: q }, (_, j) => rows[i + j * (m + r)]), size = Math.hypot(...row);
      row.forEach((x, j) => { square[i + j * q] = x / size; });
    }
    return square.every(Number.isFinite) ? [new Matrix(q, q, Linear.singular(square, q).vectors).columns(m + r, q)] : [];
  }
}
