"use strict";
/* The picture: light, camera, the objects of all items, and what is picked with the mouse. */

/** A camera that turns about a point: left button turns, right button or shift moves, the wheel zooms. */
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
  let last = null, way = 0;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    last = [event.clientX, event.clientY];
    way = 0;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointerup", () => { last = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!last) return;
    const dx = event.clientX - last[0], dy = event.clientY - last[1];
    last = [event.clientX, event.clientY];
    way += Math.abs(dx) + Math.abs(dy);
    if (event.buttons & 2 || event.shiftKey) {
      const scale = state.distance / canvas.clientHeight, right = new T.Vector3().setFromMatrixColumn(camera.matrix, 0);
      target.addScaledVector(right, -dx * scale).addScaledVector(new T.Vector3().setFromMatrixColumn(camera.matrix, 1), dy * scale);
    } else {
      state.azimuth -= 0.008 * dx;
      state.height = Math.max(-1.5, Math.min(1.5, state.height + 0.008 * dy));
    }
    apply();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.distance *= Math.exp(0.001 * Math.max(-200, Math.min(200, event.deltaY)));
    apply();
  }, { passive: false });
  return {
    moved: () => way > 4,
    look(azimuth, height) { Object.assign(state, { azimuth, height }); apply(); },
    fit(points, margin) { /* the smallest distance at which all points are in the picture */
      const box = new T.Box3().setFromPoints(points), high = Math.tan(camera.fov * Math.PI / 360);
      box.getCenter(target);
      apply();
      const [right, above, back] = [0, 1, 2].map((k) => new T.Vector3().setFromMatrixColumn(camera.matrix, k));
      const needed = points.map((point) => {
        const from = point.clone().sub(target), [x, y] = [right, above].map((axis) => Math.abs(from.dot(axis)) + margin);
        return from.dot(back) + Math.max(y / high, x / (high * camera.aspect));
      });
      state.distance = Math.max(...needed, 0.1 * size);
      apply();
    },
  };
}

/** The drawn scene; `show(v, loads)` moves it. Throws an error where the browser has no WebGL. */
function makeWorld(T, data, host, picked) {
  const renderer = new T.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  const scene = new T.Scene(), camera = new T.PerspectiveCamera(35, 1, 0.1, 100), labels = [];
  const make = shapeMaker(T, data.size), layers = new Map(), objects = [], frames = new Map();
  const overlay = document.createElement("div");
  overlay.className = "labels";
  scene.background = new T.Color(0xffffff);
  scene.add(new T.HemisphereLight(0xffffff, 0x9aa0aa, 1.5));
  const lamp = new T.DirectionalLight(0xffffff, 1.1);
  scene.add(lamp);
  host.append(renderer.domElement, overlay);
  let queued = false;
  function render() {
    queued = false;
    lamp.position.copy(camera.position);
    renderer.render(scene, camera);
    for (const { element, at, layer } of labels) {
      const place = at().clone().project(camera);
      const seen = place.z < 1 && Math.abs(place.x) < 1 && Math.abs(place.y) < 1 && layers.get("names") && layers.get(layer);
      element.style.display = seen ? "" : "none";
      element.style.left = `${50 + 50 * place.x}%`;
      element.style.top = `${50 - 50 * place.y}%`;
    }
  }
  const draw = () => { if (!queued) { queued = true; requestAnimationFrame(render); } };
  const up = new T.Vector3(...data.up), view = orbit(T, camera, renderer.domElement, data.size, up, draw);
  const points = [], boxes = [];
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
    item.shapes.filter((shape) => shape.label).forEach((shape) => label(shape.label, [shape.at], "ports", "port"));
  });
  function label(text, numbers, layer, kind) {
    const element = document.createElement("span"), middle = kind === "bodies" && numbers.length > 1;
    element.textContent = text;
    element.className = kind;
    overlay.append(element);
    const at = () => middle ? v(numbers[0]).clone().add(v(numbers[numbers.length - 1])).multiplyScalar(0.5) : v(numbers[0]);
    labels.push({ element, at, layer });
  }
  function cornersOf(shape) {
    const [r, ...axes] = shape.at.map(v), { extent } = shape.geometry;
    return [0, 1, 2, 3, 4, 5, 6, 7].map((k) => axes.reduce((at, axis, i) => at.addScaledVector(axis, extent[(k >> i) & 1][i]), r.clone()));
  }
  const lit = (object, on) => object.traverse((part) => {
    if (!part.material) return;
    part.userData.color ??= part.material.color.getHex();
    part.material.color.setHex(on ? 0xff8800 : part.userData.color);
  });
  const ray = new T.Raycaster();
  renderer.domElement.addEventListener("click", (event) => {
    if (view.moved()) return;
    const box = renderer.domElement.getBoundingClientRect();
    const at = new T.Vector2(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
    ray.setFromCamera(at, camera);
    let [hit] = ray.intersectObjects(objects.filter((object) => object.visible), true);
    let object = hit && hit.object;
    while (object && object.userData.item === undefined) object = object.parent;
    if (object) picked(object.userData.item);
  });
  new ResizeObserver(() => {
    const { clientWidth: wide, clientHeight: high } = host;
    if (!wide || !high) return;
    renderer.setPixelRatio(window.devicePixelRatio);
    renderer.setSize(wide, high);
    camera.aspect = wide / high;
    camera.updateProjectionMatrix();
    render();
  }).observe(host);
  return {
    points, layers, view, render,
    layer(name, visible) {
      layers.set(name, visible);
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
      draw();
    },
    fit() {
      view.fit([...points.map(v), ...boxes.flatMap(cornersOf)], 0.25 * data.size);
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
    drawn: () => renderer.info.render.triangles,
  };
}
