// The form: a card for the source and for each stage, a row for each option, made from what the plugins say.
import { element } from "./element.js";
import { slider } from "./slider.js";

/** Make the form.
 *  recipe: what the server says of it; wish: changed in place; changed(): called after each change. */
export function makeForm(place, recipe, wish, changed) {
  const cards = new Map();
  const kept = {}; // options by kind and plugin, so that a look at another plugin loses nothing
  place.replaceChildren();
  place.append(sourceCard());
  for (const stage of recipe.stages) place.append(stageCard(stage));
  return { show };

  function sourceCard() {
    const card = makeCard("source", "Source", element("span", { className: "soft" }, recipe.source.use));
    card.rows = fieldRows(card, recipe.source.fields, wish.source, recipe.source.stated);
    return card.node;
  }

  function stageCard(stage) {
    const select = element("select", { ariaLabel: `${stage.kind}: plugin` });
    const unsaid = stage.default ? `— ${stage.default}, by default —` : "— none —";
    if (!stage.required) select.append(new Option(unsaid, ""));
    for (const choice of stage.choices) {
      const option = new Option(choice.use, choice.use);
      option.disabled = Boolean(choice.missing);
      option.title = choice.missing || choice.summary;
      select.append(option);
    }
    const unknown = stage.chosen && !stage.choices.some((choice) => choice.use === stage.chosen.use);
    if (unknown) select.append(new Option(stage.chosen.use, stage.chosen.use));
    const card = makeCard(stage.kind, stage.kind[0].toUpperCase() + stage.kind.slice(1), select);
    const own = kept[stage.kind] = {};
    if (wish.stages[stage.kind]) own[wish.stages[stage.kind].use] = wish.stages[stage.kind].options;
    select.addEventListener("change", () => {
      const use = select.value;
      wish.stages[stage.kind] = use ? { use, options: own[use] ??= {} } : null;
      fill();
      changed();
    });
    fill();
    return card.node;

    function fill() {
      const wished = wish.stages[stage.kind];
      select.value = wished ? wished.use : "";
      const choice = stage.choices.find((one) => one.use === select.value);
      card.summary.textContent = choice ? choice.summary : "";
      card.summary.title = choice ? choice.reference : "";
      card.node.classList.toggle("out", !wished);
      const stated = stage.chosen && wished && stage.chosen.use === wished.use ? stage.chosen.options : {};
      card.rows = wished ? fieldRows(card, choice ? choice.fields : [], wished.options, stated) : new Map();
      if (!wished) card.body.replaceChildren();
    }
  }

  function makeCard(kind, title, chooser) {
    const time = element("span", { className: "ms soft" });
    const summary = element("p", { className: "summary soft" });
    const fault = element("p", { className: "fault", hidden: true });
    const body = element("div", { className: "fields" });
    const fold = element("button", { type: "button", className: "fold" }, title);
    const node = element("section", { className: "card" },
      element("div", { className: "card-head" }, element("h2", {}, fold), time, chooser), summary, fault, body);
    node.dataset.kind = kind;
    const folded = (now) => {
      node.classList.toggle("folded", now);
      fold.setAttribute("aria-expanded", String(!now));
    };
    fold.addEventListener("click", () => folded(!node.classList.contains("folded")));
    folded(kind === "source");
    const card = { node, time, summary, fault, body, rows: new Map() };
    cards.set(kind, card);
    return card;
  }

  function fieldRows(card, fields, values, stated) {
    const rows = new Map(fields.map((field) => [field.name, fieldRow(card.node.dataset.kind, field, values, stated)]));
    card.body.replaceChildren(...[...rows.values()].map((row) => row.node));
    return rows;
  }

  function fieldRow(kind, field, values, stated) {
    const id = `${kind}-${field.name}`;
    const label = element("label", { htmlFor: id }, field.name.replace(/^options\./, ""));
    const back = element("button", { type: "button", className: "back", title: "as the recipe has it" }, "↺");
    back.setAttribute("aria-label", `${field.name}: as the recipe has it`);
    const about = element("p", { className: "about", id: `${id}-about` }, field.description);
    const fault = element("p", { className: "fault", id: `${id}-fault`, hidden: true });
    const normal = field.required ? "" : inline(field.default);
    const set = (text) => {
      if (text === normal && !(field.name in stated) && !field.required) delete values[field.name];
      else values[field.name] = text;
      mark();
      changed();
    };
    const control = controlOf(field, id, set);
    control.node.classList.add("control");
    for (const input of control.inputs) input.setAttribute("aria-describedby", `${about.id} ${fault.id}`);
    back.addEventListener("click", () => {
      if (field.name in stated) values[field.name] = stated[field.name];
      else delete values[field.name];
      control.show(values[field.name] ?? normal);
      mark();
      changed();
    });
    const node = element("div", { className: "field" },
      element("div", { className: "field-head" }, label, element("span", { className: "unit soft" }, field.unit), back),
      control.node, fault, about);
    label.addEventListener("click", () => node.classList.toggle("open"));
    control.show(values[field.name] ?? normal);
    mark();
    return { node, fault, inputs: control.inputs };

    function mark() {
      const same = (values[field.name] ?? null) === (stated[field.name] ?? null);
      node.classList.toggle("changed", !same);
      node.classList.toggle("stated", field.name in values);
      back.hidden = same;
    }
  }

  /** Put times, refusals and faults where they belong; gives the faults that belong nowhere. */
  function show(answer) {
    for (const card of cards.values()) {
      card.fault.hidden = true;
      for (const row of card.rows.values()) {
        row.fault.hidden = true;
        for (const input of row.inputs) input.removeAttribute("aria-invalid");
      }
    }
    const lost = [];
    for (const { path, said } of answer.faults) {
      const [top, second, , name] = path;
      const card = cards.get(top === "stages" ? second : top);
      let key = name;
      if (top === "source") key = second === "options" ? `options.${path[2]}` : second;
      const row = card?.rows.get(String(key));
      if (row) {
        told(row.fault, said);
        card.node.classList.remove("folded");
        for (const input of row.inputs) input.setAttribute("aria-invalid", "true");
      } else if (card) {
        told(card.fault, path.length > 2 && path[2] !== "use" ? `${path.slice(3).join(".")}: ${said}` : said);
      } else {
        lost.push(path.length ? `${path.join(".")}: ${said}` : said);
      }
    }
    if (answer.faults.length) return lost;
    const refusals = { ...answer.absent };
    for (const row of answer.rows) {
      for (const [kind, reason] of Object.entries(row.absent)) refusals[kind] ??= reason.text;
    }
    for (const [kind, said] of Object.entries(refusals)) {
      const card = cards.get(kind);
      if (card) told(card.fault, said, "refused");
      else lost.push(`${kind}: ${said}`);
    }
    for (const [kind, card] of cards) {
      const seconds = answer.seconds_fresh[kind];
      card.time.textContent = seconds === undefined ? "" : `${(1000 * seconds).toFixed(1)} ms`;
    }
    return lost;
  }
}

function told(place, said, tone = "") {
  place.textContent = place.textContent && !place.hidden ? `${place.textContent}\n${said}` : said;
  place.className = `fault ${tone}`;
  place.hidden = false;
}

function controlOf(field, id, set) {
  if (field.kind === "number" || field.kind === "integer") return slider(field, id, set);
  if (field.kind === "choice") return choice(field, id, set);
  if (field.kind === "switch") return tick(id, set);
  return words(field, id, set);
}

function choice(field, id, set) {
  const select = element("select", { id });
  for (const word of [...field.words.map((one) => one ?? "null"), ...field.choices]) {
    select.append(new Option(word === "null" ? "none" : word, String(word)));
  }
  if (field.required) select.prepend(new Option("— choose —", ""));
  select.addEventListener("change", () => set(select.value));
  const show = (text) => {
    const value = plain(text);
    if (![...select.options].some((option) => option.value === value)) select.append(new Option(value, value));
    select.value = value;
  };
  return { node: element("div", {}, select), inputs: [select], show };
}

function tick(id, set) {
  const input = element("input", { type: "checkbox", id });
  const word = element("span", { className: "soft" });
  const say = () => { word.textContent = input.checked ? "on" : "off"; };
  input.addEventListener("change", () => { say(); set(String(input.checked)); });
  const show = (text) => { input.checked = text === "true"; say(); };
  return { node: element("div", {}, input, " ", word), inputs: [input], show };
}

function words(field, id, set) {
  const asIs = field.kind === "yaml";
  const input = element(asIs ? "textarea" : "input", { id, spellcheck: false });
  if (asIs) input.rows = 1;
  const nothing = field.words.includes(null) ? "none" : "";
  input.placeholder = nothing || (field.required ? "needed" : "");
  input.addEventListener("input", () => {
    const text = input.value.trim();
    grow();
    set(!text && (nothing || asIs) ? "null" : asIs ? text : JSON.stringify(text));
  });
  const grow = () => { if (asIs) input.rows = Math.min(8, Math.max(1, Math.ceil(input.value.length / 34))); };
  const show = (text) => {
    input.value = text === "null" ? "" : asIs ? text : plain(text);
    grow();
  };
  return { node: element("div", {}, input), inputs: [input], show };
}

const plain = (text) => (text.startsWith('"') ? JSON.parse(text) : text);

/** Write a default as a recipe would have it. */
export function inline(value) {
  if (Array.isArray(value)) return `[${value.map(inline).join(", ")}]`;
  if (value && typeof value === "object") {
    return `{${Object.entries(value).map(([key, item]) => `${key}: ${inline(item)}`).join(", ")}}`;
  }
  return typeof value === "string" && /^[A-Za-z_./][\w./ -]*$/.test(value) ? value : JSON.stringify(value);
}
