// A bounded number: a slider, a field for the exact value, and a button for each word that may stand instead.
import { element } from "./element.js";

const STEPS = 1000;

export function slider(field, id, set) {
  const scale = scaleOf(field);
  const range = element("input", { type: "range", min: 0, max: scale.steps, step: 1, tabIndex: 0 });
  range.setAttribute("aria-label", `${field.name}: slider`);
  const exact = element("input", { type: "text", id, className: "exact", inputMode: "decimal", spellcheck: false });
  const bounds = boundsOf(field);
  exact.title = bounds;
  const buttons = field.words.map((word) => {
    const text = word ?? "null";
    const button = element("button", { type: "button", className: "word" }, word ?? "none");
    button.addEventListener("click", () => { show(text); set(text); });
    return { text, button };
  });
  range.addEventListener("input", () => {
    const text = String(scale.value(Number(range.value)));
    show(text, false);
    set(text);
  });
  exact.addEventListener("input", () => {
    const text = exact.value.trim() || (field.words.includes(null) ? "null" : '""');
    place(text);
    set(text);
  });
  return {
    node: element("div", {}, range, exact, ...buttons.map((one) => one.button)),
    inputs: [exact, range],
    show,
  };

  function show(text, move = true) {
    const word = buttons.find((one) => one.text === text);
    exact.value = word || text === '""' ? "" : text;
    exact.placeholder = word ? word.button.textContent : "";
    place(text, move);
  }

  function place(text, move = true) {
    for (const one of buttons) one.button.setAttribute("aria-pressed", String(one.text === text));
    const number = Number(text);
    const known = text !== '""' && text !== "null" && Number.isFinite(number);
    range.classList.toggle("off", !known);
    range.setAttribute("aria-valuetext", text);
    if (known && move) range.value = String(scale.step(number));
  }
}

/** Where on the slider a value stands: as wide ranges begin small, they are drawn out at their lower end. */
export function scaleOf(field) {
  const whole = field.kind === "integer";
  const usual = typeof field.default === "number" ? field.default : null;
  const low = field.low ?? Math.min(0, usual ?? 0);
  const high = field.high !== null && field.high - low <= 1e5
    ? field.high : Math.max(4 * (usual ?? 0), low + (whole ? 100 : 10));
  const wide = high - low;
  const share = usual !== null ? (usual - low) / wide : wide > 200 ? 0.05 : 0.5;
  const power = share > 0 && share < 0.15 ? Math.min(4, Math.log(share) / Math.log(0.4)) : 1;
  const steps = whole && power === 1 && wide <= STEPS ? wide : STEPS;
  const value = (step) => {
    let found = low + wide * (step / steps) ** power;
    if (whole) found = Math.round(found);
    else found = low + neat(found - low, wide);
    if (field.low_open && found <= low) found = low + (whole ? 1 : neat(wide / steps, wide));
    if (field.high_open && found >= high) found = high - (whole ? 1 : neat(wide / steps, wide));
    return Number(found.toPrecision(10));
  };
  const step = (number) => Math.round(steps * Math.max(0, Math.min(1, (number - low) / wide)) ** (1 / power));
  return { steps, value, step };
}

/** Round to steps that people read: three figures, none finer than a thousandth of the range. */
function neat(number, wide) {
  const finest = 10 ** Math.floor(Math.log10(wide / STEPS));
  const coarse = 10 ** (Math.floor(Math.log10(Math.max(number, finest))) - 2);
  const unit = Math.max(coarse, finest / 10);
  return Number((Math.round(number / unit) * unit).toPrecision(10));
}

function boundsOf(field) {
  const parts = [];
  if (field.low !== null) parts.push(`${field.low_open ? "above" : "from"} ${field.low}`);
  if (field.high !== null) parts.push(`${field.high_open ? "below" : "up to"} ${field.high}`);
  return parts.join(", ");
}
