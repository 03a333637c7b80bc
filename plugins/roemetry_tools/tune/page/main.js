// The page: one wish, which the form changes; each change is sent, and only the newest answer counts.
import { drawProfiles, drawRow } from "./charts.js";
import { element } from "./element.js";
import { makeForm } from "./form.js";
import { makeLayers } from "./layers.js";
import { showNumbers } from "./numbers.js";
import { makePicture } from "./picture.js";
import * as server from "./wire.js";

const $ = (id) => document.getElementById(id);
let recipe, wish, form, answer = null, saved = null, savedOf = "";
let busy = false, again = false, stripe = -1;

const layers = makeLayers($("layers"), () => picture.redraw());
const picture = makePicture($("picture"), layers.shown, looked);

function looked({ x, row, peak, chosen }) {
  if (!answer?.arrays) return;
  if (x !== null || peak >= 0) $("under").textContent = describe(x, row, peak);
  if (chosen && answer.arrays["peaks.stripe"]) stripe = peak >= 0 ? answer.arrays["peaks.stripe"].data[peak] : -1;
  charts();
}

function describe(x, row, peak) {
  const parts = [`row ${row}, x ${x.toFixed(1)}`];
  const grey = picture.greyRow(row)[Math.round(x)];
  if (grey !== undefined) parts.push(`grey ${Math.round((grey / 255) * answer.image.white)}`);
  if (peak >= 0) {
    const one = (name) => answer.arrays[`peaks.${name}`]?.data[peak];
    const std = one("x_std_px");
    parts.push(`peak at ${one("x_px").toFixed(2)} px${Number.isNaN(std) ? "" : ` ± ${std.toFixed(3)}`}`);
    parts.push(`amplitude ${one("amplitude").toFixed(0)}`, `width ${one("width_px").toFixed(1)} px`);
    const at = one("stripe");
    if (at >= 0) {
      const rows = answer.arrays["stripes.x_px"].shape[1];
      const place = at * rows + one("row");
      const product = answer.arrays["stripes.product"].data[place];
      const margin = answer.arrays["stripes.margin"].data[place];
      parts.push(`stripe ${at + 1}, on ${product > 0 ? `product ${product}` : "the belt"}`);
      if (!Number.isNaN(margin)) parts.push(`margin ${margin.toFixed(2)}`);
    } else if (at !== undefined) parts.push(at === -2 ? "ambiguous" : "unlabelled");
    if (one("flags") & 1) parts.push("saturated");
  }
  return parts.join(" · ");
}

function charts() {
  if (!answer?.arrays) return;
  if (answer.image.key) {
    $("row-title").textContent = `Grey levels of row ${picture.row}, in the frame's columns (click the frame, or arrow keys)`;
    drawRow($("row"), picture, answer);
  }
  const words = drawProfiles($("profiles"), answer, changed() ? saved : null, stripe);
  $("profiles-title").textContent = words
    ? `Profiles: ${words}${changed() ? "; grey: as the recipe is saved" : ""}` : "";
}

const changed = () => (answer?.changes.length ?? 0) > 0;

/** Send the wish; while an answer is on its way, remember that a newer one is wanted. */
async function send(draws = false) {
  wish.draws = draws;
  again = true;
  if (busy) return;
  busy = true;
  try {
    while (again) {
      again = false;
      const begin = performance.now();
      const given = await awaited(server.ask(wish));
      if (!again) await take(given, begin);
    }
    trouble("");
  } catch (error) {
    $("time").textContent = "";
    trouble(error instanceof TypeError ? "roemetry does not answer any more: was it stopped?" : error.message);
  } finally {
    busy = false;
  }
}

/** Wait for an answer, and say so where it takes long, as it does with a grid or a scan. */
async function awaited(coming) {
  const late = setTimeout(() => { $("time").textContent = "measuring …"; }, 300);
  try {
    return await coming;
  } finally {
    clearTimeout(late);
  }
}

async function take(given, begin) {
  await shown(given);
  requestAnimationFrame(() => { // behind the one that draws the picture: only now is the wish answered
    const took = performance.now() - begin;
    $("time").textContent = given.faults.length ? "" : `answered and drawn in ${took.toFixed(0)} ms`;
    const answers = 1 + Number(document.body.dataset.answers ?? 0);
    Object.assign(document.body.dataset, { took: took.toFixed(1), answers });
  });
}

async function shown(given) {
  const lost = form.show(given);
  trouble(lost.join("\n"));
  $("save").disabled = !given.changes.length || given.faults.length > 0;
  $("save").textContent = given.changes.length ? `Save ${given.changes.length} change${given.changes.length > 1 ? "s" : ""}…` : "Save…";
  $("undo").disabled = !given.changes.length;
  $("stale").hidden = !given.faults.length;
  if (given.faults.length) {
    if (answer) answer.changes = given.changes;
    return;
  }
  answer = given;
  frames(given);
  if (!given.changes.length) { saved = given; savedOf = given.acquisition; }
  else if (savedOf !== given.acquisition) await askSaved(given.acquisition);
  const pictured = Boolean(given.image.key); // of a scan there is none
  $("no-frame").hidden = pictured;
  for (const id of ["layers", "stage", "under", "row-figure"]) $(id).hidden = !pictured;
  layers.show(given);
  picture.show(given);
  showNumbers($("numbers"), given, saved, changed(), { count: recipe.draws, draw: () => send(true) }, picture.goTo);
  charts();
}

/** Ask what the recipe as it is saved makes of another frame. */
async function askSaved(acquisition) {
  const given = await server.ask({ ...asSaved(), acquisition });
  if (given.faults.length) return;
  saved = given;
  savedOf = acquisition;
}

const asSaved = () => ({
  acquisition: wish?.acquisition ?? "",
  source: { ...recipe.source.stated },
  stages: Object.fromEntries(recipe.stages.map(({ kind, chosen }) =>
    [kind, chosen && { use: chosen.use, options: { ...chosen.options } }])),
});

function frames(given) {
  const select = $("acquisition");
  const known = [...select.options].map((option) => option.value);
  if (known.join("\n") !== given.acquisitions.join("\n")) {
    select.replaceChildren(...given.acquisitions.map((id) => new Option(id, id)));
  }
  select.value = given.acquisition;
  $("previous").disabled = select.selectedIndex <= 0;
  $("next").disabled = select.selectedIndex >= select.options.length - 1;
}

function start(given) {
  recipe = given;
  wish = asSaved();
  $("product").textContent = given.product;
  $("file").textContent = given.path;
  document.title = `${given.name} · ${given.product} · roemetry tune`;
  form = makeForm($("form"), recipe, wish, () => send());
  send();
}

function trouble(said) {
  $("trouble").textContent = said;
  $("trouble").hidden = !said;
}

function step(by) {
  const select = $("acquisition");
  const to = select.options[select.selectedIndex + by];
  if (!to) return;
  wish.acquisition = to.value;
  send();
}

$("acquisition").addEventListener("change", () => { wish.acquisition = $("acquisition").value; send(); });
$("previous").addEventListener("click", () => step(-1));
$("next").addEventListener("click", () => step(1));
$("closer").addEventListener("click", () => picture.zoom(1.5));
$("farther").addEventListener("click", () => picture.zoom(1 / 1.5));
$("whole").addEventListener("click", () => picture.fit());
$("undo").addEventListener("click", () => start(recipe));
$("form").addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, select, textarea, dialog") || event.ctrlKey || event.metaKey) return;
  if (event.key === "n") step(1);
  if (event.key === "p") step(-1);
});
window.addEventListener("beforeunload", (event) => { if (changed()) event.preventDefault(); });
new ResizeObserver(charts).observe($("row"));

$("save").addEventListener("click", () => {
  $("changes").replaceChildren(...answer.changes.map(([path, before, after]) => element("tr", {},
    element("td", {}, path), element("td", { className: "soft" }, before || "–"), element("td", {}, "→"),
    element("td", {}, after || "taken away"))));
  $("save-name").value = recipe.name;
  $("save-fault").hidden = true;
  $("saving").showModal();
});
$("save-not").addEventListener("click", () => $("saving").close());
$("saving-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    const given = await server.save(wish, $("save-name").value.trim());
    $("saving").close();
    start(given.recipe);
    $("time").textContent = `saved ${given.path}`;
    $("file").textContent = `${given.path}: saved${given.old ? `; what it held before is in ${given.old}` : ""}`;
  } catch (error) {
    $("save-fault").textContent = error.message;
    $("save-fault").hidden = false;
  }
});

server.recipe().then(start, (error) => trouble(error.message));
