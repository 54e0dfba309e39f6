"use strict";
/* Shapes of items as three.js objects: each has `update(v, loads)`, with v(k) the k-th point or direction. */

const COLORS = {
  turn: 0x1f5fbf, slide: 0x1f5fbf, joint: 0x30343b, force: 0xd9622b, torque: 0xb0307a, sensor: 0x1a8f5a,
  port: 0x555b66, mass: 0x222222, gravity: 0x7a4fc0, acceleration: 0x7a4fc0, spring: 0x444a55,
  bodies: [0x6f9bd1, 0xe0a458, 0x7fb77e, 0xc98bb9, 0x9aa5b1, 0xd98880, 0x73b3b0, 0xb7a16a],
};

/* What has the color of ink on paper, dark and in dark mode light; `paintInk` colors it again. */
const INK = [];
function paintInk(dark) {
  INK.forEach(({ material, color }) => material.color.setHex(dark ? { [COLORS.mass]: 0x15181d }[color] ?? 0xaab1be : color));
}

/** How far solids cover what is behind them: the large ones, half as long as all that is drawn or more, share what one has. */
function opacities(shapes, size) {
  const large = ({ geometry: { extent: [low, high] } }) => Math.max(...high.map((end, k) => end - low[k])) > 0.5 * size;
  const shared = 0.35 / Math.max(1, shapes.filter(large).length);
  return new Map(shapes.map((shape) => [shape, large(shape) ? shared : 0.35]));
}

/** Makes the objects of shapes for a scene of this size; `T` is the library three.js. */
function shapeMaker(T, size, solids) {
  const unit = size * 0.01, Y = new T.Vector3(0, 1, 0), Z = new T.Vector3(0, 0, 1);
  const cylinder = new T.CylinderGeometry(1, 1, 1, 14), cone = new T.ConeGeometry(1, 1, 18);
  const sphere = new T.SphereGeometry(1, 18, 12), cube = new T.BoxGeometry(2, 2, 2);
  const ring = new T.TorusGeometry(1, 0.07, 8, 36, 1.6 * Math.PI);
  const paint = (color, more = {}) => {
    const material = new T.MeshLambertMaterial({ color, ...more });
    if ([COLORS.joint, COLORS.port, COLORS.spring, COLORS.mass].includes(color)) INK.push({ material, color });
    return material;
  };
  const mesh = (geometry, material) => new T.Mesh(geometry, material);
  const ball = (material, radius) => {
    const found = mesh(sphere, material);
    found.scale.setScalar(radius);
    return found;
  };

  /** Puts a cylinder between two points. */
  function between(rod, a, b, radius) {
    const along = new T.Vector3().subVectors(b, a), length = along.length();
    rod.visible = length > 1e-9 * size;
    if (!rod.visible) return;
    rod.position.addVectors(a, b).multiplyScalar(0.5);
    rod.quaternion.setFromUnitVectors(Y, along.divideScalar(length));
    rod.scale.set(radius, length, radius);
  }

  /** An arrow in a group: `point(at, along, length)` places it; heads say how many arrowheads it has. */
  function arrow(material, radius, heads = 1) {
    const group = new T.Group(), rod = mesh(cylinder, material), tips = [];
    group.add(rod);
    for (let k = 0; k < heads; k++) tips.push(mesh(cone, material));
    group.add(...tips);
    group.point = (at, along, length) => {
      const direction = along.clone(), norm = direction.length();
      group.visible = norm > 0 && length > 0;
      if (!group.visible) return;
      direction.divideScalar(norm);
      const head = Math.min(5 * radius, 0.45 * length / heads);
      const end = at.clone().addScaledVector(direction, length);
      between(rod, at, end.clone().addScaledVector(direction, -0.9 * head), radius);
      tips.forEach((tip, k) => {
        tip.quaternion.setFromUnitVectors(Y, direction);
        tip.position.copy(end).addScaledVector(direction, -(0.5 + 0.75 * k) * head);
        tip.scale.set(0.5 * head, head, 0.5 * head);
      });
      group.end = end;
    };
    return group;
  }

  /** A bent arrow about the z-axis of its group: the positive turn, seen as the right hand's fingers. */
  function bent(material, radius) {
    const group = new T.Group(), arc = mesh(ring, material), tip = mesh(cone, material);
    const last = 1.6 * Math.PI;
    arc.scale.setScalar(radius);
    tip.position.set(radius * Math.cos(last), radius * Math.sin(last), 0);
    tip.quaternion.setFromUnitVectors(Y, new T.Vector3(-Math.sin(last), Math.cos(last), 0));
    tip.scale.set(0.24 * radius, 0.55 * radius, 0.24 * radius);
    group.add(arc, tip);
    group.about = (at, along) => {
      group.position.copy(at);
      group.quaternion.setFromUnitVectors(Z, along.clone().normalize());
    };
    return group;
  }

  const makers = {
    stick(shape, color) {
      const group = new T.Group(), material = paint(color), rod = mesh(cylinder, material);
      const radius = unit * (shape.elastic ? 0.6 : 1.1), ends = [ball(material, radius), ball(material, radius)];
      group.add(rod, ...ends);
      group.update = (v) => {
        const points = shape.points.map(v);
        between(rod, ...points, radius);
        ends.forEach((end, k) => end.position.copy(points[k]));
      };
      return group;
    },
    curve(shape, color) {
      const group = new T.Group(), material = paint(color), rods = [], joints = [], count = 36;
      for (let k = 0; k < count; k++) rods.push(mesh(cylinder, material));
      for (let k = 0; k <= count; k++) joints.push(ball(material, 0.7 * unit));
      group.add(...rods, ...joints);
      group.update = (v) => {
        const curve = new T.CatmullRomCurve3(shape.points.map(v), false, "centripetal");
        const points = curve.getPoints(count);
        rods.forEach((rod, k) => between(rod, points[k], points[k + 1], 0.7 * unit));
        joints.forEach((joint, k) => joint.position.copy(points[k]));
      };
      return group;
    },
    dot(shape, color) {
      const found = ball(paint(color), 2.2 * unit);
      found.update = (v) => found.position.copy(v(shape.at));
      return found;
    },
    mesh(shape, color) {
      const given = shape.geometry, solid = solids.get(shape);
      const material = paint(solid ? color : 0xb8bec8, { side: solid ? T.FrontSide : T.DoubleSide, flatShading: given.triangles !== undefined, transparent: true, opacity: solid ?? 0.55, depthWrite: false });
      const up = (upright) => upright.rotateX(Math.PI / 2); // three.js has its axis along y
      let geometry;
      if (given.triangles !== undefined) {
        const bytes = Uint8Array.from(atob(given.triangles), (letter) => letter.charCodeAt(0));
        geometry = new T.BufferGeometry();
        geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(bytes.buffer), 3));
        geometry.computeVertexNormals();
      } else if (given.box) geometry = new T.BoxGeometry(...given.box);
      else if (given.sphere !== undefined) geometry = new T.SphereGeometry(given.sphere, 24, 16);
      else if (given.ellipsoid) geometry = new T.SphereGeometry(1, 24, 16).scale(...given.ellipsoid);
      else if (given.capsule) geometry = up(new T.CapsuleGeometry(...given.capsule, 8, 24));
      else if (given.cone) geometry = up(new T.ConeGeometry(...given.cone, 24));
      else if (given.plane) geometry = new T.PlaneGeometry(...given.plane.map((wide) => wide || 10 * size)); // 0 is endless
      else geometry = up(new T.CylinderGeometry(given.cylinder[0], given.cylinder[0], given.cylinder[1], 24));
      geometry.applyMatrix4(new T.Matrix4().set(...given.place));
      const found = mesh(geometry, material);
      if (solid) found.add(new T.LineSegments(new T.EdgesGeometry(geometry, 30), new T.LineBasicMaterial({ color })));
      found.matrixAutoUpdate = false;
      found.update = (v) => {
        const [r, x, y, z] = shape.at.map(v);
        found.matrix.makeBasis(x, y, z).setPosition(r);
        found.matrixWorldNeedsUpdate = true;
      };
      return found;
    },
    frame(shape) {
      const group = new T.Group(), length = unit * (shape.big ? 16 : 8), zero = new T.Vector3();
      [0xd02020, 0x20a020, 0x2040e0].forEach((color, k) => {
        const one = arrow(paint(color), unit * (shape.big ? 0.3 : 0.22));
        one.point(zero, new T.Vector3().setComponent(k, 1), length);
        group.add(one);
      });
      group.matrixAutoUpdate = false;
      group.update = (v) => {
        const [r, x, y, z] = shape.at.map(v);
        group.matrix.makeBasis(x, y, z).setPosition(r);
        group.matrixWorldNeedsUpdate = true;
      };
      return group;
    },
    port(shape) {
      const found = ball(paint(COLORS.port), 0.9 * unit);
      found.update = (v) => found.position.copy(v(shape.at));
      return found;
    },
    mass(shape) {
      const group = new T.Group(), radius = (1.6 + 1.4 * shape.share) * unit;
      const dark = paint(COLORS.mass), light = paint(0xf5f5f5);
      for (let k = 0; k < 8; k++) { /* the sign of drawings: eighths of a ball, dark and light */
        const [i, j, l] = [k & 1, (k >> 1) & 1, k >> 2];
        const part = new T.SphereGeometry(radius, 8, 6, i * Math.PI + j * Math.PI / 2, Math.PI / 2, l * Math.PI / 2, Math.PI / 2);
        group.add(mesh(part, (j + l) % 2 ? dark : light));
      }
      group.update = (v) => group.position.copy(v(shape.at));
      return group;
    },
    joint(shape) {
      const fixed = shape.kind === "fixed", found = mesh(fixed ? cube : sphere, paint(COLORS.joint));
      found.scale.setScalar(unit * (fixed ? 0.9 : 1.5));
      found.update = (v) => found.position.copy(v(shape.at));
      return found;
    },
    turn(shape) {
      const group = new T.Group(), material = paint(COLORS.turn), axis = arrow(material, 0.35 * unit);
      const round = bent(material, 4 * unit);
      group.add(axis, round);
      group.update = (v) => {
        const at = v(shape.at), along = v(shape.along);
        axis.point(at.clone().addScaledVector(along, -5 * unit), along, 15 * unit);
        round.about(at.clone().addScaledVector(along, 3 * unit), along);
      };
      return group;
    },
    slide(shape) {
      const group = new T.Group(), material = paint(COLORS.slide), axis = arrow(material, 0.5 * unit);
      const foot = mesh(cube, material);
      foot.scale.setScalar(0.9 * unit);
      group.add(axis, foot);
      group.update = (v) => {
        const at = v(shape.at);
        axis.point(at, v(shape.along), 15 * unit);
        foot.position.copy(at);
      };
      return group;
    },
    arrow(shape) {
      const group = arrow(paint(COLORS.gravity), 0.6 * unit);
      group.update = (v) => group.point(v(shape.at), v(shape.along), 22 * unit);
      return group;
    },
    force: (shape) => acting(shape, COLORS.force, 1),
    torque: (shape) => acting(shape, COLORS.torque, 2),
    effort(shape) { /* of a joint at equilibrium */
      const color = shape.turns ? COLORS.torque : COLORS.force, group = arrow(paint(color), 0.8 * unit, shape.turns ? 2 : 1);
      group.update = (v, loads) => {
        const value = loads ? loads.u[shape.effort] : 0, largest = loads ? loads.largest(shape.turns) : 1;
        group.point(v(shape.at), v(shape.along).multiplyScalar(Math.sign(value)), loads && value ? (6 + 18 * Math.abs(value) / largest) * unit : 0);
      };
      return group;
    },
    line(shape) {
      const found = mesh(cylinder, paint(COLORS.joint, { transparent: true, opacity: 0.45 }));
      found.update = (v) => between(found, ...shape.points.map(v), 0.35 * unit);
      return found;
    },
    spring(shape) {
      const geometry = new T.BufferGeometry(), turns = 12, count = 20 * turns;
      const places = new Float32Array(3 * (count + 1));
      geometry.setAttribute("position", new T.BufferAttribute(places, 3));
      const found = new T.Line(geometry, new T.LineBasicMaterial({ color: COLORS.spring }));
      INK.push({ material: found.material, color: COLORS.spring });
      found.frustumCulled = false;
      found.update = (v) => {
        const [a, b] = shape.points.map(v), along = new T.Vector3().subVectors(b, a);
        const turn = new T.Quaternion().setFromUnitVectors(Z, along.clone().normalize());
        for (let k = 0; k <= count; k++) {
          const part = k / count, phase = 2 * Math.PI * turns * part, wide = 1.6 * unit * (part > 0.04 && part < 0.96);
          const off = new T.Vector3(wide * Math.cos(phase), wide * Math.sin(phase), 0).applyQuaternion(turn);
          a.clone().addScaledVector(along, part).add(off).toArray(places, 3 * k);
        }
        geometry.attributes.position.needsUpdate = true;
      };
      return found;
    },
    sensor(shape) {
      const group = new T.Group(), material = paint(COLORS.sensor), box = mesh(cube, material);
      box.scale.setScalar(1.3 * unit);
      group.add(box);
      for (let k = 0; k < 3; k++) {
        const one = arrow(material, 0.2 * unit);
        one.point(new T.Vector3(), new T.Vector3().setComponent(k, 1), (6 - k) * unit);
        group.add(one);
      }
      group.matrixAutoUpdate = false;
      group.update = (v) => {
        const [r, x, y, z] = shape.at.map(v);
        group.matrix.makeBasis(x, y, z).setPosition(r);
        group.matrixWorldNeedsUpdate = true;
      };
      return group;
    },
  };

  /** A load: a thin arrow in its declared direction, and a thick one for its value at equilibrium. */
  function acting(shape, color, heads) {
    const group = new T.Group(), thin = arrow(paint(color, { transparent: true, opacity: 0.55 }), 0.3 * unit, heads);
    const thick = arrow(paint(color), 0.9 * unit, heads);
    group.add(thin, thick);
    group.update = (v, loads) => {
      const at = v(shape.at), along = v(shape.along), value = loads && loads.visible ? loads.u[shape.effort] * along.length() : 0;
      thin.point(at, along, 14 * unit);
      thick.point(at, along.clone().multiplyScalar(Math.sign(value)), value ? (6 + 18 * Math.abs(value) / loads.largest(heads === 2)) * unit : 0);
    };
    return group;
  }

  return (shape, color) => makers[shape.type](shape, color);
}
