"use strict";
/* Numbers with units as engineers write them, 20 MN/m and 3·10⁻⁴ kg m², and the way back. */

const PREFIXES = { "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T" };
const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
const raised = (text) => [...String(text)].map((letter) => RAISED[letter] ?? letter).join("");

/** A number of four digits without a unit. */
function short(value) {
  if (value === 0 || !Number.isFinite(value)) return String(value || 0);
  if (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5) return String(Number(value.toPrecision(4)));
  const [digits, power] = value.toExponential(3).split("e");
  return `${Number(digits)}·10${raised(Number(power))}`;
}

/** How a value is shown: the `unit` as text, and the `scale` by which its number is smaller. */
function shownIn(value, unit) {
  const written = unit === "1" ? "" : unit.replace(/\^(-?\d+)/g, (_, power) => raised(power));
  const size = Math.abs(value), takes = /^(N|Pa|W|J|Hz|V|A|m|s)(?![\w^])/.test(unit);
  if (!takes || !(size > 0) || (size >= 1e-3 && size < 1e4)) return { unit: written, scale: 1 };
  const power = Math.max(-9, Math.min(12, 3 * Math.floor(Math.log10(size * (1 + 1e-9)) / 3)));
  return { unit: PREFIXES[power] + written, scale: 10 ** power };
}

/** A value with its unit, in one text. */
function spelled(value, unit) {
  const shown = shownIn(value, unit);
  return `${short(value / shown.scale)} ${shown.unit}`.trim();
}

/** The number of a text, NaN if it is none; a comma is a point, and 3·10⁻⁴ is read, too. */
function numberOf(text) {
  const plain = [...text.trim()].map((letter) => Object.keys(RAISED).find((key) => RAISED[key] === letter) ?? letter).join("");
  const tidy = plain.replace(",", ".").replace(/\s*[·*]\s*10\^?/, "e").replace("−", "-");
  return tidy === "" ? NaN : Number(tidy);
}
