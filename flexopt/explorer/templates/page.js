"use strict";
// The page: what is dragged, typed and slid, and what it shows of it. One pass for each frame in which something moved.

// Of a frame for the map, ms: while something is dragged, and else.
const MAP_BUDGET = [6, 12];
// A key moves by this share of the machine's size, or of a joint's range; with Shift so many times that.
const STEP = 0.004, FAR = 8;
// A picture turns so much, rad, for a pixel that is dragged, and ten times that for a key.
const TURN = 0.008;
const ARROW = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

// What the arrow keys do to an element, from the way that one points, to the right and up.
function onArrows(element, act) {
  element.addEventListener("keydown", (e) => {
    if (!(e.key in ARROW)) return;
    e.preventDefault();
    act(ARROW[e.key], e);
  });
}

class Explorer extends Pictures {
  constructor(data, graphs) {
    super();
    this.data = data;
    this.model = new Model(data, graphs);
    this.loop = new Loop(this.model);
    this.map = new JointMap(this.model, this.loop);
    this.meshes = new MeshPainter(data.meshes);
    this.rows = data.rows.map((name) => "xyz".indexOf(name));
    this.mode = 0;
    const sought = /^w(\d+)$/.exec(data.objective ?? "");
    this.measure = sought ? Number(sought[1]) - 1 : data.n_passive > 1 ? SUM : 0;
    this.axes = data.joints.length < 2 ? null : data.dimensions === 2 || data.joints.length < 3 ? [0, 1] : [1, 2];
    this.factors = { kp: 1, kv: 1, ki: 1, soil: 1 };
    this.payload = data.payload === null ? null : data.parameters[data.payload];
    this.deadTime = data.loop.dead_time;
    this.changed = true;
    this.playing = null;
    this.log = { frames: [], maps: [], verdict: 0 };
    this.makeViews();
    this.makeControls();
    this.go("present" in data.configurations ? "present" : Object.keys(data.configurations)[0]);
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (e) => this.setTheme(e.matches ? "dark" : "light"));
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) $("motion").value = "off";
    // Paper is light; a browser that prints does not wait for a frame.
    const paper = (theme) => { this.setTheme(theme); this.draw(performance.now()); };
    addEventListener("beforeprint", () => { this.onScreen = document.documentElement.dataset.theme; paper("light"); });
    addEventListener("afterprint", () => paper(this.onScreen));
    new ResizeObserver(() => { this.resized = true; this.wake(); }).observe($("views"));
    this.resized = true;
    this.wake();
  }

  // Configuration.

  go(name) {
    const { base, posture } = this.data.configurations[name];
    this.base = Float64Array.from(base);
    this.posture = Float64Array.from(posture);
    this.target = Array.from(this.model.endPoint(this.base, this.posture));
    this.note = "";
    this.touched(true);
  }

  touched(refit = false) {
    this.changed = true;
    this.refit ||= refit;
    this.wake();
  }

  // The arm to a target; where it does not reach, as near as it comes.
  moveEnd(target) {
    const { posture, error } = this.model.place(target, this.base, this.posture);
    this.posture = posture;
    const short = !(error <= 1e-6 * this.data.size);
    this.target = short ? Array.from(this.model.endPoint(this.base, posture)) : target;
    this.note = short ? "Out of reach, or beyond a joint's limit: this is the nearest point." : "";
    this.touched();
  }

  // The base to a placement, the end-point kept; where it cannot be kept, the base stays.
  moveBase(base) {
    const { posture, error } = this.model.place(this.target, base, this.posture);
    if (!(error <= 1e-6 * this.data.size)) {
      this.note = "From there the arm does not reach the end-point: the base stays.";
    } else {
      this.base = Float64Array.from(base);
      this.posture = posture;
      this.note = "";
    }
    this.touched();
  }

  movePosture(posture) {
    posture.forEach((x, k) => {
      const [low, high] = this.data.limits[k];
      posture[k] = Math.min(high ?? Infinity, Math.max(low ?? -Infinity, x));
    });
    this.posture = posture;
    this.target = Array.from(this.model.endPoint(this.base, posture));
    this.note = "";
    this.touched();
  }

  get gains() {
    const found = { dead_time: this.deadTime };
    for (const name of ["kp", "kv", "ki"]) found[name] = this.data.loop.numbers[name].map((x) => this.factors[name] * x);
    return found;
  }

  // Views and handles.

  makeViews() {
    const d = this.data.dimensions;
    this.views = d === 2 ? [new View("", 2, true)] : [new View("in space: drag to turn", 3, true), new View("from above", 3, false)];
    for (const view of this.views) {
      $("views").append(view.box);
      if (view.turns) { this.turning(view); $("turns").hidden = false; }
      view.end = this.handle(view, "end", "End-point: drag it, or move it with the arrow keys");
      if (this.data.placement.some((name) => "xy".includes(name))) view.stand = this.handle(view, "base", "Base: drag it, or move it with the arrow keys; the end-point stays");
    }
  }

  // The picture is turned by what is dragged beside the handles, and by the arrow keys.
  turning(view) {
    const { canvas } = view, turn = (azimuth, elevation) => { view.turn(azimuth, elevation, this.shape.points[0]); this.touched(); };
    Object.assign(canvas, { tabIndex: 0, className: "turning" });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The machine in space; the arrow keys turn it");
    let last = null;
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); last = [e.clientX, e.clientY]; });
    canvas.addEventListener("pointermove", (e) => {
      if (last === null) return;
      turn(-TURN * (e.clientX - last[0]), TURN * (e.clientY - last[1]));
      last = [e.clientX, e.clientY];
    });
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, () => { last = null; });
    onArrows(canvas, (way) => turn(...way.map((x) => 10 * TURN * x)));
  }

  handle(view, kind, label) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = `handle ${kind}`;
    button.setAttribute("aria-label", view.name ? `${label} (${view.name})` : label);
    button.title = label;
    view.box.append(button);
    let last = null;
    button.addEventListener("pointerdown", (e) => {
      button.setPointerCapture(e.pointerId);
      button.focus({ preventScroll: true });
      last = { x: e.clientX, y: e.clientY, target: this.target.slice(), base: Float64Array.from(this.base) };
      this.dragged = true;
      e.preventDefault();
    });
    button.addEventListener("pointermove", (e) => {
      if (last !== null) this.pull = { view, kind, from: last, dx: e.clientX - last.x, dy: e.clientY - last.y };
      if (last !== null) this.wake();
    });
    const drop = () => { last = null; this.dragged = false; this.released = true; this.touched(); };
    button.addEventListener("pointerup", drop);
    button.addEventListener("pointercancel", drop);
    onArrows(button, (way, e) => {
      const far = view.scale * STEP * this.data.size * (e.shiftKey ? FAR : 1);
      const move = (kind === "end" ? view.risen : view.level).call(view, far * way[0], -far * way[1]);
      this.released = true;
      this.moveBy(kind, { target: this.target, base: this.base }, move);
    });
    return button;
  }

  moveBy(kind, from, move) {
    if (kind === "end") {
      this.moveEnd(from.target.map((x, k) => x + (this.rows[k] < 0 ? 0 : move[this.rows[k]])));
    } else {
      const base = Float64Array.from(from.base);
      this.data.placement.forEach((name, k) => { if ("xy".includes(name)) base[k] += move["xy".indexOf(name)]; });
      this.moveBase(base);
    }
  }

  // Controls.

  slider(box, { label, low, high, value, show, set, step = "any" }) {
    const row = document.createElement("label"), text = document.createElement("span");
    const input = document.createElement("input"), output = document.createElement("output");
    text.textContent = label;
    Object.assign(input, { type: "range", min: low, max: high, step, value });
    input.setAttribute("aria-label", label);
    row.append(text, input, output);
    box.append(row);
    const put = (x) => { if (document.activeElement !== input || Math.abs(input.value - x) > 1e-9) input.value = x; output.textContent = show(x); };
    input.addEventListener("input", () => { set(Number(input.value)); output.textContent = show(Number(input.value)); });
    // Steps of keys on a slider without steps are one of a hundred.
    onArrows(input, (way) => {
      input.value = Number(input.value) + (way[0] + way[1]) * (high - low) / 100;
      input.dispatchEvent(new Event("input"));
    });
    put(value);
    return put;
  }

  makeControls() {
    const { data } = this, box = $("sliders");
    $("subtitle").textContent = data.description;
    if (data.loop.drive !== "torque") {
      $("kappa").innerHTML = ", more than the damping of the mode and of the joints' servos takes out (grows) once g Kv, the same in all rows, exceeds the κ<sub>iso</sub> that then stands beside it, g the servo gain";
    }
    $("unit").textContent = `w and |a||b| in ${data.unit === "mixed" ? "mixed units" : data.unit.replace("kg m2", "kg m²")}; Jacobian ${data.control} control.`;
    const turned = data.rows.filter((_, k) => this.rows[k] < 0);
    if (turned.length) $("unit").textContent += ` Angles count ${turned.join(", ")}, too, of which arrows show nothing.`;
    const gain = (name) => {
      const numbers = data.loop.numbers[name], same = numbers.every((x) => x === numbers[0]);
      const show = (x) => (same ? `${digits(numbers[0] * 10 ** x)} ${data.loop.units[name]}` : `× ${digits(10 ** x)}`);
      const set = (x) => { this.factors[name] = 10 ** x; this.touched(); };
      return this.slider(box, { label: { kp: "gain Kp", kv: "gain Kv", ki: "gain Ki" }[name], low: -2, high: 2, value: 0, show, set });
    };
    this.put = { };
    for (const name of ["kp", "kv", "ki"]) if (data.loop.numbers[name].some((x) => x > 0)) this.put[name] = gain(name);
    this.put.dead = this.slider(box, {
      label: "dead time", low: 0, high: data.loop.dead_time_max, value: this.deadTime,
      show: (x) => `${digits(1e3 * x)} ms`, set: (x) => { this.deadTime = x; this.touched(); },
    });
    const parameters = () => { this.model.setParameters(this.factors.soil, this.payload); this.touched(); };
    if (data.payload !== null) {
      this.put.payload = this.slider(box, {
        label: "payload", low: 0, high: data.payload_max, value: this.payload,
        show: (x) => `${digits(x)} kg`, set: (x) => { this.payload = x; parameters(); },
      });
    }
    this.put.soil = this.slider(box, {
      label: "soil, all springs", low: -1, high: 1, value: 0,
      show: (x) => `× ${digits(10 ** x)}`, set: (x) => { this.factors.soil = 10 ** x; parameters(); },
    });
    const sources = Object.entries(data.loop.sources).map(([name, why]) => `${name}: ${why}`).join("; ");
    $("loop").textContent = `Loop at the start: ${inDigits(data.loop.description)}.${sources ? ` Not given: ${sources}.` : ""}`;
    this.makeConfiguration();
    this.makeMapControls();
    this.makeModes();
    $("motion").addEventListener("change", () => { this.playing = null; this.wake(); });
    for (const id of ["show-map", "show-arrows", "show-meshes"]) $(id).addEventListener("change", () => this.touched());
    $("map-shown").hidden = data.dimensions !== 2 || this.axes === null;
    $("meshes-shown").hidden = data.meshes.length === 0;
    $("meshes-note").textContent = data.meshes_note;
    $("fit").addEventListener("click", () => this.touched(true));
    $("theme").addEventListener("click", () => this.setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
    $("reset").addEventListener("click", () => this.reset());
    if ("recommended" in data.configurations) $("help").append(` Faint orange: the recommended configuration, the best by ${data.by} (a verdict looks at other candidates, too, and may prefer one)${data.which && `, the same placement for all targets, at ${data.which}`}; cross: ${data.which ? "that" : "the"} target.`);
    $("recommend").hidden = !("recommended" in data.configurations);
    $("recommend").addEventListener("click", () => this.go("recommended"));
  }

  reset() {
    Object.assign(this.factors, { kp: 1, kv: 1, ki: 1, soil: 1 });
    this.payload = this.data.payload === null ? null : this.data.parameters[this.data.payload];
    this.deadTime = this.data.loop.dead_time;
    for (const name of ["kp", "kv", "ki", "soil"]) this.put[name]?.(0);
    this.put.dead(this.deadTime);
    this.put.payload?.(this.payload);
    this.model.setParameters(1, this.payload);
    this.go("present" in this.data.configurations ? "present" : Object.keys(this.data.configurations)[0]);
  }

  makeConfiguration() {
    const { data } = this, unit = (u) => (u === "rad" ? " rad" : " m");
    const whole = { x: data.size, y: data.size, yaw: Math.PI };
    this.putBase = data.placement.map((name, k) => this.slider($("joints"), {
      label: `base ${name}`, low: -whole[name], high: whole[name], value: 0, show: (x) => digits(coordinate(x)) + unit(data.placement_units[k]),
      set: (x) => { const base = Float64Array.from(this.base); base[k] = x; this.moveBase(base); },
    }));
    this.putJoints = data.joints.map((name, k) => this.slider($("joints"), {
      label: name, low: data.ranges[k][0], high: data.ranges[k][1], value: 0, show: (x) => digits(coordinate(x)) + unit(data.joint_units[k]),
      set: (x) => { const posture = Float64Array.from(this.posture); posture[k] = x; this.movePosture(posture); },
    }));
  }

  makeMapControls() {
    const { data } = this, choice = (value, text) => new Option(text, value);
    if (data.n_passive > 1) $("measure").append(choice(SUM, this.map.weights.every((x) => x === 1) ? "V = Σ w" : "V = Σ αw"));
    for (let i = 0; i < data.n_passive; i++) $("measure").append(choice(i, `w${i + 1}`));
    $("measure").append(choice(DECAY, "decay of the loop"));
    $("measure").value = this.measure;
    $("measure").addEventListener("change", () => { this.measure = Number($("measure").value); this.recolour = true; this.wake(); });
    if (this.axes === null) {
      $("map-part").hidden = true;
      return;
    }
    ["map-x", "map-y"].forEach((id, axis) => {
      data.joints.forEach((name, k) => $(id).append(choice(k, name)));
      $(id).value = this.axes[axis];
      $(id).addEventListener("change", () => {
        const chosen = Number($(id).value);
        if (chosen === this.axes[1 - axis]) this.axes[1 - axis] = this.axes[axis];
        this.axes[axis] = chosen;
        ["map-x", "map-y"].forEach((other, k) => { $(other).value = this.axes[k]; });
        this.touched();
      });
    });
    const canvas = $("map"), set = (u, v) => {
      const posture = Float64Array.from(this.posture);
      [u, v].forEach((x, k) => { const [low, high] = data.ranges[this.axes[k]]; posture[this.axes[k]] = low + (high - low) * Math.min(1, Math.max(0, x)); });
      this.movePosture(posture);
    };
    const point = (e) => { const box = canvas.getBoundingClientRect(), { left, top, width, height } = this.frame; set((e.clientX - box.left - left) / width, 1 - (e.clientY - box.top - top) / height); };
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); point(e); });
    canvas.addEventListener("pointermove", (e) => { if (canvas.hasPointerCapture(e.pointerId)) point(e); });
    onArrows(canvas, (way, e) => {
      set(...this.axes.map((joint, k) => {
        const [low, high] = data.ranges[joint];
        return (this.posture[joint] - low) / (high - low) + way[k] * 0.005 * (e.shiftKey ? FAR : 1);
      }));
    });
  }

  makeModes() {
    const body = $("modes").tBodies[0];
    this.cells = Array.from({ length: this.data.n_passive }, (_, i) => {
      const row = body.insertRow(), button = document.createElement("button");
      button.type = "button";
      button.textContent = i + 1;
      button.style.borderLeftColor = `var(--series-${(i % INKS.series.length) + 1})`;
      button.setAttribute("aria-label", `show mode ${i + 1}`);
      row.insertCell().append(button);
      for (let k = 0; k < 5; k++) row.insertCell();
      row.addEventListener("click", () => { this.mode = i; this.playing = null; this.touched(); });
      return row;
    });
  }

  setTheme(name) {
    document.documentElement.dataset.theme = name;
    $("theme").textContent = name === "dark" ? "◑ Light" : "◐ Dark";
    const style = getComputedStyle(document.documentElement), get = (key) => style.getPropertyValue(`--${key}`).trim();
    this.theme = {
      present: get("present"), chosen: get("chosen"), base: get("base"), undercarriage: get("undercarriage"), edge: get("edge"),
      ground: get("ground"), groundLine: get("ground-line"), text: get("text"), muted: get("muted"), halo: get("halo"),
      series: INKS.series.map((_, k) => get(`series-${k + 1}`)),
    };
    this.touched();
  }

  // Frames.

  wake() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => { this.waiting = false; this.frameAt(now); });
  }

  frameAt(now) {
    const begun = performance.now();
    if (this.pull) {
      const { view, kind, from, dx, dy } = this.pull;
      this.pull = null;
      this.moveBy(kind, from, (kind === "end" ? view.world : view.level).call(view, dx, dy));
    }
    if (this.changed) this.recompute(now);
    if (this.resized) this.layout();
    // What is let go of must be within reach of the next drag.
    if (this.refit || (this.released && this.views.some((view) => this.beyond(view)))) this.fit();
    if (this.axes !== null) {
      // A frame computes a part of the map or draws a new one, not both.
      if (!this.recolour) {
        this.map.want(this.base, this.posture, ...this.axes, this.measure === DECAY ? this.gains : null);
        if (this.map.step(MAP_BUDGET[this.dragged ? 0 : 1])) {
          this.fresh = true;
          this.log.maps.push(this.map.milliseconds);
        }
      }
      if (this.fresh || this.map.job !== null) this.wake();
      if (this.recolour && this.map.colour(this.measure)) this.legend();
    }
    this.draw(now);
    this.changed = this.resized = this.refit = this.released = false;
    this.recolour = this.fresh;
    this.fresh = false;
    this.log.frames.push(performance.now() - begun);
    if (this.log.frames.length > 2000) this.log.frames.splice(0, 1000);
    if (this.log.first === undefined) this.log.first = performance.now();
    if ($("motion").value !== "off" && this.modes && !document.hidden) this.wake();
  }

  recompute(now) {
    const { model, base, posture } = this;
    this.rest = Float64Array.from(model.rest(base, posture));
    this.modes = model.modes(base, posture);
    this.shape = shapeOf(model, this.rest, base);
    this.ghosts = Object.entries(this.data.configurations).filter(([name]) => name !== "present").map(([, at]) => {
      const [b, q] = [Float64Array.from(at.base), Float64Array.from(at.posture)];
      return { shape: shapeOf(model, Float64Array.from(model.rest(b, q)), b), posture: q };
    });
    this.judge();
    this.tell();
    this.playing = null;
    this.phase ??= now;
  }

  judge() {
    const begun = performance.now();
    this.verdict = this.modes && this.loop.verdict(this.base, this.posture, this.gains);
    this.become = this.modes && this.loop.ofModes(this.base, this.posture, this.gains, this.modes, this.verdict);
    this.log.verdict = performance.now() - begun;
  }

  // Words and numbers.

  tell() {
    const { modes, verdict, data } = this, box = $("verdict");
    let word = "undecided", sentence = "Within rounding of neither growth nor decay.";
    if (!modes) {
      sentence = this.model.held ? "Singular posture: the end-point cannot be moved in every direction. Bend the arm."
        : "The springs do not hold the machine's weight in this posture.";
    } else if (verdict.decay === -Infinity) {
      [word, sentence] = ["grows", "Beyond the largest number within one sample."];
    } else if (!(Math.abs(verdict.decay) <= verdict.rounding)) {
      word = verdict.decay > 0 ? "settles" : "grows";
      sentence = `The slowest motion oscillates at ${digits(verdict.hz)} Hz.`;
      if (verdict.hz === 0) sentence = "The slowest motion does not oscillate.";
      const drift = Math.max(...verdict.drift, -Infinity);
      if (drift > verdict.rounding) sentence += ` Apart from it the arm's self-motion grows at ${digits(drift)} /s.`;
    }
    box.className = word;
    const rate = word === "undecided" || verdict.decay === -Infinity ? "" : ` at ${digits(Math.abs(verdict.decay))} /s`;
    const mark = { grows: "▲\u00a0", settles: "▼\u00a0", undecided: "" }[word];
    box.replaceChildren();
    const strong = document.createElement("strong");
    strong.innerHTML = `<span class="word">${mark}${word}</span>${rate}`;
    box.append("With this controller the sampled loop ", strong, ". ", sentence);
    $("note").textContent = this.note;
    this.cells.forEach((row, i) => {
      const cells = Array.from(row.cells);
      row.classList.toggle("chosen", i === this.mode);
      if (!modes) { cells.slice(1).forEach((cell) => { cell.textContent = "–"; }); return; }
      const { hz, w, size, angle, dot, kappa, alone } = modes[i], { decay, fails } = this.become[i];
      if (this.unreached(i)) {
        [digits(hz), "–", "–", "–"].forEach((text, k) => { cells[k + 2].textContent = text; });
        cells[1].textContent = "does not move the end-point, or is not driven";
        return;
      }
      const shown = Math.abs(w) > data.rounding * size ? w : 0;
      const numbers = [digits(hz), alone ? `${digits(angle * 180 / Math.PI)}°` : "one frequency with another", digits(shown), digits(size)];
      numbers.forEach((text, k) => { cells[k + 2].textContent = text; });
      const { drive, numbers: { servo_gain: served } } = this.data.loop, torque = drive === "torque";
      const each = torque ? 1 : served[0], gain = torque ? "Kv" : "g Kv", level = each * Math.max(...this.gains.kv);
      const excited = dot < 0, state = !excited ? "settles" : level > kappa ? "grows" : "excited";
      const mark = { grows: "▲ grows", excited: "△ excited", settles: "▼ settles" }[state];
      const bound = kappa > 0 ? `grows if ${gain} > κ<sub>iso</sub> = ${digits(kappa)}; it is ${digits(level)}` : "at any Kv > 0";
      // This word leaves Kp and lag out, so that it may say the other thing where the first order with these does not fail.
      const other = Math.abs(decay) > verdict.rounding && (decay < 0) !== (state === "grows");
      const does = isNaN(decay) ? "no oscillation is left of it" : `it ${decay > 0 ? "decays" : "grows"} at ${digits(Math.abs(decay))} /s`;
      const doubt = (fails || other || isNaN(decay)) && `feedback, servos or dampers are too strong or late for this first order: in the sampled loop ${does}`;
      cells[1].innerHTML = `<span class="word ${state}">${mark}</span><span class="kappa">${[excited && bound, doubt].filter(Boolean).join(" – ")}</span>`;
    });
    this.putBase.forEach((put, k) => put(this.base[k]));
    this.putJoints.forEach((put, k) => put(this.posture[k]));
    document.body.dataset.word = word;
    $("recommend").disabled = !("recommended" in data.configurations);
  }

  // Whether rounding alone is left of how a mode moves the end-point, or of how feedback drives it.
  unreached(i) { return this.modes[i].size <= this.data.unreached * Math.max(...this.modes.map((mode) => mode.size)); }

  legend() {
    const canvas = $("bar"), c = canvas.getContext("2d");
    for (let x = 0; x < canvas.width; x++) {
      c.fillStyle = `rgb(${this.map.shades[Math.floor(256 * x / canvas.width)].join()})`;
      c.fillRect(x, 0, 1, canvas.height);
    }
    const { worst, shown } = this.map, decay = this.measure === DECAY;
    $("worst").textContent = decay ? `grows at ${digits(-worst)} /s and more` : `≤ ${digits(worst)}`;
    $("middle").textContent = decay ? "0" : digits(worst / 4);
    $("best").textContent = decay ? `settles at ${digits(-worst)} /s and more` : "0, robust";
    const others = this.data.joints.filter((_, k) => !this.axes.includes(k));
    const held = others.length ? ` Held as now: ${others.join(", ")}.` : "";
    const where = this.data.dimensions === 2 ? " In the picture of the machine each cell lies where the end-point is, the arm bent to the present side." : "";
    const side = CELLS / shown.stride, loop = decay ? " The slowest motion of the sampled loop as the sliders have it." : "";
    $("map-note").textContent = `${side} × ${side} postures, computed exactly at each cell's middle; blank: singular${this.data.weight ? ", or not held" : ""}.${loop}${held}${where}`;
  }
}

window.explorer = new Explorer(DATA, GRAPHS);
