(function () {
  "use strict";
  // A cursor that follows a stripe: over the image, over the section through the product, in the 3-D view.
  var WIDE = 460, LEFT = 34, RIGHT = 12, TOP = 12, BELOW = 30;

  function element(name, attributes, inside) {
    var made = document.createElementNS(document.querySelector("svg").namespaceURI, name);
    Object.keys(attributes).forEach(function (key) { made.setAttribute(key, attributes[key]); });
    if (inside !== undefined) made.textContent = inside;
    return made;
  }

  function start(figure) {
    var solid = document.getElementById(figure.dataset.solid), data = readSolid(solid), head = data.head;
    var image = figure.querySelector("svg.screen"), chart = figure.querySelector("svg.chart"), said = figure.querySelector("output");
    var slices = data.slices, slice = 0, point = 0;
    var way = 1, y, scale, tall, up, z = [Math.min(0, head.low[2]), head.high[2]];
    var place = function (p) { return [LEFT + (p[way] + head.origin[way] - y[0]) * scale, TOP + tall - (p[2] + head.origin[2] - z[0]) * up]; };
    var spot = element("circle", { "class": "follow-spot", r: Math.max(image.viewBox.baseVal.width, image.viewBox.baseVal.height) / 90 });
    image.append(spot);
    highest();
    show();
    figure.hidden = false;

    function span(one, k) {
      var values = one.points.map(function (q) { return q.p[k] + head.origin[k]; });
      return [Math.min.apply(null, values), Math.max.apply(null, values)];
    }
    // The same scale for Y and Z where there is room, and one for all slices of a product; over X for a line across.
    function rescale(shown) {
      var x = span(shown, 0), own = span(shown, 1);
      way = x[1] - x[0] > own[1] - own[0] ? 0 : 1;
      y = [Infinity, -Infinity];
      slices.forEach(function (one) {
        var all = span(one, way);
        if (one.product === shown.product) y = [Math.min(y[0], all[0]), Math.max(y[1], all[1])];
      });
      scale = (WIDE - LEFT - RIGHT) / Math.max(1e-6, y[1] - y[0]);
      tall = Math.min(240, Math.max(110, (z[1] - z[0]) * scale));
      up = tall / (z[1] - z[0]);
      chart.setAttribute("viewBox", "0 0 " + WIDE + " " + (TOP + tall + BELOW));
    }
    function highest() {
      slices.forEach(function (one, i) {
        one.points.forEach(function (q, k) { if (q.p[2] > slices[slice].points[point].p[2]) { slice = i; point = k; } });
      });
    }

    function show() {
      var one = slices[slice], q = one.points[point];
      rescale(one);
      spot.setAttribute("cx", q.x);
      spot.setAttribute("cy", q.row);
      chart.replaceChildren();
      [z[0] < 0 ? 0 : z[0], z[1]].forEach(function (level) {
        var at = TOP + tall - (level - z[0]) * up;
        chart.append(element("path", { "class": "rule", d: "M" + LEFT + " " + at + "H" + (WIDE - RIGHT) }));
        chart.append(element("text", { "class": "end", x: LEFT - 5, y: at + 4 }, level.toFixed(level ? 1 : 0)));
      });
      y.forEach(function (v, k) {
        chart.append(element("text", { "class": k ? "end" : "start", x: k ? WIDE - RIGHT : LEFT, y: TOP + tall + 15 }, v.toFixed(0)));
      });
      chart.append(element("text", { x: WIDE / 2, y: TOP + tall + 26 }, "XY"[way] + ", mm · height Z, mm"));
      for (var i = 1; i < one.points.length; i++) {
        var a = one.points[i - 1], b = one.points[i];
        if (!b.joined) continue;
        var from = place(a.p), to = place(b.p);
        chart.append(element("path", { "class": a.seen && b.seen ? "seen" : "bridged", stroke: "#0d689c", d: "M" + from + "L" + to }));
      }
      one.points.forEach(function (alone, k) {
        var next = one.points[k + 1];
        if (alone.joined || (next && next.joined)) return;
        var there = place(alone.p);  // as a dot of a matrix of dots does, it stands by itself
        chart.append(element("circle", { cx: there[0], cy: there[1], r: 2, fill: "#0d689c" }));
      });
      var here = place(q.p);
      chart.append(element("path", { "class": "follow-cross", d: "M" + here[0] + " " + TOP + "V" + (TOP + tall) + "M" + LEFT + " " + here[1] + "H" + (WIDE - RIGHT) }));
      chart.append(element("circle", { "class": "follow-spot", cx: here[0], cy: here[1], r: 5 }));
      said.textContent = "stripe " + (one.stripe + 1) + ", row " + Math.round(q.row) + ": " + "XY"[way] + " " + (q.p[way] + head.origin[way]).toFixed(1)
        + " mm, height " + (q.p[2] + head.origin[2]).toFixed(2) + (isNaN(q.std) ? "" : " ± " + (q.std * head.std).toFixed(2)) + " mm, "
        + (q.seen ? "seen" : "bridged");
      solid.dispatchEvent(new CustomEvent("cursor", { detail: q.p }));
    }

    function nearest(of, distance) {
      var best = Infinity, found = 0;
      of.forEach(function (q, k) { var d = distance(q); if (d < best) { best = d; found = k; } });
      return [found, best];
    }
    function at(svg, event) {
      var place = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      return [place.x, place.y];
    }
    function overImage(event) {
      var here = at(image, event), best = Infinity;
      slices.forEach(function (one, k) {
        var found = nearest(one.points, function (q) { return Math.hypot(q.x - here[0], q.row - here[1]); });
        if (found[1] < best) { best = found[1]; slice = k; point = found[0]; }
      });
      show();
    }
    function overChart(event) {
      var here = at(chart, event);
      point = nearest(slices[slice].points, function (q) { return Math.hypot(place(q.p)[0] - here[0], 0.3 * (place(q.p)[1] - here[1])); })[0];
      show();
    }
    ["pointermove", "pointerdown"].forEach(function (kind) {
      image.addEventListener(kind, overImage);
      chart.addEventListener(kind, overChart);
    });
    image.addEventListener("keydown", function (event) {
      var row = slices[slice].points[point].row, step = event.shiftKey ? 10 : 1;
      var across = { ArrowLeft: -1, ArrowRight: 1 }[event.key], along = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (across) {
        slice = (slice + across + slices.length) % slices.length;
        point = nearest(slices[slice].points, function (q) { return Math.abs(q.row - row); })[0];
      } else if (along) point = Math.min(slices[slice].points.length - 1, Math.max(0, point + along * step));
      else return;
      event.preventDefault();
      show();
    });
  }
  document.querySelectorAll("figure.follow").forEach(start);
})();
