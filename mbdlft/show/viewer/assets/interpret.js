"use strict";
/* Tapes of straight-line operations, and the linear equations that follow from them. */

/** Results of a tape, whose steps are [operation, target, first, second]; see mbdlft/show/viewer/data.py. */
function interpret(tape, ...given) {
  const w = new Float64Array(tape.registers), results = new Float64Array(tape.outputs);
  const { steps, constants } = tape;
  for (let k = 0; k < steps.length; k += 4) {
    const target = steps[k + 1], a = w[steps[k + 2]], b = w[steps[k + 3]];
    switch (steps[k]) {
      case 0: w[target] = constants[steps[k + 2]]; break;
      case 1: w[target] = given[steps[k + 2]][steps[k + 3]]; break;
      case 2: results[target] = a; break;
      case 3: w[target] = a; break;
      case 4: w[target] = a + b; break;
      case 5: w[target] = a - b; break;
      case 6: w[target] = a * b; break;
      case 7: w[target] = a / b; break;
      case 8: w[target] = -a; break;
      case 9: w[target] = a * a; break;
      case 10: w[target] = 2 * a; break;
      case 11: w[target] = 1 / a; break;
      case 12: w[target] = Math.sqrt(a); break;
      case 13: w[target] = Math.sin(a); break;
      case 14: w[target] = Math.cos(a); break;
      case 15: w[target] = Math.tan(a); break;
      case 16: w[target] = Math.atan(a); break;
      default: throw new Error(`unknown operation ${steps[k]}`);
    }
  }
  return results;
}

/** X of A X = B for a square A and B, arrays of rows, by elimination with pivots; null if A is singular. */
function solveAll(A, B) {
  const n = A.length, rows = A.map((row, i) => Float64Array.from([...row, ...B[i]]));
  for (let j = 0; j < n; j++) {
    let pivot = j;
    for (let i = j + 1; i < n; i++) if (Math.abs(rows[i][j]) > Math.abs(rows[pivot][j])) pivot = i;
    if (!(Math.abs(rows[pivot][j]) > 0)) return null;
    [rows[j], rows[pivot]] = [rows[pivot], rows[j]];
    for (let i = 0; i < n; i++) {
      if (i === j || rows[i][j] === 0) continue;
      const factor = rows[i][j] / rows[j][j];
      for (let k = j; k < rows[i].length; k++) rows[i][k] -= factor * rows[j][k];
    }
  }
  return rows.map((row, j) => Array.from(row.subarray(n), (entry) => entry / row[j]));
}

/** x of A x = b; null if A is singular. */
function solve(A, b) {
  const found = solveAll(A, Array.from(b, (entry) => [entry]));
  return found && found.map((row) => row[0]);
}

/** Efforts and loads at equilibrium for the parameters p; null where there is no single solution. */
function trimmed(trim, p) {
  const found = interpret(trim.tape, p), n = trim.unknown.length;
  const u = found.slice(n + n * n), rows = [];
  for (let i = 0; i < n; i++) rows.push(trim.unknown.map((_, j) => found[n + j * n + i]));
  const x = solve(rows, trim.unknown.map((_, i) => -found[i]));
  if (x === null) return null;
  trim.unknown.forEach((place, i) => { u[place] = x[i]; });
  return u;
}

/**
 * Closes the loops by moving the coordinates that follow (Gauss-Newton); the largest gap that is left.
 * Steps are limited, so that the assembly mode is kept where the other coordinates move slowly.
 */
function closeLoops(loops, p, q) {
  const { rows, follow } = loops;
  let gap = Infinity;
  for (let round = 0; round < 40; round++) {
    const found = interpret(loops.tape, p, q);
    gap = Math.max(...found.slice(0, rows).map(Math.abs));
    if (gap < 1e-13) break;
    const column = (k) => found.subarray(rows * (k + 1), rows * (k + 2));
    const dot = (a, b) => a.reduce((sum, entry, i) => sum + entry * b[i], 0);
    const J = follow.map(column);
    const step = solve(J.map((a) => J.map((b) => dot(a, b))), J.map((a) => -dot(a, found)));
    if (step === null) break;
    const largest = Math.max(...step.map(Math.abs)), part = largest > 0.5 ? 0.5 / largest : 1;
    follow.forEach((k, i) => { q[k] += part * step[i]; });
  }
  return gap;
}
