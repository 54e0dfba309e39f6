"use strict";
/* The picture: light, camera, the objects of all items, and what is picked with the mouse. */

/** A camera that turns about a point: left button turns, right button or shift moves, wheel and two fingers zoom; arrow keys, + and -, too. */
function orbit(T, camera, canvas, size, up, changed) {
  const target = new T.Vector3(), state = { azimuth: 0.9, height: 0.35, distance: 2.2 * size };
  const turn = new T.Quaternion().setFromUnitVectors(new T.Vector3(0, 0, 1), up);
  function apply() {
    const { azimuth, height, distance } = state;
    const away = new T.Vector3(Math.cos(height) * Math.cos(azimuth), Math.cos(height) * Math.sin(azimuth), Math.sin(height));
    camera.position.copy(target).addScaledVector(away.applyQuaternion(turn), distance);
    camera.up.copy(up);
    camera.near = distance / 1000;
    camera.far = distance * 100 + 10 * size;
    camera.lookAt(target);
    camera.updateMatrixWorld();
    camera.updateProjectionMatrix();
    changed();
  }
  const fingers = new Map();
  let way = 0;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 1) way = 0;
    canvas.setPointerCapture(event.pointerId);
  });
  ["pointerup", "pointercancel"].forEach((kind) => canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId)));
  const span = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
  };
  function zoom(amount) {
    state.distance *= Math.exp(amount);
    apply();
  }
  function shift(dx, dy) {
    const scale = state.distance / canvas.clientHeight, [right, above] = [0, 1].map((k) => new T.Vector3().setFromMatrixColumn(camera.matrix, k));
    target.addScaledVector(right, -dx * scale).addScaledVector(above, dy * scale);
    apply();
  }
  function rotate(dx, dy) {
    state.azimuth -= 0.008 * dx;
    state.height = Math.max(-1.5, Math.min(1.5, state.height + 0.008 * dy));
    apply();
  }
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const dx = event.clientX - last[0], dy = event.clientY - last[1], before = fingers.size === 2 && span();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    way += Math.abs(dx) + Math.abs(dy);
    if (before) {
      shift(dx / 2, dy / 2);
      zoom(Math.log(before / span()));
    } else if (event.buttons & 2 || event.shiftKey) shift(dx, dy);
    else rotate(dx, dy);
  });
  canvas.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [20, 0], ArrowRight: [-20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] }[event.key];
    if (way) (event.shiftKey ? shift : rotate)(...way);
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? -0.1 : 0.1);
    else return;
    event.preventDefault();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(0.001 * Math.max(-200, Math.min(200, event.deltaY)));
  }, { passive: false });
  return {
    moved: () => way > 4,
    look(azimuth, height) { Object.assign(state, { azimuth, height }); apply(); },
    fit(points, margin, corners) { /* the smallest distance at which all points, and corners, which need no margin, are in the picture */
      const box = new T.Box3().setFromPoints([...points, ...corners]), high = Math.tan(camera.fov * Math.PI / 360);
      box.getCenter(target);
      apply();
      const [right, above, back] = [0, 1, 2].map((k) => new T.Vector3().setFromMatrixColumn(camera.matrix, k));
      const needed = (point, more) => {
        const from = point.clone().sub(target), [x, y] = [right, above].map((axis) => Math.abs(from.dot(axis)) + more);
        return from.dot(back) + Math.max(y / high, x / (high * camera.aspect));
      };
      state.distance = Math.max(...points.map((one) => needed(one, margin)), ...corners.map((one) => needed(one, 0.02 * size)), 0.1 * size);
      apply();
    },
  };
}

/** Lines on the ground through the origin, whose `cell` is a round number of meters. */
function gridOf(T, size, up) {
  const power = 10 ** Math.floor(Math.log10(size / 4)), cell = [5, 2, 1].find((one) => one * power <= size / 4) * power;
  const count = 2 * Math.ceil(0.75 * size / cell) + 2, grid = new T.GridHelper(count * cell, count);
  Object.assign(grid.material, { vertexColors: false, transparent: true, opacity: 0.5 });
  grid.quaternion.setFromUnitVectors(new T.Vector3(0, 1, 0), up);
  return Object.assign(grid, { cell });
}

/** A line between the two drawn points that were clicked last, and what is told of it. */
function ruler(T, { points, pixel, canvas, at, tell, draw }) {
  const chosen = [], geometry = new T.BufferGeometry(), line = new T.Line(geometry, new T.LineBasicMaterial({ color: 0xff8800, depthTest: false }));
  const places = new T.BufferAttribute(new Float32Array(6), 3);
  geometry.setAttribute("position", places);
  line.frustumCulled = false;
  function update() {
    chosen.forEach((k, place) => places.setXYZ(place, ...at(k).toArray()));
    places.needsUpdate = true;
    geometry.setDrawRange(0, chosen.length);
    if (chosen.length < 2) return;
    const between = at(chosen[1]).clone().sub(at(chosen[0]));
    tell(`${spelled(between.length(), "m")}; along x, y, z: ${between.toArray().map((part) => spelled(Math.abs(part) < 1e-12 * between.length() ? 0 : part, "m")).join(", ")}`);
  }
  return {
    line, update,
    click(event) {
      const box = canvas.getBoundingClientRect(), far = (k) => {
        const place = pixel(at(k));
        return place ? Math.hypot(place[0] - event.clientX + box.left, place[1] - event.clientY + box.top) : Infinity;
      };
      const nearest = points.reduce((best, k) => (far(k) < far(best) ? k : best), points[0]);
      if (chosen.length === 2) chosen.length = 0;
      chosen.push(nearest);
      if (chosen.length === 1) tell("And the second point.");
      update();
      draw();
    },
  };
}

/** The drawn scene; `show(v, loads)` moves it. Throws an error where the browser has no WebGL. */
function makeWorld(T, data, host, picked) {
  T.ColorManagement.enabled = false; // colors are linear
  const renderer = new T.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  const scene = new T.Scene(), camera = new T.PerspectiveCamera(35, 1, 0.1, 100);
  const shapes = data.items.flatMap((item) => item.shapes), itemNames = new Set(data.items.map((item) => item.name));
  const make = shapeMaker(T, data.size, opacities(shapes.filter((shape) => shape.layer === "solids"), data.size)), layers = new Map(), objects = [], frames = new Map();
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${data.name} in space; arrow keys turn it, plus and minus zoom`);
  scene.add(new T.HemisphereLight(0xffffff, 0x9aa0aa, 1.5));
  const lamp = new T.DirectionalLight(0xffffff, 1.1);
  scene.add(lamp);
  host.append(canvas);
  const names = labelLayer(host), project = new T.Vector3();
  let queued = false;
  function render() {
    queued = false;
    lamp.position.copy(camera.position);
    renderer.render(scene, camera);
    const [origin, ...boxes] = [host, ...document.querySelectorAll("#tools button, #said, .note")].map((one) => one.getBoundingClientRect());
    const moved = boxes.map(({ left, top, right, bottom }) => ({ left: left - origin.left, top: top - origin.top, right: right - origin.left, bottom: bottom - origin.top }));
    names.draw(host.clientWidth, host.clientHeight, moved);
  }
  /** Where a point is in the picture (pixels), or null outside of it. */
  function pixel(point) {
    const { x, y, z } = project.copy(point).project(camera);
    return z < 1 && Math.abs(x) < 1 && Math.abs(y) < 1 ? [(0.5 + 0.5 * x) * host.clientWidth, (0.5 - 0.5 * y) * host.clientHeight] : null;
  }
  /** Draws picture and names on a canvas, which gets the size of the picture. */
  function compose(sheet) {
    render();
    if (sheet.width !== canvas.width || sheet.height !== canvas.height) Object.assign(sheet, { width: canvas.width, height: canvas.height });
    const context = sheet.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(canvas, 0, 0);
    context.scale(window.devicePixelRatio, window.devicePixelRatio);
    names.paint(context);
  }
  const draw = () => { if (!queued) { queued = true; requestAnimationFrame(render); } };
  const up = new T.Vector3(...data.up), view = orbit(T, camera, canvas, data.size, up, draw);
  const points = [], boxes = [], dark = window.matchMedia("(prefers-color-scheme: dark)");
  const grid = gridOf(T, data.size, up);
  scene.add(grid);
  let v = () => new T.Vector3();
  data.items.forEach((item, number) => {
    const color = COLORS.bodies[number % COLORS.bodies.length];
    item.shapes.forEach((shape) => {
      const object = make(shape, color);
      object.userData.item = number;
      object.userData.layer = shape.layer;
      if (shape.geometry && shape.geometry.extent) boxes.push(shape);
      if (shape.type === "frame") frames.set(item.name, object);
      scene.add(object);
      objects.push(object);
      const whole = ["stick", "curve", "line", "spring"].includes(shape.type);
      points.push(...(whole ? shape.points : [[shape.at].flat()[0]]).flat());
    });
    const named = item.shapes.find((shape) => shape.type !== "frame");
    if (named && item.group !== "world" && item.kind !== "fixed") label(item.name, [named.at ?? named.points].flat(), named.layer, item.group);
    item.shapes.filter((shape) => shape.label && !itemNames.has(shape.label)).forEach((shape) => label(shape.label, [shape.at], "ports", "port"));
  });
  function label(text, numbers, layer, kind) {
    const middle = kind === "bodies" && numbers.length > 1;
    const at = () => middle ? v(numbers[0]).clone().add(v(numbers[numbers.length - 1])).multiplyScalar(0.5) : v(numbers[0]);
    names.add(text, kind, () => (layers.get("names") && layers.get(layer) ? pixel(at()) : null));
  }
  function theme() {
    scene.background = new T.Color(getComputedStyle(document.documentElement).getPropertyValue("--paper"));
    grid.material.color.setHex(dark.matches ? 0x4a5260 : 0xbcc3cd);
    paintInk(dark.matches);
    draw();
  }
  dark.addEventListener("change", theme);
  function cornersOf(shape) {
    const [r, ...axes] = shape.at.map(v), { extent } = shape.geometry;
    return [0, 1, 2, 3, 4, 5, 6, 7].map((k) => axes.reduce((at, axis, i) => at.addScaledVector(axis, extent[(k >> i) & 1][i]), r.clone()));
  }
  const fit = () => view.fit(points.map(v), 0.25 * data.size, boxes.flatMap(cornersOf));
  const lit = (object, on) => object.traverse((part) => {
    if (!part.material) return;
    part.userData.color ??= part.material.color.getHex();
    part.material.color.setHex(on ? 0xff8800 : part.userData.color);
  });
  const ray = new T.Raycaster();
  let measuring = null;
  canvas.addEventListener("click", (event) => {
    if (view.moved()) return;
    if (measuring) { measuring.click(event); return; }
    const box = canvas.getBoundingClientRect();
    const at = new T.Vector2(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
    ray.setFromCamera(at, camera);
    let [hit] = ray.intersectObjects(objects.filter((object) => object.visible), true);
    let object = hit && hit.object;
    while (object && object.userData.item === undefined) object = object.parent;
    if (object) picked(object.userData.item);
  });
  let sized = "";
  /** Takes the size of its place in the page; whether that is another one. */
  function resize() {
    const { clientWidth: wide, clientHeight: high } = host, now = [wide, high, window.devicePixelRatio].join();
    if (!wide || !high || sized === now) return false;
    sized = now;
    renderer.setPixelRatio(window.devicePixelRatio);
    renderer.setSize(wide, high);
    camera.aspect = wide / high;
    return true;
  }
  resize(); // before the first frame, which is drawn once
  new ResizeObserver(() => { if (resize()) { fit(); render(); } }).observe(host);
  theme();
  return {
    points, layers, view, render, compose, cell: grid.cell, pixelOf: (k) => pixel(v(k)),
    /** Distances between points that are clicked, which `tell(text)` gets, or an end of that. */
    measure(on, tell) {
      if (measuring) scene.remove(measuring.line);
      measuring = on ? ruler(T, { points, pixel, canvas, at: (k) => v(k), tell, draw }) : null;
      if (measuring) scene.add(measuring.line);
      draw();
    },
    layer(name, visible) {
      layers.set(name, visible);
      if (name === "grid") grid.visible = visible;
      objects.forEach((object) => { object.visible = layers.get(object.userData.layer) !== false; });
      draw();
    },
    highlight(number) {
      objects.forEach((object) => lit(object, false));
      objects.filter((object) => object.userData.item === number).forEach((object) => lit(object, true));
      draw();
    },
    show(vectors, loads) {
      v = (k) => new T.Vector3(vectors[3 * k], vectors[3 * k + 1], vectors[3 * k + 2]);
      objects.forEach((object) => object.update(v, loads));
      if (measuring) measuring.update();
      draw();
    },
    fit() {
      names.forget();
      fit();
    },
    box(name) { /* of the shapes of a body: the least and the largest corner, in space */
      const found = new T.Box3();
      objects.filter((object) => object.userData.layer === "meshes" && data.items[object.userData.item].name === name).forEach((object) => {
        object.updateWorldMatrix(true, false);
        found.expandByObject(object, true);
      });
      return [found.min.toArray(), found.max.toArray()];
    },
    placement(name) {
      const frame = frames.get(name);
      frame.updateWorldMatrix(true, false);
      return frame.matrixWorld.elements.slice();
    },
    cover: () => objects.filter((object) => object.userData.layer === "solids").map((object) => object.material.opacity),
    outside: () => boxes.flatMap(cornersOf).filter((corner) => !pixel(corner)).length,
    drawn: () => renderer.info.render.triangles,
  };
}
