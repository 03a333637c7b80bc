(function () {
  "use strict";
  // The viewer: an orthographic picture drawn on a canvas, far things first. No WebGL, so that any number
  // of them can stand in a page and nothing depends on a graphics card.
  var HEIGHTS = ["#26456e", "#3f6b8c", "#5f8f98", "#8eb08f", "#c6c97c", "#f3dc78"];
  var DOUBTS = ["#cfe0e4", "#f0d58c", "#e29a3c", "#bf5420", "#7d1d1a"];
  var SEEN = "#0d689c", BRIDGED = "#c4292f", UNSTATED = "#aab4bd", WALL = "#c3ccd4", VOID = 3;
  var KINDS = ["#5d9cc0", "#e6b35a", "#eef1f4"];
  var KINDS_TOLD = ["rests on points that were seen", "rests on bridged points", "assumed: no stripe there"];
  var REST = { yaw: -28, rise: 34, zoom: 1 };

  // Cells of the surfaces, and the upright walls that close them down to the belt, with the way they face.
  function cells(data, ground) {
    var found = [];
    data.grids.forEach(function (grid) {
      var rows = grid.rows, columns = grid.columns, at = function (i, k) { return grid.vertices[i * columns + k]; };
      for (var i = 0; i + 1 < rows; i++) for (var k = 0; k + 1 < columns; k++) {
        var corners = [at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)];
        if (corners.every(function (q) { return q.kind !== VOID; })) found.push({ corners: corners });
      }
      if (grid.closed) for (i = 0; i + 1 < rows; i++) [[0, 1], [columns - 1, columns - 2]].forEach(function (k) { wall(at(i, k[0]), at(i + 1, k[0]), at(i, k[1])); });
      if (grid.closed) for (k = 0; k + 1 < columns; k++) [[0, 1], [rows - 1, rows - 2]].forEach(function (i) { wall(at(i[0], k), at(i[0], k + 1), at(i[1], k)); });
      found.forEach(function (cell) { if (cell.product === undefined) cell.product = grid.product; });
    });
    function wall(a, b, inner) {
      if (a.kind === VOID || b.kind === VOID) return;
      var foot = function (q) { return { p: [q.p[0], q.p[1], ground] }; };
      var facing = [b.p[1] - a.p[1], a.p[0] - b.p[0]];
      if (facing[0] * (a.p[0] - inner.p[0]) + facing[1] * (a.p[1] - inner.p[1]) < 0) facing = [-facing[0], -facing[1]];
      found.push({ corners: [a, b, foot(b), foot(a)], facing: facing });
    }
    return found;
  }

  function mixed(colours, share, light) {
    var place = Math.min(1, Math.max(0, share)) * (colours.length - 1), below = Math.min(Math.floor(place), colours.length - 2);
    var part = place - below;
    return "rgb(" + [1, 3, 5].map(function (k) {
      var a = parseInt(colours[below].substr(k, 2), 16), b = parseInt(colours[below + 1].substr(k, 2), 16);
      return Math.round((a + part * (b - a)) * light);
    }).join(",") + ")";
  }

  function start(figure) {
    var data = readSolid(figure), head = data.head, surface = cells(data, -head.origin[2]);
    var canvas = document.createElement("canvas"), ink = canvas.getContext("2d");
    if (!ink) return;
    var bar = document.createElement("div"), state = { yaw: REST.yaw, rise: REST.rise, zoom: REST.zoom, colour: head.coloured ? "image" : "height" };
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", figure.querySelector("svg").getAttribute("aria-label")
      + ". Arrow keys turn it, plus and minus zoom, 0 goes back.");
    bar.className = "solid-bar";
    choices();
    figure.querySelector(".solid-stage").append(canvas, bar);
    figure.classList.add("live");
    var span = head.high.map(function (v, k) { return v - head.low[k]; });
    var room = 0.1 * Math.max(span[0], span[1]);
    var x = [-span[0] / 2 - room, span[0] / 2 + room], y = [-span[1] / 2 - room, span[1] / 2 + room];
    var ground = -head.origin[2];
    new ResizeObserver(draw).observe(canvas);
    window.addEventListener("beforeprint", draw);
    turning();
    figure.addEventListener("cursor", function (event) { state.cursor = event.detail; draw(); });

    function choices() {
      var modes = [["height", "Height"], ["seen", "Seen and assumed"]];
      if (head.coloured) modes.unshift(["image", "Image"]);
      if (head.std > 0) modes.splice(-1, 0, ["std", "Uncertainty"]);
      modes.forEach(function (mode) {
        var button = document.createElement("button");
        button.type = "button";
        button.textContent = mode[1];
        button.setAttribute("aria-pressed", String(mode[0] === state.colour));
        button.addEventListener("click", function () {
          state.colour = mode[0];
          bar.querySelectorAll("[aria-pressed]").forEach(function (b) { b.setAttribute("aria-pressed", String(b === button)); });
          draw();
        });
        bar.append(button);
      });
      [["From above", 0, 90], ["From the side", 0, 4], ["Back", REST.yaw, REST.rise]].forEach(function (place) {
        var button = document.createElement("button");
        button.type = "button";
        button.textContent = place[0];
        button.addEventListener("click", function () { state.yaw = place[1]; state.rise = place[2]; state.zoom = 1; draw(); });
        bar.append(button);
      });
    }

    function turned(yaw, rise) {
      state.yaw = (state.yaw + yaw + 540) % 360 - 180;
      state.rise = Math.min(90, Math.max(0, state.rise + rise));
      draw();
    }
    function zoomed(by) { state.zoom = Math.min(12, Math.max(0.5, state.zoom * by)); draw(); }

    function turning() {
      var down = new Map();
      canvas.addEventListener("pointerdown", function (e) { canvas.setPointerCapture(e.pointerId); down.set(e.pointerId, [e.clientX, e.clientY]); });
      canvas.addEventListener("pointermove", function (e) {
        var was = down.get(e.pointerId);
        if (!was) return;
        if (down.size === 2) {
          var other = Array.from(down.entries()).find(function (d) { return d[0] !== e.pointerId; })[1];
          zoomed(apart([e.clientX, e.clientY], other) / Math.max(1, apart(was, other)));
        } else turned(-(e.clientX - was[0]) * 0.45, (e.clientY - was[1]) * 0.45);
        down.set(e.pointerId, [e.clientX, e.clientY]);
      });
      ["pointerup", "pointercancel"].forEach(function (kind) { canvas.addEventListener(kind, function (e) { down.delete(e.pointerId); }); });
      // The wheel scrolls the page; it zooms once the picture was clicked.
      canvas.addEventListener("wheel", function (e) {
        if (document.activeElement !== canvas) return;
        e.preventDefault();
        zoomed(Math.exp(-e.deltaY / 500));
      }, { passive: false });
      canvas.addEventListener("keydown", function (e) {
        var step = e.shiftKey ? 15 : 4;
        var keys = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
        if (keys[e.key]) turned.apply(null, keys[e.key]);
        else if (e.key === "+" || e.key === "=") zoomed(1.2);
        else if (e.key === "-") zoomed(1 / 1.2);
        else if (e.key === "0") { Object.assign(state, REST); draw(); }
        else return;
        e.preventDefault();
      });
    }
    function apart(a, b) { return Math.hypot(a[0] - b[0], a[1] - b[1]); }

    function draw() {
      var ratio = window.devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
      if (!w || !h) return;
      if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
      var yaw = state.yaw * Math.PI / 180, rise = state.rise * Math.PI / 180;
      var right = [Math.cos(yaw), Math.sin(yaw), 0];
      var up = [-Math.sin(yaw) * Math.sin(rise), Math.cos(yaw) * Math.sin(rise), Math.cos(rise)];
      var near = [Math.sin(yaw) * Math.cos(rise), -Math.cos(yaw) * Math.cos(rise), Math.sin(rise)];
      var reach = Math.hypot(x[1] - x[0], y[1] - y[0]);
      var scale = state.zoom * Math.min((w - 50 * ratio) / reach, h * 0.9 / Math.max(reach * 0.62, span[2] * 1.2));
      function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
      function at(p) { return [w / 2 + scale * dot(p, right), h / 2 - scale * dot(p, up)]; }
      ink.setTransform(1, 0, 0, 1, 0, 0);
      ink.fillStyle = "#f7f9fa";
      ink.fillRect(0, 0, w, h);
      belt();
      // Product by product from the far one on: the far walls, the surface with its lines, the near walls.
      var depth = {};
      surface.forEach(function (cell) {
        (depth[cell.product] = depth[cell.product] || []).push(middle(cell.corners));
      });
      Object.keys(depth).forEach(function (key) { depth[key] = depth[key].reduce(function (a, b) { return a + b; }, 0) / depth[key].length; });
      var things = surface.map(function (cell) {
        var layer = !cell.facing ? 1 : cell.facing[0] * near[0] + cell.facing[1] * near[1] > 0 ? 2 : 0;
        return { product: cell.product, layer: layer, z: middle(cell.corners), cell: cell };
      });
      data.slices.forEach(function (slice) {
        for (var i = 1; i < slice.points.length; i++) {
          var a = slice.points[i - 1], b = slice.points[i];
          // a little nearer, so that a line is not hidden by the surface it lies in
          if (b.joined) things.push({ product: slice.product, layer: 1, z: (dot(a.p, near) + dot(b.p, near)) / 2 + 0.02 * reach, line: [a, b] });
        }
      });
      things.sort(function (a, b) {
        return (a.product !== b.product && depth[a.product] - depth[b.product]) || a.layer - b.layer || a.z - b.z;
      });
      ink.lineCap = "round";
      things.forEach(function (thing) { if (thing.cell) fill(thing.cell); else stroke(thing.line); });
      words();
      cursor();

      function cursor() {
        if (!state.cursor) return;
        var place = at(state.cursor);
        ink.beginPath();
        ink.arc(place[0], place[1], 5 * ratio, 0, 7);
        ink.lineWidth = 2.5 * ratio;
        ink.strokeStyle = "#c4292f";
        ink.fillStyle = "#fff";
        ink.fill();
        ink.stroke();
      }

      function middle(corners) { return corners.reduce(function (sum, c) { return sum + dot(c.p, near); }, 0) / 4; }

      function belt() {
        var lines = [];
        var step = neat(Math.max(x[1] - x[0], y[1] - y[0]) / 8);
        path([[x[0], y[0], ground], [x[1], y[0], ground], [x[1], y[1], ground], [x[0], y[1], ground]]);
        ink.fillStyle = "#e6ebef";
        ink.fill();
        [0, 1].forEach(function (k) {
          var ends = k ? y : x, others = k ? x : y;
          for (var v = Math.ceil((ends[0] + head.origin[k]) / step) * step; v <= ends[1] + head.origin[k]; v += step) {
            var p = v - head.origin[k];
            lines.push(k ? [[others[0], p, ground], [others[1], p, ground]] : [[p, others[0], ground], [p, others[1], ground]]);
          }
        });
        ink.strokeStyle = "#cbd4db";
        ink.lineWidth = ratio;
        lines.forEach(function (l) { ink.beginPath(); ink.moveTo.apply(ink, at(l[0])); ink.lineTo.apply(ink, at(l[1])); ink.stroke(); });
        canvas.dataset.grid = step;
      }

      function path(points) {
        ink.beginPath();
        points.forEach(function (p) { ink.lineTo.apply(ink, at(p)); });
        ink.closePath();
      }

      function fill(cell) {
        var corners = cell.corners;
        var a = corners[0].p, b = corners[1].p, c = corners[3].p;
        var u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
        var n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        var light = 0.72 + 0.28 * Math.abs(n[0] * -0.35 + n[1] * -0.35 + n[2] * 0.87) / (Math.hypot(n[0], n[1], n[2]) || 1);
        path(corners.map(function (q) { return q.p; }));
        ink.fillStyle = ink.strokeStyle = cell.facing ? mixed([WALL, WALL], 0, light) : colourOf(corners, light);
        ink.lineWidth = 0.7 * ratio; // closes the hairlines between cells
        ink.fill();
        ink.stroke();
      }

      function colourOf(corners, light) {
        function mean(of) { return corners.reduce(function (sum, q) { return sum + of(q); }, 0) / corners.length; }
        if (state.colour === "height") return mixed(HEIGHTS, mean(function (q) { return q.p[2] + head.origin[2]; }) / head.high[2], light);
        if (state.colour === "seen") {
          var kind = Math.max.apply(null, corners.map(function (q) { return q.kind; }));
          return mixed([KINDS[kind], KINDS[kind]], 0, light);
        }
        if (state.colour === "image") return "rgb(" + [0, 1, 2].map(function (k) {
          return Math.round(mean(function (q) { return q.rgb[k]; }) * (0.55 + 0.45 * light));
        }).join(",") + ")";
        var std = mean(function (q) { return q.std; });
        return isNaN(std) ? mixed([UNSTATED, UNSTATED], 0, light) : mixed(DOUBTS, std, light);
      }

      function stroke(line) {
        var seen = line[0].seen && line[1].seen;
        ink.strokeStyle = state.colour === "seen" ? (seen ? SEEN : BRIDGED)
          : state.colour === "std" ? (isNaN(line[1].std) ? UNSTATED : mixed(DOUBTS, line[1].std, 0.85)) : state.colour === "image" ? "rgba(255,255,255,.45)" : "rgba(23,33,43,.8)";
        ink.lineWidth = (state.colour === "height" || state.colour === "image" ? 1 : 2.4) * ratio;
        ink.setLineDash(seen || state.colour !== "height" ? [] : [2 * ratio, 3 * ratio]);
        ink.beginPath();
        ink.moveTo.apply(ink, at(line[0].p));
        ink.lineTo.apply(ink, at(line[1].p));
        ink.stroke();
        ink.setLineDash([]);
      }

      function words() {
        ink.font = 12 * ratio + "px system-ui, sans-serif";
        ink.fillStyle = "#4f5d6a";
        ink.textAlign = "center";
        var out = 0.4 * room, ends = [["X", [x[1] + out, y[0], ground]], ["Y", [x[0], y[1] + out, ground]]];
        ends.forEach(function (end) { ink.fillText(end[0], at(end[1])[0], at(end[1])[1] + 4 * ratio); });
        ink.textAlign = "left";
        var left = 10 * ratio, base = h - 10 * ratio;
        if (state.colour === "seen") {
          KINDS_TOLD.forEach(function (told, k) {
            ink.fillStyle = KINDS[k];
            ink.fillRect(left, base - (2 - k) * 17 * ratio - 9 * ratio, 16 * ratio, 9 * ratio);
            ink.strokeStyle = "#93a1ae";
            ink.lineWidth = ratio;
            ink.strokeRect(left, base - (2 - k) * 17 * ratio - 9 * ratio, 16 * ratio, 9 * ratio);
            ink.fillStyle = "#4f5d6a";
            ink.fillText(told, left + 22 * ratio, base - (2 - k) * 17 * ratio);
          });
        } else if (state.colour === "image") {
          ink.fillText("image projected onto the surface", left, base);
        } else {
          var colours = state.colour === "height" ? HEIGHTS : DOUBTS, top = state.colour === "height" ? head.high[2] : head.std;
          for (var i = 0; i < 120; i++) {
            ink.fillStyle = mixed(colours, i / 119, 1);
            ink.fillRect(left + i * ratio, base - 10 * ratio, 1.5 * ratio, 10 * ratio);
          }
          ink.fillStyle = "#4f5d6a";
          ink.fillText((state.colour === "height" ? "height 0…" + top.toFixed(1) : "standard uncertainty of a point 0…" + top.toPrecision(2)) + " mm",
            left + 128 * ratio, base);
        }
        ink.textAlign = "right";
        ink.fillText("a square is " + canvas.dataset.grid + " mm", w - 10 * ratio, base);
      }
    }
    function neat(raw) {
      var power = Math.pow(10, Math.floor(Math.log10(raw)));
      return power * [1, 2, 5, 10].find(function (k) { return k * power >= raw; });
    }
  }

  var waiting = document.querySelectorAll("figure.solid");
  if (!("IntersectionObserver" in window)) return;
  var watch = new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) {
      if (!entry.isIntersecting) return;
      watch.unobserve(entry.target);
      start(entry.target);
    });
  }, { rootMargin: "300px" });
  waiting.forEach(function (figure) { watch.observe(figure); });
})();
