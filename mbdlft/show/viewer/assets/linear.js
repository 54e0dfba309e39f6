"use strict";
/* The linear model at the values of the sliders: its matrices, poles and step responses. */

const product = (A, B) => A.map((row) => B[0].map((_, j) => row.reduce((sum, entry, k) => sum + entry * B[k][j], 0)));

/** A, B, C, D at physical values and loads u; null where the mass matrix is singular or u is unknown. */
function linearAt(linear, p, u) {
  const { tape, unknown, states, rows } = linear, inputs = linear.inputs.length;
  if (!u) return null;
  const found = interpret(tape, p, u), slope = (i, j) => found[j * rows + i];
  const range = (from, to) => Array.from({ length: to - from }, (_, k) => from + k);
  const block = (is, js) => is.map((i) => js.map((j) => slope(i, j)));
  const own = range(0, unknown), given = range(unknown, unknown + states + inputs), read = range(unknown, rows);
  const solved = solveAll(block(own, own), block(own, given).map((row) => row.map((entry) => -entry)));
  if (!solved) return null;
  const through = read.length ? product(block(read, own), solved) : [];
  const seen = block(read, given).map((row, i) => row.map((entry, j) => entry + through[i][j]));
  const [A, C] = [solved.slice(0, states), seen].map((all) => all.map((row) => row.slice(0, states)));
  const [B, D] = [solved.slice(0, states), seen].map((all) => all.map((row) => row.slice(states)));
  return { A, B, C, D };
}

/** M = S^-1 A S with a diagonal `scale` of powers of two, so that rows and columns are of like size. */
function balanced(A) {
  const n = A.length, M = A.map((row) => Float64Array.from(row)), scale = new Float64Array(n).fill(1);
  for (let round = 0, changed = true; changed && round < 30; round++) {
    changed = false;
    for (let k = 0; k < n; k++) {
      let row = 0, column = 0;
      for (let i = 0; i < n; i++) if (i !== k) { row += Math.abs(M[k][i]); column += Math.abs(M[i][k]); }
      if (!(row > 0 && column > 0)) continue;
      const factor = 2 ** Math.round(0.5 * Math.log2(row / column));
      if (factor === 1) continue;
      changed = true;
      scale[k] *= factor;
      for (let i = 0; i < n; i++) { M[k][i] /= factor; M[i][k] *= factor; }
    }
  }
  return { M, scale };
}

/** Puts zeros below the first subdiagonal by similar transformations (elimination with pivots). */
function toHessenberg(M) {
  const n = M.length;
  for (let m = 1; m < n - 1; m++) {
    let pivot = m;
    for (let i = m; i < n; i++) if (Math.abs(M[i][m - 1]) > Math.abs(M[pivot][m - 1])) pivot = i;
    if (M[pivot][m - 1] === 0) continue;
    [M[m], M[pivot]] = [M[pivot], M[m]];
    for (let i = 0; i < n; i++) [M[i][m], M[i][pivot]] = [M[i][pivot], M[i][m]];
    for (let i = m + 1; i < n; i++) {
      const factor = M[i][m - 1] / M[m][m - 1];
      if (factor === 0) continue;
      for (let j = 0; j < n; j++) M[i][j] -= factor * M[m][j];
      for (let j = 0; j < n; j++) M[j][m] += factor * M[j][i];
      M[i][m - 1] = 0;
    }
  }
  return M;
}

/** The square root of a complex number. */
function rootOf(x, y) {
  const size = Math.hypot(x, y), real = Math.sqrt(0.5 * (size + Math.abs(x)));
  if (real === 0) return [0, 0];
  const other = 0.5 * y / real;
  return x >= 0 ? [real, other] : [Math.abs(other), y < 0 ? -real : real];
}

/**
 * The eigenvalues [real, imaginary] of A, by QR steps with Wilkinson's shift on a complex Hessenberg matrix.
 * Source: Golub and Van Loan, Matrix Computations (2013), sections 7.4 and 7.5.
 */
function eigenvalues(A) {
  const R = toHessenberg(balanced(A).M), n = R.length, I = R.map(() => new Float64Array(n)), found = [];
  const size = (i, j) => Math.abs(R[i][j]) + Math.abs(I[i][j]);
  let last = n - 1, first = 0;
  for (let round = 0; last >= 0; round++) {
    for (first = last; first > 0; first--) {
      const around = size(first, first) + size(first - 1, first - 1);
      if (size(first, first - 1) <= 2.3e-16 * around || size(first, first - 1) < 1e-300) { R[first][first - 1] = I[first][first - 1] = 0; break; }
    }
    if (first === last) {
      found.push([R[last][last], I[last][last]]);
      last--;
      round = 0;
      continue;
    }
    if (round > 300) return null;
    const shift = round % 10 === 9 ? [R[last][last] + size(last, last - 1), I[last][last]] : wilkinson(R, I, last);
    stepQR(R, I, first, last, shift);
  }
  const rounding = 4.4e-16 * n * Math.max(...found.map(([x, y]) => Math.hypot(x, y)), 0);
  return found.map((one) => one.map((part) => (Math.abs(part) < rounding ? 0 : part)));
}

/** The eigenvalue of the last block of two rows that is nearest to the last entry. */
function wilkinson(R, I, k) {
  const [a, b, c, d] = [[k - 1, k - 1], [k - 1, k], [k, k - 1], [k, k]].map(([i, j]) => [R[i][j], I[i][j]]);
  const half = [0.5 * (a[0] - d[0]), 0.5 * (a[1] - d[1])];
  const bc = [b[0] * c[0] - b[1] * c[1], b[0] * c[1] + b[1] * c[0]];
  const root = rootOf(half[0] * half[0] - half[1] * half[1] + bc[0], 2 * half[0] * half[1] + bc[1]);
  const sign = half[0] * root[0] + half[1] * root[1] > 0 ? -1 : 1;
  return [d[0] + half[0] + sign * root[0], d[1] + half[1] + sign * root[1]];
}

/** One QR step with a shift on the rows and columns from `first` to `last`, by plane rotations. */
function stepQR(R, I, first, last, [x, y]) {
  const rotations = [];
  for (let k = first; k <= last; k++) { R[k][k] -= x; I[k][k] -= y; }
  for (let k = first; k < last; k++) {
    const long = Math.hypot(R[k][k], I[k][k], R[k + 1][k], I[k + 1][k]) || 1;
    const [cr, ci, sr, si] = [R[k][k] / long, -I[k][k] / long, R[k + 1][k] / long, -I[k + 1][k] / long];
    rotations.push([cr, ci, sr, si]);
    for (let j = k; j <= last; j++) { /* [c s; -s* c*] with complex c and s */
      const [ar, ai, br, bi] = [R[k][j], I[k][j], R[k + 1][j], I[k + 1][j]];
      R[k][j] = cr * ar - ci * ai + sr * br - si * bi;
      I[k][j] = cr * ai + ci * ar + sr * bi + si * br;
      R[k + 1][j] = -sr * ar - si * ai + cr * br + ci * bi;
      I[k + 1][j] = -sr * ai + si * ar + cr * bi - ci * br;
    }
  }
  rotations.forEach(([cr, ci, sr, si], at) => {
    const k = first + at;
    for (let i = first; i <= Math.min(k + 2, last); i++) {
      const [ar, ai, br, bi] = [R[i][k], I[i][k], R[i][k + 1], I[i][k + 1]];
      R[i][k] = cr * ar + ci * ai + sr * br + si * bi;
      I[i][k] = cr * ai - ci * ar + sr * bi - si * br;
      R[i][k + 1] = -sr * ar + si * ai + cr * br - ci * bi;
      I[i][k + 1] = -sr * ai - si * ar + cr * bi + ci * br;
    }
  });
  for (let k = first; k <= last; k++) { R[k][k] += x; I[k][k] += y; }
}

/**
 * The first `count` entries of the eigenvector of a pole: real and imaginary parts, the largest entry 1.
 * Two steps of inverse iteration from a vector without symmetry, in real arithmetic.
 */
function shapeOf(A, [x, y], count) {
  const n = A.length, { M, scale } = balanced(A), size = Math.max(...M.map((row) => Math.hypot(...row)));
  const shift = x + 1e-12 * size, rows = []; // beside the pole, where the matrix is regular
  for (let i = 0; i < 2 * n; i++) rows.push(Array.from({ length: 2 * n }, (_, j) => {
    const [r, c] = [i % n, j % n];
    if ((i < n) === (j < n)) return M[r][c] - (r === c ? shift : 0);
    return r === c ? (i < n ? y : -y) : 0;
  }));
  let v = Array.from({ length: 2 * n }, (_, k) => Math.cos(1 + k * k));
  for (let round = 0; round < 2; round++) {
    v = solve(rows, v);
    if (!v) return [new Array(count).fill(0), new Array(count).fill(0)];
    const long = Math.hypot(...v);
    v = v.map((entry) => entry / long);
  }
  const parts = Array.from({ length: count }, (_, k) => [v[k] * scale[k], v[n + k] * scale[k]]);
  const [a, b] = parts.reduce((best, one) => (Math.hypot(...one) > Math.hypot(...best) ? one : best), [0, 0]), square = a * a + b * b || 1;
  return [parts.map(([c, d]) => (c * a + d * b) / square), parts.map(([c, d]) => (d * a - c * b) / square)];
}

/** exp(M) by its series after halving; for M with at most some ten rows more than there are states. */
function exponential(M) {
  const n = M.length, size = Math.max(...M.map((row) => row.reduce((sum, entry) => sum + Math.abs(entry), 0)), 1e-300);
  const halvings = Math.max(0, Math.ceil(Math.log2(size)) + 4), small = M.map((row) => Array.from(row, (entry) => entry / 2 ** halvings));
  const unit = M.map((_, i) => Array.from({ length: n }, (_, j) => Number(i === j)));
  let sum = unit;
  for (let k = 12; k > 0; k--) sum = product(small, sum).map((row, i) => row.map((entry, j) => entry / k + unit[i][j]));
  for (let k = 0; k < halvings; k++) sum = product(sum, sum);
  return sum;
}

/** The response to a step of one input from rest: `x` and `y` at the `times` 0, dt, 2 dt ... */
function stepResponse({ A, B, C, D }, input, dt, count) {
  const n = A.length, wide = [...A.map((row, i) => [...row, B[i][input]]), new Array(n + 1).fill(0)];
  const E = exponential(wide.map((row) => row.map((entry) => entry * dt))), x = [new Array(n).fill(0)];
  for (let k = 1; k < count; k++) x.push(E.slice(0, n).map((row) => row.reduce((sum, entry, j) => sum + entry * (j < n ? x[k - 1][j] : 1), 0)));
  const y = x.map((state) => C.map((row, i) => row.reduce((sum, entry, j) => sum + entry * state[j], D[i][input])));
  return { times: x.map((_, k) => k * dt), x, y };
}
