"use strict";
/* Sliders with fields to type in, and groups of elements that are one stop of the tab key. */

const make = (tag, text = "", kind = "") => Object.assign(document.createElement(tag), { textContent: text, className: kind });
const find = (id) => document.getElementById(id);

/** One stop of the tab key for all elements of a group: the keys `back` and `on` move among those shown. */
function roving(host, selector, back, on) {
  const seen = () => [...host.querySelectorAll(selector)].filter((one) => one.checkVisibility());
  const stop = (chosen) => host.querySelectorAll(selector).forEach((one) => { one.tabIndex = one === chosen ? 0 : -1; });
  const refresh = () => {
    const among = seen();
    stop(among.find((one) => one.tabIndex === 0 && one.dataset.stop) ?? among[0]);
  };
  host.addEventListener("keydown", (event) => {
    const among = seen(), at = among.indexOf(event.target), step = (event.key === on) - (event.key === back);
    if (at < 0 || !step) return;
    event.preventDefault();
    among[(at + step + among.length) % among.length].focus();
  });
  host.addEventListener("focusin", (event) => {
    if (!event.target.matches(selector)) return;
    host.querySelectorAll("[data-stop]").forEach((one) => { if (one.matches(selector)) delete one.dataset.stop; });
    event.target.dataset.stop = "yes";
    stop(event.target);
  });
  host.addEventListener("toggle", refresh, true);
  refresh();
  return refresh;
}

/**
 * A row with a name, a slider and a field. `change` gets what the slider says; the field has what is
 * shown: `toSlider` leads from there to the slider. The function that is returned shows numbers.
 */
function sliderRow(where, name, unit, [low, high], change, { title = "", toSlider = (value) => value } = {}) {
  const row = make("div", "", "slider"), input = make("input"), field = make("input"), beside = make("span", "", "unit");
  const label = make("span", name, "name");
  let shown = { unit: "", scale: 1 }, now = 0;
  Object.assign(input, { type: "range", min: low, max: high, step: "any", title });
  input.setAttribute("aria-label", name);
  input.setAttribute("aria-description", `${title}; up and down: other sliders; enter: type a number`);
  Object.assign(field, { type: "text", inputMode: "decimal", autocomplete: "off", tabIndex: -1 });
  field.setAttribute("aria-label", `${name}, number`);
  row.append(label, field, beside, input);
  find(where).append(row);
  input.addEventListener("input", () => change(Number(input.value)));
  input.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || /^[-.\d]$/.test(event.key)) field.focus();
  });
  const write = () => {
    field.value = short(now / shown.scale);
    field.removeAttribute("aria-invalid");
    field.title = "";
  };
  field.addEventListener("focus", () => {
    field.value = String(Number((now / shown.scale).toPrecision(9)));
    field.select();
  });
  field.addEventListener("blur", write);
  field.addEventListener("keydown", (event) => {
    if (event.key === "Escape") input.focus();
    if (event.key !== "Enter") return;
    const value = toSlider(numberOf(field.value) * shown.scale), slack = 1e-9 * (high - low);
    if (value >= low - slack && value <= high + slack) {
      change(Math.max(low, Math.min(high, value)));
      input.focus();
    } else {
      field.setAttribute("aria-invalid", "true");
      field.title = `a number; ${title}`;
    }
  });
  return (slid, value) => {
    now = value;
    shown = shownIn(value, unit);
    input.value = slid;
    beside.textContent = shown.unit;
    input.setAttribute("aria-valuetext", spelled(value, unit));
    if (document.activeElement !== field) write();
  };
}
