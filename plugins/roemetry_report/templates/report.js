(function () {
  "use strict";
  document.querySelectorAll("table.rows thead th:not(.no-sort)").forEach(function (head) {
    var button = document.createElement("button");
    button.type = "button";
    while (head.firstChild) button.appendChild(head.firstChild);
    head.appendChild(button);
    button.addEventListener("click", function () { sort(head); });
  });

  function sort(head) {
    var table = head.closest("table"), body = table.tBodies[0];
    var column = Array.prototype.indexOf.call(head.parentNode.children, head);
    var down = head.getAttribute("aria-sort") === "ascending";
    table.querySelectorAll("th[aria-sort]").forEach(function (th) { th.removeAttribute("aria-sort"); });
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    var numeric = head.classList.contains("n") || head.textContent.indexOf("Seen") === 0;
    var rows = Array.prototype.slice.call(body.rows).map(function (row) {
      var cell = row.children[column], text = cell.dataset.sort;
      if (text === undefined) text = numeric ? "" : cell.textContent.trim();
      if (numeric && text === "" && !isNaN(parseFloat(cell.textContent))) text = cell.textContent;
      return { row: row, key: numeric ? parseFloat(text) : text.toLowerCase() };
    });
    rows.sort(function (a, b) {
      var no = function (k) { return numeric ? isNaN(k) : k === ""; };
      if (no(a.key) || no(b.key)) return no(a.key) - no(b.key);
      var order = numeric ? a.key - b.key : a.key.localeCompare(b.key, undefined, { numeric: true });
      return down ? -order : order;
    });
    rows.forEach(function (item) { body.appendChild(item.row); });
  }

  var large = null;
  function close() {
    if (!large) return;
    large.classList.remove("large");
    document.documentElement.classList.remove("has-large");
    large.querySelector(".enlarge").textContent = "Enlarge";
    large.querySelector(".enlarge").focus({ preventScroll: true });
    large = null;
  }
  document.querySelectorAll("figure.panel").forEach(function (figure) {
    var button = document.createElement("button");
    button.type = "button";
    button.className = "enlarge";
    button.textContent = "Enlarge";
    figure.querySelector("figcaption").prepend(button);
    function toggle() {
      if (large === figure) { close(); return; }
      close();
      large = figure;
      figure.classList.add("large");
      document.documentElement.classList.add("has-large");
      button.textContent = "Close";
      button.focus({ preventScroll: true });
    }
    button.addEventListener("click", toggle);
    figure.querySelector("svg").addEventListener("click", toggle);
  });
  document.addEventListener("keydown", function (event) { if (event.key === "Escape") close(); });

  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (d) { d.dataset.was = d.open ? "1" : ""; d.open = true; });
  });
  window.addEventListener("afterprint", function () {
    document.querySelectorAll("details").forEach(function (d) { d.open = d.dataset.was === "1"; });
  });
})();
