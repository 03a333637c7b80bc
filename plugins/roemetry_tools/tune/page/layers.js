// What can be drawn over the frame; each layer is a tick box, its sign, and how many there are.
import { element } from "./element.js";

const SATURATED = 1, EDGE = 2, WIDE = 4, UNLABELLED = -1, AMBIGUOUS = -2;

export const LAYERS = [
  { key: "peaks", name: "peaks", colour: "#f4f7fa", on: false, title: "every peak the extractor found" },
  { key: "stripes", name: "stripes", colour: "#56b4e9", on: true, title: "labelled stripes: thick on a product, thin on the belt, dashed where bridged" },
  { key: "rest", name: "rest lines", colour: "#6d7a86", on: false, title: "where each stripe would lie on the bare belt" },
  { key: "outline", name: "outline", colour: "#ffffff", on: true, title: "the product's contour" },
  { key: "saturated", name: "saturated", colour: "#ff5df2", on: true, problem: true, title: "peaks at the white level: their middle is a guess" },
  { key: "ambiguous", name: "ambiguous", colour: "#ff4d4d", on: true, problem: true, title: "peaks that may belong to several stripes and are left out" },
  { key: "gaps", name: "gaps", colour: "#ff9d2e", on: true, problem: true, title: "rows of a stripe between seen ones in which it was not seen" },
  { key: "unlabelled", name: "unlabelled", colour: "#9aa5b0", on: true, problem: true, title: "peaks taken for noise" },
  { key: "odd", name: "wide or at the edge", colour: "#5fd8d8", on: false, problem: true, title: "peaks wider than a stripe is, or too near the image's border" },
];

/** Make the tick boxes; gives a function that shows the counts. */
export function makeLayers(place, changed) {
  const shown = {};
  const counts = {};
  for (const layer of LAYERS) {
    shown[layer.key] = layer.on;
    const box = element("input", { type: "checkbox", checked: layer.on, id: `layer-${layer.key}` });
    box.addEventListener("change", () => { shown[layer.key] = box.checked; changed(); });
    const sign = element("i", { className: "sign" });
    sign.style.background = layer.colour;
    counts[layer.key] = element("b", {});
    place.append(element("label", { title: layer.title, className: layer.problem ? "problem" : "" },
      box, sign, layer.name, counts[layer.key]));
  }
  const show = ({ places, arrays }) => {
    const told = {
      peaks: places.peaks, saturated: places.saturated, ambiguous: places.ambiguous, gaps: places.gaps,
      unlabelled: places.unlabelled, stripes: arrays["stripes.x_px"]?.shape[0],
      odd: (places.edge ?? 0) + (places.wide ?? 0),
    };
    for (const [key, node] of Object.entries(counts)) {
      const count = told[key];
      node.textContent = count === undefined ? "" : count;
      node.parentElement.classList.toggle("none", count === 0);
    }
  };
  return { shown, show };
}

/** Say of each peak which layer of problems it belongs to. */
export function problemOf(arrays, peak) {
  const stripe = arrays["peaks.stripe"]?.data[peak];
  const flags = arrays["peaks.flags"].data[peak];
  const found = [];
  if (stripe === AMBIGUOUS) found.push("ambiguous");
  if (stripe === UNLABELLED) found.push("unlabelled");
  if (flags & SATURATED) found.push("saturated");
  if (flags & (EDGE | WIDE)) found.push("odd");
  return found;
}
