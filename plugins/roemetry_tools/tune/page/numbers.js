// The numbers, beside those of the recipe as it is saved, and the places to look at.
import { element } from "./element.js";

/** answer, saved: of the server; goTo(x, row): shows a place of the frame. */
export function showNumbers(place, answer, saved, changed, draws, goTo) {
  // draws: {count, draw}: the recipe's way to uncertainties, and what finds them
  const parts = [];
  for (const row of answer.rows) {
    const before = saved?.rows.find((one) => one.product === row.product);
    parts.push(productCard(row, before, changed));
  }
  if (draws.count) parts.push(drawing(answer, draws));
  parts.push(placesCard(answer, saved, changed, goTo));
  place.replaceChildren(...parts);
}

function drawing(answer, draws) {
  if (answer.drawn) return element("p", { className: "soft" }, `±: standard uncertainty, by ${answer.drawn}`);
  const button = element("button", { type: "button" }, `State uncertainties (${draws.count})`);
  button.title = "They are left out while you tune: they take their time";
  button.addEventListener("click", () => { button.disabled = true; button.textContent = "drawing…"; draws.draw(); });
  return element("p", {}, button);
}

function productCard(row, before, changed) {
  const card = element("section", { className: "card" });
  const name = row.product > 0 ? (row.products > 1 ? `Product ${row.product} of ${row.products}` : "Product") : "No product";
  card.append(element("h2", {}, name, " ", element("span", { className: `pill ${row.status}` }, row.status)));
  const table = element("table", { className: "values" });
  const head = element("tr", {}, element("th"), element("th", { className: "n" }, "now"));
  if (changed) head.append(element("th", { className: "n" }, "saved"));
  table.append(head);
  for (const [label, unit, now] of quantities(row)) {
    const then = before ? quantities(before).find((one) => one[0] === label)?.[2] : undefined;
    const line = element("tr", {}, element("th", {}, label, unit ? element("span", { className: "unit soft" }, ` ${unit}`) : ""));
    line.append(element("td", { className: `n ${changed && now !== then ? "differs" : ""}` }, now));
    if (changed) line.append(element("td", { className: "n soft" }, then ?? "–"));
    table.append(line);
  }
  if (table.rows.length > 1) card.append(table);
  const told = [...row.reasons, ...(row.grade?.reasons ?? []), ...(row.weight?.reasons ?? []), ...(row.volume?.reasons ?? []), ...(row.decision?.reasons ?? [])];
  for (const reason of Object.values(row.absent)) told.unshift(reason);
  const seen = new Set();
  const list = element("ul", { className: "reasons" });
  for (const reason of told) {
    if (seen.has(reason.text)) continue;
    seen.add(reason.text);
    const parts = reason.text.split("`").map((said, k) => (k % 2 ? element("code", {}, said) : said));
    list.append(element("li", {}, element("code", {}, reason.code), " ", ...parts));
  }
  if (list.children.length) card.append(list);
  return card;
}

function quantities(row) {
  const found = [];
  const put = (label, unit, estimate, per, digits) => {
    if (!estimate || estimate.value === null) return;
    const std = estimate.std / per;
    // as many decimals as two digits of the uncertainty have
    const places = std > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(std)), 0), 6) : digits;
    const said = (estimate.value / per).toFixed(places);
    found.push([label, unit, std > 0 ? `${said} ± ${std.toFixed(places)}` : said]);
  };
  const share = (label, value) => found.push([label, "%", (100 * value).toFixed(1)]);
  if (row.decision) {
    found.push(["decision", "", row.decision.label]);
    if (row.decision.lane) found.push(["lane", "", row.decision.lane]);
  }
  if (row.grade) {
    found.push(["grade", "", row.grade.label]);
    if (row.grade.probability !== null) found.push(["probability", "", row.grade.probability.toFixed(2)]);
  }
  put("mass", "g", row.weight?.mass_g, 1, 2);
  put("visible volume", "cm³", row.volume?.visible_mm3, 1000, 2);
  put("true volume", "cm³", row.volume?.true_mm3, 1000, 2);
  put("largest height", "mm", row.height_max_mm, 1, 2);
  if (row.volume) {
    share("seen", row.volume.shares.seen);
    share("interpolated", row.volume.shares.interpolated);
    share("assumed", row.volume.shares.assumed);
  }
  if (row.coding) {
    found.push(["stripes seen", "", `${row.coding.stripes_seen}/${row.coding.stripes}`]);
    found.push(["largest displacement", "px", (row.coding.displacement_max_px ?? 0).toFixed(2)]);
  }
  return found;
}

function placesCard(answer, saved, changed, goTo) {
  const card = element("section", { className: "card" }, element("h2", {}, "Places to look at"));
  const { places } = answer;
  const of = (kind) => (changed && saved ? ` (saved: ${saved.places[kind] ?? "–"})` : "");
  const list = element("ul", { className: "places" });
  const words = {
    saturated: "saturated peaks: less light, or a shorter exposure",
    ambiguous: "ambiguous peaks: left out of every number",
    gaps: "gaps along a stripe",
    unlabelled: "unlabelled peaks: taken for noise",
    wide: "peaks wider than a stripe",
    edge: "peaks at the image's border",
  };
  for (const [kind, said] of Object.entries(words)) {
    if (!places[kind]) continue;
    const button = element("button", { type: "button", className: `show ${kind}` }, "show");
    button.setAttribute("aria-label", `show the next of the ${said}`);
    let turn = 0;
    button.addEventListener("click", () => {
      const found = whereIs(kind, answer);
      if (found.length) goTo(...found[turn++ % found.length]);
    });
    list.append(element("li", {}, element("b", {}, places[kind]), ` ${said}${of(kind)} `, button));
  }
  for (const said of places.peak_reasons ?? []) list.append(element("li", {}, said));
  if (places.peaks === 0) list.append(element("li", {}, "no peaks at all: is the threshold too high?"));
  if (!list.children.length) list.append(element("li", { className: "soft" }, places.peaks === undefined ? "there are no peaks to judge" : "none found"));
  card.append(list);
  return card;
}

/** Give places of a kind as (x, row): of runs of neighbouring rows the middle one. */
function whereIs(kind, { places, arrays }) {
  if (kind === "gaps") return places.gap_list.map((gap) => [(gap.x_first + gap.x_last) / 2, (gap.first + gap.last) / 2]);
  const x = arrays["peaks.x_px"].data, rows = arrays["peaks.row"].data;
  const flags = arrays["peaks.flags"].data, stripe = arrays["peaks.stripe"]?.data;
  const test = {
    saturated: (i) => flags[i] & 1, edge: (i) => flags[i] & 2, wide: (i) => flags[i] & 4,
    ambiguous: (i) => stripe?.[i] === -2, unlabelled: (i) => stripe?.[i] === -1,
  }[kind];
  const groups = [];
  for (let i = 0; i < x.length; i++) {
    if (!test(i)) continue;
    const group = groups.find((one) => rows[i] - one.last <= 3 && Math.abs(one.x - x[i]) < 6);
    if (group) { group.last = rows[i]; group.x = x[i]; group.members.push(i); }
    else groups.push({ last: rows[i], x: x[i], members: [i] });
  }
  groups.sort((one, other) => other.members.length - one.members.length);
  return groups.map(({ members }) => {
    const middle = members[members.length >> 1];
    return [x[middle], rows[middle]];
  });
}
