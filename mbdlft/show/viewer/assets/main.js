"use strict";
/* The page: parameters and positions, the tree of names, layers, modes. */

(function start() {
  const data = JSON.parse(document.getElementById("data").textContent);
  const p = Float64Array.from(data.parameters, (parameter) => parameter.value);
  const q = new Float64Array(data.coordinates.length);
  const follow = new Set(data.loops ? data.loops.follow : []);
  const factors = Float64Array.from(data.coordinates, (one) => one.turns ? 180 / Math.PI : 1);
  let world = null, mode = null, step = null, loads = null, positions = [], readers = [];

  function note(text) {
    const line = make("p", text, "note");
    find("notes").append(line);
    return line;
  }
  data.notes.forEach(note);
  const warning = note("");

  // where everything is ----------------------------------------------------------------------

  function trim() {
    const u = data.trim ? trimmed(data.trim, p) : null;
    loads = u && { u, visible: true, sizes: [0, 0], largest: (turns) => loads.sizes[turns ? 1 : 0] };
    positions = interpret(data.positions, p, q);
    if (plane) poles();
  }

  /** The largest force and the largest torque at equilibrium, to which arrows are scaled. */
  function measure(vectors) {
    loads.sizes = [1e-300, 1e-300];
    data.items.forEach((item) => item.shapes.forEach((shape) => {
      if (shape.effort === undefined) return;
      const long = Math.hypot(...vectors.slice(3 * shape.along, 3 * shape.along + 3)), kind = shape.turns || shape.type === "torque" ? 1 : 0;
      loads.sizes[kind] = Math.max(loads.sizes[kind], Math.abs(loads.u[shape.effort]) * long);
    }));
  }

  function place() {
    let gap = 0;
    if (data.loops) gap = closeLoops(data.loops, p, q);
    warning.textContent = gap > 1e-9 * data.size ? "A loop cannot be closed at these positions." : "";
    const vectors = interpret(data.tape, p, q);
    if (world) {
      if (loads) {
        loads.visible = world.layers.get("equilibrium") !== false;
        measure(vectors);
      }
      world.show(vectors, loads);
    }
    return vectors;
  }

  function update() {
    place();
    readers.forEach((read) => read());
  }

  // poles and step responses -----------------------------------------------------------------

  const samples = data.modes.map((sample) => sample.modes.map((one) => [one.real, one.imag]));
  const plane = data.linear && data.linear.states ? polePlane(find("plane"), [{ kind: "sample", poles: samples.flat(), title: "poles at samples of the parameters" }, ...data.others]) : null;
  let linear = null, found = [];
  find("poles").hidden = find("modes").hidden = !plane;
  find("response").hidden = !plane || !data.linear.inputs.length || !data.linear.outputs.length;

  /** The poles at the values of the sliders. */
  function poles() {
    linear = linearAt(data.linear, p, loads && loads.u);
    found = (linear && eigenvalues(linear.A)) || [];
    plane.show(found);
    if (!found.length) { find("stable").textContent = "There is no linear model at these values."; return; }
    const swinging = found.filter(([x, y]) => y > 0 && Math.hypot(x, y) > plane.least), damping = ([x, y]) => -x / Math.hypot(x, y);
    const least = swinging.reduce((best, one) => (best && damping(best) <= damping(one) ? best : one), null);
    find("stable").textContent = `Largest real part ${short(Math.max(...found.map(([x]) => x)))} rad/s` + (least ? `; least damping ${short(damping(least))} at ${short(Math.hypot(...least))} rad/s.` : ".");
  }

  /** How long a step is looked at (s): three periods of the slowest pole, or less where it grows. */
  function horizon() {
    const sizes = found.map(([x, y]) => Math.hypot(x, y)).filter((size) => size > plane.least), grows = Math.max(0, ...found.map(([x]) => x));
    return Math.min(6 * Math.PI / (sizes.length ? Math.min(...sizes) : 1), grows > plane.least ? 8 / grows : Infinity);
  }

  function play(begin = performance.now()) {
    stop();
    if (!linear) return;
    const input = Number(find("input").value), output = Number(find("output").value), last = horizon(), count = 400, seconds = 8;
    const { times, x, y } = stepResponse(linear, input, last / (count - 1), count), read = data.linear.outputs[output], given = data.linear.inputs[input];
    const beside = data.others.flatMap((other) => {
      const [i, j] = [other.inputs.indexOf(given.name), other.outputs.indexOf(read.name)];
      return i < 0 || j < 0 ? [] : [stepResponse(other, i, last / (count - 1), count).y.map((row) => row[j])];
    });
    const move = curveOf(find("curve"), times, y.map((row) => row[output]), read.unit, beside);
    const shapes = x.filter((_, k) => k % 10 === 9).map((row) => row.slice(0, data.states.length));
    const amount = amplitude(shapes), speed = seconds / last;
    find("played").textContent = `A step of 1 ${given.unit}; the motion is drawn ${short(amount)} times as large and ${speed >= 1 ? `${short(speed)} times slower` : `${short(1 / speed)} times faster`}.`;
    const one = step = { begin };
    find("play").textContent = "stop";
    (function frame(now) {
      if (step !== one) return;
      const k = Math.min(count - 1, Math.floor((count - 1) * (Math.max(0, now - begin) / 1000 % (seconds + 1)) / seconds));
      data.states.forEach((number, i) => { q[number] = amount * x[k][i]; });
      place();
      move(k);
      requestAnimationFrame(frame);
    })(begin);
  }

  /** What is played goes on with other values or signals. */
  function replay() {
    if (step) play(step.begin);
  }

  [["input", data.linear && data.linear.inputs], ["output", data.linear && data.linear.outputs]].forEach(([id, signals]) => {
    (signals || []).forEach((signal, k) => find(id).append(new Option(signal.name, k)));
    find(id).addEventListener("change", replay);
  });
  find("play").addEventListener("click", () => (step ? (stop(), q.fill(0), update()) : play()));

  // sliders ----------------------------------------------------------------------------------

  function setParameter(k, value) {
    p[k] = value;
    trim();
    list();
    replay();
    update();
  }

  data.parameters.forEach((parameter, k) => {
    const { name, unit, low, high, nominal, role } = parameter;
    const title = `${spelled(low, unit)} to ${spelled(high, unit)}, nominal ${spelled(nominal, unit)}, ${role}`;
    const show = sliderRow("parameters", name, unit, [low, high], (value) => setParameter(k, value), { title });
    readers.push(() => show(p[k], p[k]));
  });
  find("parameters").parentElement.hidden = !data.parameters.length; // no stop of Tab before the sliders

  data.coordinates.forEach((one, k) => {
    if (follow.has(k)) return;
    const unit = one.turns && !one.elastic ? "deg" : one.unit, factor = one.elastic ? 1 : factors[k];
    const reach = one.elastic ? 0.1 * data.size : one.reach, origin = () => (one.placed ? positions[k] : 0);
    const title = `up to ${spelled(factor * reach, unit)} to either side of the equilibrium`;
    const show = sliderRow(one.elastic ? "deformations" : "positions", one.name, unit, [-reach, reach], (value) => {
      stop();
      q[k] = value;
      update();
    }, { title, toSlider: (value) => value / factor - origin() });
    readers.push(() => show(q[k], factor * (q[k] + origin())));
  });
  const sliders = roving(find("sliders"), 'input[type="range"]', "ArrowUp", "ArrowDown");
  find("skip").addEventListener("click", (event) => {
    event.preventDefault();
    find("parameters").closest("details").open = true;
    sliders();
    (find("sliders").querySelector('input[tabindex="0"]') ?? find("reset")).focus();
  });
  find("positions").parentElement.hidden = !find("positions").childElementCount;
  find("elastic").hidden = !data.coordinates.some((one) => one.elastic);

  function reset() {
    if (!step) stop();
    q.fill(0);
    data.parameters.forEach((parameter, k) => { p[k] = parameter.nominal; });
    trim();
    list();
    replay();
    update();
  }
  find("reset").addEventListener("click", reset);

  // the tree ---------------------------------------------------------------------------------

  const buttons = [];
  function pick(number) {
    const item = data.items[number], info = find("info");
    buttons.forEach((button, k) => button.classList.toggle("picked", k === number));
    if (buttons[number].checkVisibility()) buttons[number].scrollIntoView({ block: "nearest" });
    find("panel").scrollTop = find("panel").contains(document.activeElement) ? find("panel").scrollTop : 0;
    if (world) world.highlight(number);
    info.replaceChildren(make("h2", `${item.name} (${item.kind})`));
    item.lines.filter((line) => line).forEach((line) => info.append(make("p", line)));
    if (loads) {
      const own = data.trim.efforts.flatMap((effort, k) => effort.name.startsWith(`${item.name}.`) ? [[effort, loads.u[k]]] : []);
      own.forEach(([effort, value]) => info.append(make("p", `at equilibrium: ${effort.name} = ${spelled(value, effort.unit)}`)));
    }
  }
  const groups = new Map();
  data.items.forEach((item, number) => {
    if (!groups.has(item.group)) {
      const folder = make("details");
      folder.open = true;
      folder.append(make("summary", item.group));
      find("tree").append(folder);
      groups.set(item.group, folder);
    }
    const button = make("button", item.name);
    button.type = "button";
    button.append(make("small", ` ${item.kind}`));
    button.addEventListener("click", () => pick(number));
    groups.get(item.group).append(button);
    buttons.push(button);
  });
  roving(find("tree"), "button", "ArrowUp", "ArrowDown");

  const modes = roving(find("rows"), "button", "ArrowUp", "ArrowDown");

  // modes ------------------------------------------------------------------------------------

  /** The sample whose values are nearest, in parts of the ranges. */
  function nearest() {
    const far = (sample) => Math.hypot(...sample.point.map((value, k) => (value - p[k]) / (data.parameters[k].high - data.parameters[k].low)));
    return data.modes.reduce((best, sample) => (far(sample) < far(best) ? sample : best));
  }

  /** The modes at the values of the sliders. Those at zero, which have no shapes of their own, are those of the nearest sample. */
  function list() {
    if (!plane) return;
    const rows = find("rows"), played = mode && mode.row, size = (one) => Math.hypot(one.real, one.imag);
    const still = nearest().modes.filter((one) => size(one) === 0);
    const moving = found.filter(([real, imag]) => imag >= 0 && Math.hypot(real, imag) > plane.least).map(([real, imag]) => ({ real, imag })).sort((a, b) => size(a) - size(b));
    rows.replaceChildren();
    [...still, ...moving].slice(0, 40).forEach((one, k) => {
      const row = make("tr"), swings = one.imag > 0, cell = make("td"), button = Object.assign(make("button", String(k + 1)), { type: "button" });
      button.setAttribute("aria-label", `mode ${k + 1}, ${short(size(one))} rad/s`);
      button.setAttribute("aria-pressed", "false");
      cell.append(button);
      row.append(cell, make("td", short(size(one))), make("td", swings ? short(size(one) / (2 * Math.PI)) : "-"), make("td", size(one) > 0 ? short(-one.real / size(one)) : "-"));
      if (one.real > 1e-9 * size(one)) row.classList.add("unstable");
      one.row = k;
      row.addEventListener("click", () => mode === one ? (stop(), update()) : animate(one, row));
      rows.append(row);
      if (played === k) animate(one, row, mode.begin);
    });
    modes();
  }

  /** Leads the sliders to values of all parameters. */
  function lead(point) {
    point.forEach((value, k) => { p[k] = value; });
    trim();
    list();
    replay();
    update();
  }
  data.places.forEach(({ title, point }) => {
    const button = Object.assign(make("button", title), { type: "button" });
    button.addEventListener("click", () => lead(point));
    find("places").append(button);
  });

  function mark(row, on) {
    row.classList.toggle("picked", on);
    row.querySelector("button").setAttribute("aria-pressed", on);
  }

  function stop() {
    mode = step = null;
    find("play").textContent = "play";
    find("rows").querySelectorAll("tr").forEach((row) => mark(row, false));
    find("moving").textContent = "";
  }

  /** Displacements of a mode of the size `amount` at a phase; loops are closed when it is drawn. */
  function swing(one, amount, phase) {
    q.fill(0);
    data.states.forEach((k, i) => { q[k] = amount * (one.shape[0][i] * Math.cos(phase) - one.shape[1][i] * Math.sin(phase)); });
  }

  /** By what displacements (arrays by state) are multiplied so that they can be seen, and are not too large. */
  function amplitude(shapes) {
    q.fill(0);
    const rest = place(), largest = Math.max(...shapes.flat().flat().map(Math.abs), 1e-300), tiny = 1e-4 / largest;
    let way = 0, turn = 0;
    for (const shape of shapes) {
      data.states.forEach((k, i) => { q[k] = tiny * shape[i]; });
      const moved = place();
      (world ? world.points : []).forEach((k) => { way = Math.max(way, Math.hypot(...[0, 1, 2].map((i) => moved[3 * k + i] - rest[3 * k + i]))); });
      data.coordinates.forEach((c, k) => { if (c.turns) turn = Math.max(turn, Math.abs(q[k])); });
    }
    return tiny * Math.min(way > 0 ? 0.12 * data.size / way : Infinity, turn > 0 ? 0.5 / turn : Infinity, 1e10);
  }

  function animate(one, row, begin = performance.now()) {
    stop();
    one.shape ??= shapeOf(linear.A, [one.real, one.imag], data.states.length);
    const amount = amplitude(one.shape);
    mode = Object.assign(one, { begin });
    mark(row, true);
    const size = Math.hypot(one.real, one.imag);
    const grows = one.real > 1e-9 * size ? `, grows with ${short(one.real)} rad/s` : one.real < -1e-9 * size ? `, decays with ${short(-one.real)} rad/s` : ", no damping";
    find("moving").textContent = (one.imag > 0 ? `${short(size)} rad/s, damping ${short(-one.real / size)}` : "does not swing; its shape is shown") + `${grows}. Shown at 0.5 Hz, of a size that can be seen.`;
    (function frame(now) {
      if (mode !== one) return;
      swing(one, amount, Math.PI * (now - begin) / 1000);
      place();
      requestAnimationFrame(frame);
    })(begin);
  }

  // the picture ------------------------------------------------------------------------------

  try {
    const library = window.viewerLibrary;
    world = makeWorld(library.ThreeJsProvider?.THREE ?? library, data, find("picture"), pick);
  } catch (error) {
    note(`The picture needs WebGL, which this browser does not give: ${error.message}`);
    find("shown").hidden = find("tools").hidden = true;
  }
  const drawn = new Set(data.items.flatMap((item) => item.shapes.map((shape) => shape.layer)));
  const hidden = new Set(["frames", drawn.has("meshes") ? "solids" : ""]);
  ["bodies", "meshes", "solids", "joints", "loads", "equilibrium", "sensors", "centers of mass", "ports", "frames", "ground", "grid", "names"].forEach((layer) => {
    if (["meshes", "solids"].includes(layer) && !drawn.has(layer)) return;
    const row = make("label", "", "layer"), box = make("input"), text = { equilibrium: "loads at equilibrium", ground: "ground and gravity", solids: "shapes, or solids of this mass and inertia" }[layer] ?? layer;
    Object.assign(box, { type: "checkbox", checked: !hidden.has(layer) });
    box.addEventListener("change", () => { world.layer(layer, box.checked); place(); });
    row.append(box, make("span", text + (layer === "grid" && world ? ` of ${spelled(world.cell, "m")}` : "")));
    find("layers").append(row);
    if (world) world.layer(layer, box.checked);
  });
  if (world) toolBar(world, data.name);
  trim();
  list();
  update();
  sliders();
  if (world) world.fit();
  if (data.response) {
    find("response").open = true;
    play();
  }

  /* What scripts and tests may ask for. */
  window.mbdlft = {
    set(name, value) {
      const k = data.parameters.findIndex((one) => one.name === name), j = data.coordinates.findIndex((one) => one.name === name);
      if (k >= 0) setParameter(k, value);
      else if (j >= 0) { q[j] = value; update(); } else throw new Error(`nothing is called ${name}`);
    },
    placement: (body) => world.placement(body),
    box: (body) => world.box(body),
    loads: () => loads && Object.fromEntries(data.trim.efforts.map((effort, k) => [effort.name, loads.u[k]])),
    coordinates: () => Object.fromEntries(data.coordinates.map((one, k) => [one.name, q[k]])),
    drawn: () => { world.render(); return world.drawn(); },
    cover: () => world.cover(),
    outside: () => world.outside(),
    pixel: (k) => world.pixelOf(k),
    pick: (name) => pick(data.items.findIndex((item) => item.name === name)),
    look: (azimuth, height) => { world.view.look(azimuth, height); world.fit(); },
    poles: () => found,
    shape: (pole) => shapeOf(linear.A, pole, data.states.length),
    step: (input, dt, count) => stepResponse(linear, input, dt, count).y,
    reset,
  };
})();
