// Two charts under the frame: grey levels of one row, in the frame's own columns, and the profiles.
import { onPaper } from "./colours.js";

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = `${11 * ratio}px system-ui, sans-serif`;
  return { context, width, height, ratio };
}

/** Draw the grey levels of the row that was chosen, above each other with the picture's columns. */
export function drawRow(canvas, picture, answer) {
  const { context, width, height, ratio } = prepared(canvas);
  const grey = picture.greyRow(picture.row);
  if (!grey.length) return;
  const top = 15 * ratio, bottom = height - 3 * ratio;
  const x = (column) => (column + 0.5) * picture.view.scale + picture.view.x;
  const y = (level) => bottom - ((bottom - top) * level) / 255;
  context.strokeStyle = "#dfe4e9";
  context.fillStyle = "#667481";
  context.lineWidth = ratio;
  context.textAlign = "left";
  for (const level of [0, 64, 128, 192, 255]) {
    context.beginPath();
    context.moveTo(0, y(level));
    context.lineTo(width, y(level));
    context.stroke();
    const told = Math.round((level / 255) * answer.image.white);
    if (level % 128 === 0 || level === 255) context.fillText(told, 2 * ratio, y(level) + (level ? 11 : -3) * ratio);
  }
  const { arrays } = answer;
  if (arrays["peaks.x_px"]) marks();
  context.strokeStyle = "#17212b";
  context.lineWidth = 1.2 * ratio;
  context.beginPath();
  grey.forEach((level, column) => context.lineTo(x(column), y(level)));
  context.stroke();

  function marks() {
    const rows = arrays["peaks.row"].data, xs = arrays["peaks.x_px"].data;
    const stripes = arrays["peaks.stripe"]?.data;
    context.textAlign = "center";
    for (let i = 0; i < xs.length; i++) {
      if (rows[i] !== picture.row) continue;
      const stripe = stripes ? stripes[i] : -1;
      context.strokeStyle = context.fillStyle = stripe >= 0 ? onPaper(stripe) : stripe === -2 ? "#d11a1a" : "#7d8994";
      context.beginPath();
      context.moveTo(x(xs[i]), top);
      context.lineTo(x(xs[i]), bottom);
      context.stroke();
      context.fillText(stripes ? (stripe >= 0 ? stripe + 1 : stripe === -2 ? "◇" : "×") : "·", x(xs[i]), 11 * ratio);
    }
  }
}

/** Draw every slice on a product: height over Y, or displacement over the row; grey: as the recipe is saved. */
export function drawProfiles(canvas, answer, saved, stripe) {
  const { context, width, height, ratio } = prepared(canvas);
  const now = linesOf(answer), before = saved ? linesOf(saved) : null;
  if (!now) return "";
  const left = 38 * ratio, right = width - 8 * ratio, top = 8 * ratio, bottom = height - 20 * ratio;
  const both = [...now.lines, ...(before?.lines ?? [])];
  const [u0, u1] = extent(both.flatMap((line) => [...line.points.map((p) => p[0])]));
  const [v0, v1] = extent([0, ...both.flatMap((line) => line.points.map((p) => p[1]))]);
  if (!(u1 > u0)) {
    context.fillStyle = "#667481";
    context.fillText("nothing lies on a product", left, height / 2);
    return now.words;
  }
  const x = (u) => left + ((right - left) * (u - u0)) / (u1 - u0);
  const y = (v) => bottom - ((bottom - top) * (v - v0)) / (v1 - v0 || 1);
  axes();
  context.lineJoin = "round";
  if (before) for (const line of before.lines) path(line, "#c4ccd3", 1);
  for (const line of now.lines) if (line.stripe !== stripe) path(line, onPaper(line.stripe), stripe < 0 ? 1.4 : 0.9);
  for (const line of now.lines) if (line.stripe === stripe) path(line, onPaper(line.stripe), 2.6);
  return now.words;

  function axes() {
    context.strokeStyle = "#dfe4e9";
    context.fillStyle = "#667481";
    context.lineWidth = ratio;
    for (const v of ticks(v0, v1, 4)) {
      context.beginPath();
      context.moveTo(left, y(v));
      context.lineTo(right, y(v));
      context.stroke();
      context.textAlign = "right";
      context.fillText(v, left - 5 * ratio, y(v) + 4 * ratio);
    }
    context.textAlign = "center";
    for (const u of ticks(u0, u1, 7)) context.fillText(u, x(u), height - 5 * ratio);
  }

  function path(line, colour, wide) {
    context.strokeStyle = colour;
    context.lineWidth = wide * ratio;
    for (const seen of [1, 0]) {
      context.setLineDash(seen ? [] : [3 * ratio, 3 * ratio]);
      context.beginPath();
      for (let i = 1; i < line.points.length; i++) {
        const [one, other] = [line.points[i - 1], line.points[i]];
        if (other[3] !== one[3] + 1 || (one[2] && other[2] ? 1 : 0) !== seen) continue;
        context.moveTo(x(one[0]), y(one[1]));
        context.lineTo(x(other[0]), y(other[1]));
      }
      context.stroke();
    }
    context.setLineDash([]);
    context.fillStyle = colour;
    line.points.forEach(([along, height, , place], i) => { // a dot, or the only point for rows around
      if (line.points[i - 1]?.[3] === place - 1 || line.points[i + 1]?.[3] === place + 1) return;
      context.beginPath();
      context.arc(x(along), y(height), 1.6 * ratio, 0, 2 * Math.PI);
      context.fill();
    });
  }
}

/** Give the slices on products: (along, height, seen, place) for each point. */
function linesOf({ arrays }) {
  if (arrays["profiles.xyz_mm"]) {
    const [slices, points] = arrays["profiles.xyz_mm"].shape;
    const xyz = arrays["profiles.xyz_mm"].data, seen = arrays["profiles.seen"].data;
    const product = arrays["profiles.product"].data, stripe = arrays["profiles.stripe"].data;
    const lines = collected(slices, points, (at) => product[at] > 0 && !Number.isNaN(xyz[3 * at + 2]),
      (at) => [xyz[3 * at], xyz[3 * at + 1], xyz[3 * at + 2], seen[at]]);
    let across = false; // lines of a grid that run across are drawn over X
    for (const line of lines) {
      const [wide, tall] = [0, 1].map((axis) => {
        const [low, high] = extent(line.points.map((point) => point[axis]));
        return high - low;
      });
      const axis = wide > tall ? 0 : 1;
      across ||= axis === 0;
      line.stripe = stripe[line.index];
      line.points = line.points.map((point) => [point[axis], ...point.slice(2)]);
    }
    return { lines, words: `height Z over Y${across ? ", or over X along lines across" : ""}, mm, of every slice on a product` };
  }
  if (arrays["stripes.x_px"]) {
    const [stripes, rows] = arrays["stripes.x_px"].shape;
    const x = arrays["stripes.x_px"].data, rest = arrays["stripes.rest_px"].data;
    const product = arrays["stripes.product"].data, seen = arrays["stripes.seen"].data;
    const known = rest.some((value) => !Number.isNaN(value));
    const lines = collected(stripes, rows, (at) => product[at] > 0 && !Number.isNaN(x[at] - (known ? rest[at] : 0)),
      (at, i) => [i, x[at] - (known ? rest[at] : 0), seen[at]]);
    for (const line of lines) line.stripe = line.index;
    return { lines, words: known
      ? "displacement from the rest line over the image row, px, of every stripe on a product"
      : "x over the image row, px, of every stripe on a product" };
  }
  return null;
}

function collected(lines, points, has, give) {
  const found = [];
  for (let index = 0; index < lines; index++) {
    const line = { index, points: [] };
    for (let i = 0; i < points; i++) {
      const at = index * points + i;
      if (has(at)) line.points.push([...give(at, i), i]);
    }
    if (line.points.length) found.push(line);
  }
  return found;
}

function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) { if (value < low) low = value; if (value > high) high = value; }
  return [low, high];
}

function ticks(low, high, about) {
  const raw = (high - low) / about;
  const power = 10 ** Math.floor(Math.log10(raw || 1));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= raw);
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + 1e-9; at += step) found.push(Number(at.toPrecision(6)));
  return found;
}
