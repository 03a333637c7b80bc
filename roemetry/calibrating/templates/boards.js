(function () {
  "use strict";
  // Turns the drawing of the boards: the same projection as the still one, again at each step.
  var figure = document.querySelector("figure.space");
  if (!figure) return;
  var told = JSON.parse(figure.dataset.shapes), svg = figure.querySelector("svg"), yaw = -30, rise = 25, from = null;
  var paths = svg.querySelectorAll("path"), words = svg.querySelectorAll("text"), box = svg.viewBox.baseVal;
  svg.tabIndex = 0;
  svg.setAttribute("role", "application");

  function draw() {
    var a = yaw * Math.PI / 180, b = rise * Math.PI / 180, word = 0;
    var right = [Math.cos(a), Math.sin(a), 0], up = [-Math.sin(a) * Math.sin(b), Math.cos(a) * Math.sin(b), Math.cos(b)];
    var along = function (p, axis) { return p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2]; };
    told.shapes.forEach(function (shape, k) {
      var places = shape.map(function (p) { return [box.width / 2 + told.scale * along(p, right), box.height / 2 - told.scale * along(p, up)]; });
      paths[k].setAttribute("d", "M" + places.map(function (p) { return p[0].toFixed(1) + " " + p[1].toFixed(1); }).join("L") + (shape.length > 2 ? "Z" : ""));
      if (!told.named[k]) return;
      var at = places[shape.length > 2 ? 0 : 1];
      words[word].setAttribute("x", at[0]);
      words[word++].setAttribute("y", at[1] + 4);
    });
  }
  function turn(dx, dy) { yaw += dx; rise = Math.min(90, Math.max(0, rise + dy)); draw(); }
  svg.addEventListener("pointerdown", function (e) { svg.setPointerCapture(e.pointerId); from = [e.clientX, e.clientY]; });
  svg.addEventListener("pointermove", function (e) {
    if (!from) return;
    turn(-(e.clientX - from[0]) * 0.45, (e.clientY - from[1]) * 0.45);
    from = [e.clientX, e.clientY];
  });
  ["pointerup", "pointercancel"].forEach(function (kind) { svg.addEventListener(kind, function () { from = null; }); });
  svg.addEventListener("keydown", function (e) {
    var step = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[e.key];
    if (!step) return;
    e.preventDefault();
    turn(step[0], step[1]);
  });
})();
