"use strict";
/* Two small drawings beside the picture: poles, and one signal over time. */

const DAMPINGS = [0.1, 0.3, 0.7];

/**
 * The upper half of the plane of poles: directions are true, distances from zero are logarithmic. `others`
 * are sets of poles [real, imaginary] that stay, each with a class; `show(poles)` draws those of the sliders.
 */
function polePlane(svg, others) {
  const sizes = others.flatMap((one) => one.poles).map(([x, y]) => Math.hypot(x, y)).filter((size) => size > 0);
  const least = 0.3 * (sizes.length ? Math.min(...sizes) : 1);
  let reach = 0, still = "";
  const far = (size) => 100 * Math.log1p(size / least) / reach;
  const at = ([x, y]) => {
    const size = Math.hypot(x, y), part = size > 0 ? far(size) / size : 0;
    return [x * part, -y * part].map((entry) => entry.toFixed(2));
  };
  function frame(largest) {
    reach = Math.log1p(1.3 * largest / least);
    let text = `<line class="guide axis" x1="-112" x2="112"/><line class="guide axis" y1="-112" y2="0"/>`;
    for (let power = Math.ceil(Math.log10(least)), last = 0; 10 ** power < 1.3 * largest; power++) {
      const radius = far(10 ** power);
      text += `<circle class="guide" r="${radius.toFixed(2)}"/>`;
      if (radius < last + 20) continue;
      last = radius;
      text += `<text x="${radius.toFixed(2)}" y="9" text-anchor="middle">${short(10 ** power)}</text>`;
    }
    text += `<text x="-110" y="9">rad/s</text>`;
    DAMPINGS.forEach((damping) => {
      const [x, y] = [damping, Math.sqrt(1 - damping * damping)].map((entry) => (-106 * entry).toFixed(2));
      text += `<line class="guide" x2="${x}" y2="${y}"/><text x="${x}" y="${y}" text-anchor="middle">${damping}</text>`;
    });
    others.forEach(({ kind, poles, title }) => {
      text += `<g><title>${title}</title>${poles.filter((one) => one[1] >= 0).map((one) => `<circle class="${kind}" r="${kind === "sample" ? 1.2 : 3}" cx="${at(one)[0]}" cy="${at(one)[1]}"/>`).join("")}</g>`;
    });
    still = text;
  }
  return {
    least,
    show(poles) {
      const largest = Math.max(...poles.map(([x, y]) => Math.hypot(x, y)), ...sizes, 3 * least);
      if (!(Math.log1p(largest / least) < reach)) frame(largest);
      svg.innerHTML = still + poles.filter(([, y]) => y >= 0).map((one) => {
        const [x, y] = at(one).map(Number), right = one[0] > 0 && Math.hypot(...one) > least;
        return `<path class="pole${right ? " right" : ""}" d="M${x - 2.5} ${y - 2.5}l5 5m0 -5l-5 5"><title>${short(one[0])} + ${short(one[1])} i rad/s</title></path>`;
      }).join("");
    },
  };
}

/** A curve over time in `svg`, with others `beside` it; the function that is returned moves the dot to the k-th point. */
function curveOf(svg, times, values, unit, beside = []) {
  const low = Math.min(0, ...values, ...beside.flat()), high = Math.max(0, ...values, ...beside.flat()), tall = high - low || 1, last = times[times.length - 1];
  const x = (k) => 6 + 212 * times[k] / last, y = (value) => 66 - 56 * (value - low) / tall;
  const line = (all, kind) => `<polyline class="${kind}" points="${times.map((_, k) => `${x(k).toFixed(1)},${y(all[k]).toFixed(1)}`).join(" ")}"/>`;
  svg.innerHTML = `<line class="guide axis" x1="6" x2="218" y1="${y(0)}" y2="${y(0)}"/>${beside.map((all) => line(all, "drawn beside")).join("")}${line(values, "drawn")}<circle class="now" r="2.2"/>
<text x="6" y="7">${spelled(high, unit)}</text><text x="6" y="79">${spelled(low, unit)}</text><text x="218" y="79" text-anchor="end">${spelled(last, "s")}</text>`;
  const dot = svg.querySelector(".now");
  return (k) => {
    dot.setAttribute("cx", x(k));
    dot.setAttribute("cy", y(values[k]));
  };
}
