"use strict";
/* Names in the picture: each is put where it covers no other, with a line to what it names. */

const NEAR = 14; // pixels: names that are further away have a line
const RINGS = [8, 16, 26, 38, 52, 68, 86, 106, 130, 160, 200, 250];
const AROUND = [-0.25, 0.25, -0.75, 0.75, 0, 1, -0.5, 0.5, -0.12, 0.12, -0.88, 0.88, -0.38, 0.38, -0.62, 0.62].map((part) => part * Math.PI);

const apart = (a, b) => a.left >= b.right || b.left >= a.right || a.top >= b.bottom || b.top >= a.bottom;

/** The box of a label of this size on a ring about its point. */
function boxAt({ x, y, wide, high }, radius, angle) {
  const [i, j] = [Math.cos(angle), Math.sin(angle)].map((part) => Math.max(-1, Math.min(1, 1.5 * part)));
  const left = x + i * (radius + wide / 2) - wide / 2, top = y + j * (radius + high / 2) - high / 2;
  return { left, top, right: left + wide, bottom: top + high, radius, angle };
}

/**
 * Boxes for labels, in their order, or null where there is no room. A label has its point `x`, `y`, its
 * size `wide`, `high`, and the box that it had, `last`, which it keeps as long as it is no worse.
 */
function placeLabels(labels, obstacles, wide, high) {
  const taken = [...obstacles];
  const free = (box) => box.left >= 0 && box.top >= 0 && box.right <= wide && box.bottom <= high && taken.every((other) => apart(box, other));
  return labels.map((label) => {
    let best = null;
    for (const radius of RINGS) {
      for (const angle of AROUND) {
        const box = boxAt(label, radius, angle);
        if (free(box)) { best = box; break; }
      }
      if (best) break;
    }
    const kept = label.last && boxAt(label, label.last.radius, label.last.angle);
    if (kept && best && kept.radius <= best.radius + 10 && free(kept)) best = kept;
    if (best) taken.push(best);
    return best;
  });
}

/** The end of the line from a point to a box, or null where the name is beside its point. */
function lineEnd(x, y, box) {
  const at = [Math.max(box.left, Math.min(box.right, x)), Math.max(box.top, Math.min(box.bottom, y))];
  return Math.hypot(at[0] - x, at[1] - y) > NEAR ? at : null;
}

/** Names over the picture `host`; `add` gives one, `draw` places all, `paint` writes them on a canvas. */
function labelLayer(host) {
  const overlay = make("div", "", "labels"), all = [];
  overlay.setAttribute("aria-hidden", "true"); // the tree has the names
  overlay.innerHTML = "<svg></svg>";
  const lines = overlay.firstChild;
  host.append(overlay);
  return {
    /** `at()` gives [x, y] in pixels, or null where the label is not to be seen. */
    add(text, kind, at) {
      const element = make("span", text, kind);
      element.title = text;
      overlay.append(element);
      lines.insertAdjacentHTML("beforeend", "<line/>");
      const leader = lines.lastElementChild;
      const label = { element, leader, kind, at, last: null };
      all.push(label);
      return label;
    },
    forget: () => all.forEach((label) => { label.last = null; }),
    draw(wide, high, obstacles) {
      const seen = [];
      for (const label of all) {
        const at = label.at();
        label.element.style.display = at ? "" : "none";
        label.leader.style.display = "none";
        if (at) seen.push(Object.assign(label, { x: at[0], y: at[1] }));
      }
      for (const label of seen) Object.assign(label, { wide: label.element.offsetWidth + 2, high: label.element.offsetHeight });
      placeLabels(seen, obstacles, wide, high).forEach((box, k) => {
        const { element, leader, x, y } = seen[k];
        seen[k].last = box;
        if (!box) { element.style.display = "none"; return; }
        element.style.transform = `translate(${box.left + 1}px, ${box.top}px)`;
        const end = lineEnd(x, y, box);
        if (!end) return;
        leader.style.display = "";
        [["x1", x], ["y1", y], ["x2", end[0]], ["y2", end[1]]].forEach(([key, value]) => leader.setAttribute(key, value));
      });
    },
    paint(context) {
      for (const { element, leader, last, x, y } of all) {
        if (element.style.display === "none" || !last) continue;
        const style = getComputedStyle(element), end = lineEnd(x, y, last);
        Object.assign(context, { font: style.font, fillStyle: style.color, strokeStyle: getComputedStyle(leader).stroke, lineWidth: 1, textBaseline: "middle" });
        context.fillText(element.textContent, last.left + 1, (last.top + last.bottom) / 2);
        if (!end) continue;
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(...end);
        context.stroke();
      }
    },
  };
}
