// The operator's page: shows the states that the server streams, and asks for what a person may do.
"use strict";
const by = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
let who = { name: null, role: "viewer" };
let chosen = null, last = null, shown = null, heard = 0, checked = null;

function make(tag, text, kind) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}
function draw(tag, given) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(given)) made.setAttribute(name, value);
  return made;
}
function list(id, pairs) {
  by(id).replaceChildren(...pairs.flatMap(([name, value, kind]) => [make("dt", name), make("dd", value, kind)]));
}
const number = (value, digits) => value === null || value === undefined ? "not known" : value.toFixed(digits);
const at = (seconds) => new Date(1000 * seconds).toLocaleTimeString();

async function ask(path, body) {
  const answer = await fetch(path, { method: "POST", body: JSON.stringify(body || {}),
    headers: { "Content-Type": "application/json", "X-CSRF-Token": who.csrf || "" } });
  const said = await answer.json();
  if (!answer.ok) throw new Error(said.said || answer.statusText);
  return said;
}

async function learnWho() {
  who = await (await fetch("/who")).json();
  const button = make("button", who.name ? `${who.name} (${who.role}): log out` : "Log in");
  button.onclick = async () => {
    if (!who.name) return by("log-in").showModal();
    await ask("/log-out");
    await learnWho();
  };
  by("user").replaceChildren(button);
  if (last) show(last);
}

function showAlarms(alarms) {
  const old = Date.now() / 1000 - 60;
  const seen = alarms.filter((one) => one.ended === null || (one.acknowledged === null && one.level !== "note")
    || (one.level === "note" && one.at > old)).slice(0, 8);
  const told = JSON.stringify([seen, who.role]); // a button that is made anew under the finger takes no click
  if (by("alarms").dataset.told === told) return;
  by("alarms").dataset.told = told;
  by("alarms").replaceChildren(...seen.map((one) => {
    const open = one.ended === null;
    const line = make("p", "", open ? "open" : "");
    line.append(make("strong", open ? "NOW" : one.level === "note" ? "note" : "was", one.level === "note" ? "" : "bad"),
      make("span", `${at(one.at)} ${one.station}: ${one.text}`));
    if (one.acknowledged !== null) line.append(make("em", `seen by ${one.acknowledged_by}`));
    else if (one.level !== "note" && who.role !== "viewer") {
      const button = make("button", "Acknowledge");
      button.onclick = () => ask(`/acknowledge/${one.n}`).catch((error) => alert(error.message));
      line.append(button);
    }
    return line;
  }));
}

function showProduct(station) {
  const told = station.last && station.last.summary;
  if (!told) { by("decision").textContent = "no product yet"; return list("numbers", []); }
  const word = told.decision || told.grade || told.status;
  by("decision").textContent = word + (told.lane ? ` → ${told.lane}` : "") + (told.late ? " (late)" : "");
  by("decision").className = "decision " + (told.status === "measured" ? "" : "bad");
  const spread = told.mass_std_g === null ? "" : ` ± ${told.mass_std_g.toFixed(2)}`;
  list("numbers", [["product", told.id], ["taken", at(station.last.at)],
    ["mass, g", number(told.mass_g, 2) + spread],
    ["volume, cm³", told.volume_mm3 === null ? "not known" : (told.volume_mm3 / 1000).toFixed(2)],
    ["height, mm", number(told.height_mm, 2)], ["reason", told.reason || "none"]]);
}

async function showPicture(station) {
  const key = station.last && station.last.key;
  if (!key || key === shown) return;
  shown = key;
  const answer = await fetch(`/picture/${station.name}`);
  if (answer.status !== 200) return;
  const overlay = await answer.json();
  by("image").parentElement.hidden = false;
  by("image").src = `data:image/jpeg;base64,${overlay.jpeg}`;
  by("caption").textContent = `image ${overlay.acquisition}`;
  const svg = by("overlay");
  svg.setAttribute("viewBox", `-0.5 -0.5 ${overlay.columns} ${overlay.rows}`);
  // One path for all dots: thousands of elements a second are too many for a tablet.
  const way = (wanted) => overlay.points.filter(([, , product]) => Boolean(product) === wanted)
    .map(([x, y]) => `M${x} ${y}h0`).join("");
  const dots = [draw("path", { d: way(false), class: "belt" }), draw("path", { d: way(true), class: "product" })];
  const lines = overlay.outlines.map((points) => draw("polygon", { points: points.join(" "), class: "outline" }));
  svg.replaceChildren(...dots, ...lines);
}

function showHealth(state, station) {
  const f = station.figures;
  const mean = f.latency_counts ? f.latency_ms_sum / Math.max(1, f.latency_counts.reduce((a, b) => a + b)) : null;
  const kind = station.state === "running" ? "good" : "bad";
  const rows = [["station", station.state, kind],
    ["last sign of the camera", station.frame_age_s === null ? "none" : `${station.frame_age_s.toFixed(1)} s ago`,
      station.frame_age_s < 3 ? "good" : "bad"],
    ["frames", f.frames], ["lost", f.lost, f.lost ? "bad" : ""], ["incomplete", f.incomplete, f.incomplete ? "bad" : ""],
    ["late" + (station.deadline_ms ? ` (over ${station.deadline_ms} ms)` : ""), f.late, f.late ? "bad" : ""],
    ["time to result, ms", mean === null ? "" : `${mean.toFixed(1)} (worst ${f.latency_ms_worst.toFixed(0)})`],
    ["light of the stripes, % of white", number(f.laser_percent, 0), f.laser_percent === 0 ? "bad" : ""],
    ["waiting frames", f.queue], ["free on disk, GB", number(f.disk_free_gb, 1)]];
  for (const one of state.outlets)
    rows.push([`to ${one.name}`, one.state + (one.waiting ? `, ${one.waiting} waiting` : ""),
      one.state === "connected" ? "good" : "bad"]);
  list("health", rows.map(([a, b, c]) => [a, b === undefined ? "" : String(b), c]));
}

function showRejects(station) {
  const keys = station.rejects.map((row) => row.key).join();
  if (by("rejects").dataset.keys === keys) return;
  by("rejects").dataset.keys = keys;
  by("rejects").replaceChildren(...station.rejects.map((row) => {
    const told = row.summary, item = make("li"), image = make("img");
    image.alt = `image of ${told.id}`;
    image.loading = "lazy";
    image.src = `/spooled/${station.name}/${row.run}/${told.id.split("#")[0]}.jpg`;
    item.append(image, make("span", `${at(row.at)} ${told.id}: ${told.decision || told.grade || told.status}`
      + (told.reason ? ` (${told.reason})` : "")));
    return item;
  }));
}

function showRecipes(station) {
  const select = by("recipe");
  if (document.activeElement === select) return;
  select.disabled = who.role !== "engineer" || station.recipes.length < 2;
  select.replaceChildren(...station.recipes.map((path) => {
    const option = make("option", path.split("/").slice(-2).join("/"));
    option.value = path;
    option.selected = path === station.recipe;
    return option;
  }));
  select.onchange = () => ask(`/recipe/${station.name}`, { recipe: select.value })
    .then(() => { by("recipe-said").textContent = "chosen; it measures as soon as it is loaded"; })
    .catch((error) => { by("recipe-said").textContent = error.message; });
}

function show(state) {
  last = state;
  by("line").textContent = state.line;
  const station = state.stations.find((one) => one.name === chosen) || state.stations[0];
  chosen = station.name;
  by("stations").replaceChildren(...state.stations.map((one) => {
    const button = make("button", one.name);
    button.setAttribute("aria-pressed", one === station);
    button.onclick = () => { chosen = one.name; shown = null; checked = null; show(last); showTrend(); showDrift(); };
    return button;
  }));
  showAlarms(state.alarms);
  showProduct(station);
  showHealth(state, station);
  showRecipes(station);
  showCheck(station);
  list("counts", Object.entries(station.figures.results || {}).map(([name, count]) => [name, String(count)]));
  showRejects(station);
  showPicture(station).catch(() => {});
}

async function showTrend() {
  if (!chosen) return;
  const answer = await fetch(`/trend/${chosen}?figure=${by("figure").value}&hours=24`);
  const found = await answer.json();
  if (!answer.ok) return by("trend").replaceChildren(make("p", found.said));
  // The pictures are the server's own SVG, with every word in them escaped.
  const parts = found.charts.flatMap((chart) => {
    const means = make("div"), ewma = make("div");
    means.innerHTML = chart.means;
    ewma.innerHTML = chart.ewma;
    return [make("h3", chart.product), make("p", "means by hour", "small"), means,
      make("p", "moving mean by product (EWMA)", "small"), ewma, make("p", chart.said, "small")];
  });
  by("trend").replaceChildren(...(parts.length ? parts : [make("p", "nothing measured in the last 24 hours")]));
}

async function showDrift() {
  if (!chosen || !by("drift").open) return;
  const answer = await fetch(`/checks/${chosen}`);
  const found = await answer.json();
  if (!answer.ok) return by("drift-plots").replaceChildren(make("p", found.said));
  by("drift-plots").replaceChildren(...(found.plots.length ? found.plots.flatMap(([words, plot]) => {
    const picture = make("div");
    picture.innerHTML = plot;
    return [make("p", words, "small"), picture];
  }) : [make("p", "no check of this calibration yet")]));
}

function showCheck(station) {
  const check = station.check;
  const waits = check && check.ended === null;
  by("check").hidden = who.role === "viewer";
  by("check").disabled = waits;
  by("check").onclick = () => ask(`/check/${station.name}`)
    .catch((error) => { by("check-said").textContent = error.message; });
  if (!check) { by("check-said").textContent = "not checked from here yet"; return; }
  by("check-said").textContent = waits ? "waits for a frame: put the block before the camera"
    : `${at(check.ended)}: ${check.text}`;
  by("check-said").className = waits ? "" : { "in order": "good", drifting: "warn" }[check.verdict] || "bad";
  if (checked !== check.n && !waits) { checked = check.n; showDrift(); }
}

by("figure").onchange = showTrend;
by("drift").ontoggle = showDrift;
by("log-in-open").onclick = () => by("log-in").showModal();
by("log-in-close").onclick = () => by("log-in").close();
by("log-in-form").onsubmit = async (event) => {
  event.preventDefault();
  try {
    await ask("/log-in", { name: by("name").value, password: by("password").value });
    by("password").value = "";
    by("log-in-said").textContent = "";
    by("log-in").close();
    await learnWho();
  } catch (error) { by("log-in-said").textContent = error.message; }
};
const source = new EventSource("/events");
source.onmessage = (event) => {
  heard = Date.now();
  by("link").textContent = "live";
  by("link").className = "good";
  show(JSON.parse(event.data));
};
setInterval(() => {
  if (Date.now() - heard < 2000) return;
  by("link").textContent = "no connection to the line";
  by("link").className = "bad";
}, 500);
setInterval(showTrend, 10000);
setTimeout(showTrend, 1500);
learnWho();
