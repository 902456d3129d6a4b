// A film of bodies on a canvas: drawn as the outlines of their hulls, the far ones first; dragged to be turned, scrubbed in time.

(function (root) {
  "use strict";
  const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const slider = root.querySelector("input"), button = root.querySelector("button"), clock = root.querySelector("output");
  const films = data.films.map((film, i) => ({ ...film, poses: decode(film.poses), canvas: root.querySelectorAll("canvas")[i] }));
  const count = Math.max(...films.map((film) => film.count));
  let azimuth = data.azimuth, elevation = data.elevation, playing = 0;
  slider.max = count - 1;

  function decode(packed) {
    const text = atob(packed.d), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const view = new DataView(bytes.buffer), wide = packed.k === "f4" ? 4 : 2;
    return Float64Array.from({ length: bytes.length / wide }, (_, i) =>
      wide === 4 ? view.getFloat32(4 * i, true) : packed.o + packed.s * view.getInt16(2 * i, true));
  }

  // a point of body b at instant k, in the world
  function placed(film, k, b, p) {
    const o = 7 * (k * film.bodies + b), q = film.poses;
    const w = q[o + 3], x = q[o + 4], y = q[o + 5], z = q[o + 6];
    const tx = 2 * (y * p[2] - z * p[1]), ty = 2 * (z * p[0] - x * p[2]), tz = 2 * (x * p[1] - y * p[0]);
    return [
      q[o] + p[0] + w * tx + y * tz - z * ty, q[o + 1] + p[1] + w * ty + z * tx - x * tz,
      q[o + 2] + p[2] + w * tz + x * ty - y * tx,
    ];
  }

  // the corners of the hull of points [x, y], in order (A. M. Andrew's monotone chain)
  function hull(points) {
    if (points.length < 3) return points;
    const sorted = points.slice().sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const half = (list) => {
      const out = [];
      for (const p of list) {
        while (out.length > 1) {
          const [a, b] = out.slice(-2);
          if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
          out.pop();
        }
        out.push(p);
      }
      return out.slice(0, -1);
    };
    return [...half(sorted), ...half(sorted.reverse())];
  }

  function draw() {
    const now = Number(slider.value);
    clock.textContent = `${(now / data.rate).toFixed(2)} s`;
    for (const film of films) picture(film, Math.min(now, film.count - 1));
  }

  function picture(film, k) {
    const canvas = film.canvas, pen = canvas.getContext("2d"), dense = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * dense; canvas.height = height * dense;
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    const scale = Math.min(width, height) / data.size, middle = placed(film, k, film.followed, [0, 0, 0]);
    const ground = (film.floor || 0) + 0.38 * data.size;
    const seen = (p) => {  // right and down on the canvas, and how near
      const x = p[0] - middle[0], y = p[1] - middle[1], z = p[2] - ground;
      const right = sa * x - ca * y, away = ca * x + sa * y;
      return [width / 2 + scale * right, height / 2 - scale * (ce * z + se * away), se * z - ce * away];
    };
    pen.lineJoin = pen.lineCap = "round";
    const ink = getComputedStyle(root).color;
    canvas.dataset.shapes = film.shapes.length;
    if (film.floor !== null) lines(pen, seen, middle, film.floor, ink);
    const shapes = film.shapes.map((shape) => {
      const points = shape.p.map((p) => seen(placed(film, k, shape.b, p)));
      return { shape, points, near: points.reduce((sum, p) => sum + p[2], 0) / points.length };
    });
    for (const { shape, points } of shapes.sort((a, b) => a.near - b.near)) {
      const edge = 1.2, fill = `rgb(${shape.c.map((c) => Math.round(255 * c)).join(",")})`;
      pen.beginPath();
      hull(points).forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
      if (points.length > 1) pen.closePath();
      else pen.lineTo(points[0][0] + 1e-3, points[0][1]);
      pen.strokeStyle = ink; pen.lineWidth = 2 * (scale * shape.r + edge); pen.stroke();
      pen.strokeStyle = pen.fillStyle = fill; pen.fill();
      if (shape.r > 0) { pen.lineWidth = 2 * scale * shape.r; pen.stroke(); }
    }
  }

  function lines(pen, seen, middle, floor, ink) {
    const step = data.grid, reach = 6;
    const x0 = step * Math.round(middle[0] / step), y0 = step * Math.round(middle[1] / step);
    pen.strokeStyle = ink; pen.lineWidth = 1; pen.globalAlpha = 0.18;
    pen.beginPath();
    for (let i = -reach; i <= reach; i++) {
      for (const [a, b] of [[[i, -reach], [i, reach]], [[-reach, i], [reach, i]]]) {
        const p = seen([x0 + a[0] * step, y0 + a[1] * step, floor]), q = seen([x0 + b[0] * step, y0 + b[1] * step, floor]);
        pen.moveTo(p[0], p[1]); pen.lineTo(q[0], q[1]);
      }
    }
    pen.stroke(); pen.globalAlpha = 1;
  }

  function play(stamp) {
    if (!playing) return;
    const now = Math.floor(((stamp - playing) / 1000) * data.rate);
    slider.value = Math.min(now, count - 1);
    draw();
    if (now < count - 1) requestAnimationFrame(play);
    else { playing = 0; button.textContent = "play"; }
  }

  button.addEventListener("click", () => {
    button.textContent = playing ? "play" : "pause";
    const from = Number(slider.value) >= count - 1 ? 0 : Number(slider.value);
    playing = playing ? 0 : performance.now() - (1000 * from) / data.rate;
    if (playing) requestAnimationFrame(play);
  });
  slider.addEventListener("input", () => { playing = 0; button.textContent = "play"; draw(); });
  for (const { canvas } of films) {
    canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
    canvas.addEventListener("pointermove", (e) => {
      if (!e.buttons) return;
      azimuth -= 0.01 * e.movementX;
      elevation = Math.max(0, Math.min(1.5, elevation + 0.01 * e.movementY));
      draw();
    });
  }
  window.addEventListener("resize", draw);
  draw();
})(document.currentScript.parentElement);
