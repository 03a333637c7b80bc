// The frame with what the stages made of it, drawn here so that a moved slider sends no picture.
import { onDark } from "./colours.js";
import { LAYERS, problemOf } from "./layers.js";

const COLOUR = Object.fromEntries(LAYERS.map((layer) => [layer.key, layer.colour]));

/** canvas; shown: which layers; looked(place): called with row, x and peak under the pointer or keys. */
export function makePicture(canvas, shown, looked) {
  const context = canvas.getContext("2d");
  const image = new Image();
  let answer = null, grey = null, row = 0, wanted = "";
  let size = { rows: 1, columns: 1 };
  const view = { scale: 1, x: 0, y: 0 }; // canvas px = (image px + 0.5) * scale + offset
  let fitted = true, waiting = false;

  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  new ResizeObserver(() => { resize(); redraw(); }).observe(canvas);
  image.addEventListener("load", () => { readGrey(); redraw(); looked({ row, x: null, peak: -1 }); });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), ...at(event));
  }, { passive: false });
  pointers();
  canvas.addEventListener("keydown", keys);
  return { show, redraw, zoom: (by) => zoom(by, canvas.width / 2, canvas.height / 2), fit, goTo, view,
    greyRow, get row() { return row; }, get size() { return size; } };

  function show(given) {
    answer = given;
    if (given.image.key) {
      const other = size.rows !== given.image.rows || size.columns !== given.image.columns;
      size = { rows: given.image.rows, columns: given.image.columns };
      if (wanted !== given.image.key) {
        wanted = given.image.key;
        image.src = `picture/${wanted}.png`;
      }
      if (other) {
        row = Math.floor(size.rows / 2);
        canvas.style.aspectRatio = `${size.columns} / ${size.rows}`;
        resize();
        fit();
      }
    }
    redraw();
  }

  function resize() {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    if (fitted) fit();
  }

  function fit() {
    fitted = true;
    view.scale = Math.min(canvas.width / size.columns, canvas.height / size.rows);
    view.x = (canvas.width - size.columns * view.scale) / 2;
    view.y = (canvas.height - size.rows * view.scale) / 2;
    redraw();
    looked({ row, x: null, peak: -1 });
  }

  function zoom(by, x, y) {
    const smallest = Math.min(canvas.width / size.columns, canvas.height / size.rows);
    const scale = Math.max(smallest, Math.min(60, view.scale * by));
    if (scale === smallest) return fit();
    fitted = false;
    view.x = x - ((x - view.x) * scale) / view.scale;
    view.y = y - ((y - view.y) * scale) / view.scale;
    view.scale = scale;
    hold();
    redraw();
    looked({ row, x: null, peak: -1 });
  }

  /** Keep the frame in sight. */
  function hold() {
    const wide = size.columns * view.scale, high = size.rows * view.scale;
    view.x = wide < canvas.width ? (canvas.width - wide) / 2 : Math.min(0, Math.max(canvas.width - wide, view.x));
    view.y = high < canvas.height ? (canvas.height - high) / 2 : Math.min(0, Math.max(canvas.height - high, view.y));
  }

  /** Bring a place into the middle, large. */
  function goTo(x, y) {
    row = Math.max(0, Math.min(size.rows - 1, Math.round(y)));
    view.scale = Math.max(view.scale, 5 * Math.min(canvas.width / size.columns, canvas.height / size.rows));
    fitted = false;
    view.x = canvas.width / 2 - (x + 0.5) * view.scale;
    view.y = canvas.height / 2 - (y + 0.5) * view.scale;
    hold();
    redraw();
    looked({ row, x, peak: nearest(x, row) });
  }

  function at(event) {
    const box = canvas.getBoundingClientRect();
    const ratio = canvas.width / box.width;
    return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  }

  function pointers() {
    const down = new Map();
    let moved = false;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      down.set(event.pointerId, at(event));
      moved = false;
    });
    canvas.addEventListener("pointermove", (event) => {
      const here = at(event);
      const before = down.get(event.pointerId);
      if (!before) return look(here, false);
      if (Math.hypot(here[0] - before[0], here[1] - before[1]) < 4 && !moved) return;
      moved = true;
      if (down.size === 2) {
        const other = [...down.entries()].find(([id]) => id !== event.pointerId)[1];
        zoom(Math.hypot(here[0] - other[0], here[1] - other[1])
          / Math.max(1, Math.hypot(before[0] - other[0], before[1] - other[1])), ...other);
      } else {
        fitted = false;
        view.x += here[0] - before[0];
        view.y += here[1] - before[1];
        hold();
        redraw();
        looked({ row, x: null, peak: -1 });
      }
      down.set(event.pointerId, here);
    });
    const up = (event) => {
      if (down.delete(event.pointerId) && !moved && event.type === "pointerup") look(at(event), true);
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
  }

  function look([x, y], chosen) {
    const column = (x - view.x) / view.scale - 0.5;
    const line = Math.round((y - view.y) / view.scale - 0.5);
    if (column < -0.5 || column > size.columns - 0.5 || line < 0 || line >= size.rows) return;
    if (chosen) { row = line; redraw(); }
    looked({ row: chosen ? row : line, x: column, peak: nearest(column, line), chosen });
  }

  function keys(event) {
    const step = event.shiftKey ? 10 : 1;
    if (event.key === "ArrowUp") row = Math.max(0, row - step);
    else if (event.key === "ArrowDown") row = Math.min(size.rows - 1, row + step);
    else if (event.key === "+" || event.key === "=") return zoom(1.4, canvas.width / 2, canvas.height / 2);
    else if (event.key === "-") return zoom(1 / 1.4, canvas.width / 2, canvas.height / 2);
    else if (event.key === "0") return fit();
    else return;
    event.preventDefault();
    redraw();
    looked({ row, x: null, peak: -1, chosen: true });
  }

  /** Find the peak next to a place, within a few pixels of the screen. */
  function nearest(x, line) {
    if (!answer?.arrays["peaks.x_px"]) return -1;
    const xs = answer.arrays["peaks.x_px"].data, rows = answer.arrays["peaks.row"].data;
    const reach = Math.max(1.5, 8 / view.scale);
    let best = -1, least = reach;
    for (let i = 0; i < xs.length; i++) {
      const off = Math.hypot(xs[i] - x, rows[i] - line);
      if (off < least) { least = off; best = i; }
    }
    return best;
  }

  function readGrey() {
    const hidden = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
    const ink = hidden.getContext("2d", { willReadFrequently: true });
    ink.drawImage(image, 0, 0);
    grey = ink.getImageData(0, 0, image.naturalWidth, image.naturalHeight);
  }

  function greyRow(line) {
    if (!grey || line < 0 || line >= grey.height) return [];
    return Array.from({ length: grey.width }, (_, x) => grey.data[4 * (line * grey.width + x)]);
  }

  function draw() {
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = "#0b0f14";
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (image.complete && image.naturalWidth) {
      context.imageSmoothingEnabled = view.scale < 2;
      context.drawImage(image, view.x, view.y, size.columns * view.scale, size.rows * view.scale);
    }
    if (!answer) return;
    const { arrays } = answer;
    if (shown.rest && arrays["stripes.rest_px"]) curves(arrays, "stripes.rest_px", () => 1, () => COLOUR.rest);
    if (shown.stripes && arrays["stripes.x_px"]) stripes(arrays);
    if (shown.peaks && arrays["peaks.x_px"]) dots(arrays);
    if (shown.outline) outlines(arrays);
    if (shown.gaps) gaps(answer.places.gap_list ?? []);
    problems(arrays);
    context.fillStyle = "rgba(255,255,255,.55)";
    const y = (row + 0.5) * view.scale + view.y;
    context.fillRect(0, y - 0.5, 9, 1.5);
    context.fillRect(canvas.width - 9, y - 0.5, 9, 1.5);
  }

  function px(x) { return (x + 0.5) * view.scale + view.x; }
  function py(y) { return (y + 0.5) * view.scale + view.y; }
  function unit() { return window.devicePixelRatio || 1; }

  function stripes(arrays) {
    const [, rows] = arrays["stripes.x_px"].shape;
    const product = arrays["stripes.product"].data, seen = arrays["stripes.seen"].data;
    curves(arrays, "stripes.x_px", (at) => (seen[at] ? (product[at] > 0 ? 3 : 1) : 2), onDark);
    context.font = `700 ${13 * unit()}px system-ui, sans-serif`;
    context.textAlign = "center";
    const x = arrays["stripes.x_px"].data;
    for (let stripe = 0; stripe < x.length / rows; stripe++) {
      let top = Math.max(0, Math.ceil(-view.y / view.scale));
      while (top < rows && Number.isNaN(x[stripe * rows + top])) top++;
      if (top >= rows) continue;
      const y = Math.max(py(top), 0) + 14 * unit();
      context.lineWidth = 4 * unit();
      context.strokeStyle = "#0b0f14";
      context.fillStyle = onDark(stripe);
      context.strokeText(stripe + 1, px(x[stripe * rows + top]), y);
      context.fillText(stripe + 1, px(x[stripe * rows + top]), y);
    }
  }

  /** Draw curves over (stripe, row); style(at): 1 thin, 2 dashed, 3 thick. */
  function curves(arrays, name, style, colour) {
    const { data, shape: [count, rows] } = arrays[name];
    for (let stripe = 0; stripe < count; stripe++) {
      const paths = { 1: new Path2D(), 2: new Path2D(), 3: new Path2D() };
      let before = NaN;
      for (let r = 0; r < rows; r++) {
        const at = stripe * rows + r;
        const x = data[at];
        if (!Number.isNaN(x) && !Number.isNaN(before)) {
          const path = paths[Math.max(style(at), style(at - 1) === 2 ? 2 : 0) === 2 ? 2 : style(at)];
          path.moveTo(px(before), py(r - 1));
          path.lineTo(px(x), py(r));
        }
        before = x;
      }
      context.strokeStyle = colour(stripe);
      for (const kind of [1, 2, 3]) {
        context.lineWidth = (kind === 3 ? 2.2 : 1) * unit();
        context.setLineDash(kind === 2 ? [3 * unit(), 3 * unit()] : []);
        context.globalAlpha = kind === 1 ? 0.75 : 1;
        context.stroke(paths[kind]);
      }
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  function dots(arrays) {
    const x = arrays["peaks.x_px"].data, rows = arrays["peaks.row"].data;
    const side = Math.max(1.2 * unit(), Math.min(5 * unit(), view.scale / 3));
    context.fillStyle = COLOUR.peaks;
    for (let i = 0; i < x.length; i++) context.fillRect(px(x[i]) - side / 2, py(rows[i]) - side / 2, side, side);
  }

  function outlines(arrays) {
    context.strokeStyle = COLOUR.outline;
    context.lineWidth = 1.2 * unit();
    for (const [name, { data }] of Object.entries(arrays)) {
      if (!name.startsWith("outline.")) continue;
      context.beginPath();
      for (let i = 0; i < data.length; i += 2) context.lineTo(px(data[i]), py(data[i + 1]));
      context.closePath();
      context.stroke();
    }
  }

  function gaps(list) {
    context.strokeStyle = COLOUR.gaps;
    context.lineWidth = 5 * unit();
    context.globalAlpha = 0.8;
    for (const gap of list) {
      context.beginPath();
      context.moveTo(px(gap.x_first), py(gap.first - 1));
      context.lineTo(px(gap.x_last), py(gap.last + 1));
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  function problems(arrays) {
    if (!arrays["peaks.x_px"]) return;
    const x = arrays["peaks.x_px"].data, rows = arrays["peaks.row"].data;
    const arm = Math.max(3, Math.min(7, view.scale)) * unit();
    const paths = { unlabelled: new Path2D(), odd: new Path2D(), ambiguous: new Path2D(), saturated: new Path2D() };
    for (let i = 0; i < x.length; i++) {
      for (const kind of problemOf(arrays, i)) {
        const path = paths[kind], cx = px(x[i]), cy = py(rows[i]);
        if (kind === "unlabelled") {
          path.moveTo(cx - arm, cy - arm); path.lineTo(cx + arm, cy + arm);
          path.moveTo(cx - arm, cy + arm); path.lineTo(cx + arm, cy - arm);
        } else if (kind === "ambiguous") {
          path.moveTo(cx, cy - arm * 1.3); path.lineTo(cx + arm * 1.3, cy); path.lineTo(cx, cy + arm * 1.3);
          path.lineTo(cx - arm * 1.3, cy); path.closePath();
        } else if (kind === "saturated") {
          path.rect(cx - arm / 2, cy - unit(), arm, 2 * unit());
        } else {
          path.rect(cx - arm, cy - arm, 2 * arm, 2 * arm);
        }
      }
    }
    context.lineWidth = 1.3 * unit();
    for (const [kind, path] of Object.entries(paths)) {
      if (!shown[kind]) continue;
      context.strokeStyle = context.fillStyle = COLOUR[kind];
      if (kind === "saturated") context.fill(path);
      else context.stroke(path);
    }
  }
}
