// What the page holds of a scene: measured points by slice, and vertices of the surfaces (see `Solid` in solid.py).
function readSolid(figure) {
  "use strict";
  var head = JSON.parse(figure.dataset.head);
  var bytes = Uint8Array.from(atob(figure.dataset.points), function (c) { return c.charCodeAt(0); });
  var view = new DataView(bytes.buffer);
  var points = head.slices.reduce(function (sum, s) { return sum + s[2]; }, 0);
  var vertices = head.grids.reduce(function (sum, g) { return sum + g[1] * g[2]; }, 0);
  var px = 6 * points, xyz = 10 * points, flags = xyz + 6 * vertices, std = flags + points;
  var kinds = std + points, stds = kinds + vertices, rgb = stds + vertices, at = 0, corner = 0;
  function place(from, i) {
    return [0, 1, 2].map(function (k) { return view.getInt16(from + 2 * (3 * i + k), true) * head.step; });
  }
  function share(byte) { return byte === 255 ? NaN : byte / 254; }
  return {
    head: head,
    slices: head.slices.map(function (told) {
      var mine = [];
      for (var i = 0; i < told[2]; i++, at++) mine.push({
        p: place(0, at), x: view.getInt16(px + 4 * at, true) * head.px, row: view.getInt16(px + 4 * at + 2, true) * head.px,
        seen: bytes[flags + at] & 1, joined: (bytes[flags + at] & 2) > 0, std: share(bytes[std + at])
      });
      return { stripe: told[0], product: told[1], points: mine };
    }),
    grids: head.grids.map(function (told) {
      var mine = [];
      for (var i = 0; i < told[1] * told[2]; i++, corner++) mine.push({
        p: place(xyz, corner), kind: bytes[kinds + corner], std: share(bytes[stds + corner]),
        rgb: [0, 1, 2].map(function (k) { return bytes[rgb + 3 * corner + k]; })
      });
      return { product: told[0], closed: told[3], rows: told[1], columns: told[2], vertices: mine };
    })
  };
}
