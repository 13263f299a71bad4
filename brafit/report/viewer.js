// A 3D view without any library: quads and dots, sorted by depth and painted onto a flat canvas.
// Coordinates: x to the viewer's right, y up, z towards the viewer; mm.
"use strict";
(function () {
  const data = JSON.parse(document.getElementById("cup-data").textContent);
  const canvas = document.getElementById("view");
  const floats = (text) => new Float32Array(bytes(text).buffer);
  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out;
  }
  const points = floats(data.points), colours = bytes(data.colours);
  const panels = data.panels.map((panel) => ({
    colour: panel.colour, folds: panel.folds.map(floats), tints: bytes(panel.tints), stations: panel.stations,
  }));
  const strips = data.strips, centre = data.centre, size = data.size;
  const start = { yaw: -0.5, pitch: -0.3, zoom: 1 };
  const views = { front: [0, 0], side: [-Math.PI / 2 * data.outward, 0], below: [0, -1.2], oblique: [-0.5 * data.outward, -0.3] };
  let yaw = start.yaw * data.outward, pitch = start.pitch, zoom = start.zoom, share = 1, pending = false;
  const box = (id) => document.getElementById(id);

  // Edges of a panel between two of the states that were folded beforehand, lower edge first.
  function folded(panel) {
    const at = share * (panel.folds.length - 1), k = Math.min(Math.floor(at), panel.folds.length - 2), t = at - k;
    const a = panel.folds[k], b = panel.folds[k + 1], out = new Float32Array(a.length);
    for (let i = 0; i < a.length; i++) out[i] = a[i] + t * (b[i] - a[i]);
    return out;
  }

  function draw() {
    pending = false;
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    const scale = zoom * 1.15 * Math.min(width, height) / size;
    const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
    const project = (x, y, z) => {
      x -= centre[0]; y -= centre[1]; z -= centre[2];
      const u = cy * x + sy * z, w = cy * z - sy * x;
      return [width / 2 + scale * u, height / 2 - scale * (cp * y - sp * w), sp * y + cp * w];
    };
    const things = [];
    if (box("show-cup").checked) {
      const tinted = box("tint-cup").checked && share === 1;
      for (const panel of panels) {
        const edges = folded(panel), n = panel.stations, grid = [];
        for (let k = 0; k < n; k++) {
          for (let i = 0; i <= strips; i++) {
            const s = i / strips, a = 3 * k, b = 3 * (n + k);
            grid.push(project(edges[a] + s * (edges[b] - edges[a]), edges[a + 1] + s * (edges[b + 1] - edges[a + 1]),
              edges[a + 2] + s * (edges[b + 2] - edges[a + 2])));
          }
        }
        for (let k = 0; k < n - 1; k++) {
          for (let i = 0; i < strips; i++) {
            const q = k * (strips + 1) + i, corners = [grid[q], grid[q + strips + 1], grid[q + strips + 2], grid[q + 1]];
            const ux = corners[2][0] - corners[0][0], uy = corners[2][1] - corners[0][1], uz = scale * (corners[2][2] - corners[0][2]);
            const vx = corners[3][0] - corners[1][0], vy = corners[3][1] - corners[1][1], vz = scale * (corners[3][2] - corners[1][2]);
            let nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
            const norm = Math.hypot(nx, ny, nz);
            if (norm < 1e-6) continue;
            // the canvas's y runs downwards, which turns the sense of outward corners round
            const outside = nz < 0, light = Math.abs((0.35 * nx + 0.55 * ny + 0.76 * nz) / norm);
            const shade = (outside ? 1 : 0.78) * (0.72 + 0.3 * light);
            const c = tinted ? panel.tints.subarray(3 * (k * strips + i), 3 * (k * strips + i) + 3) : panel.colour;
            const depth = (corners[0][2] + corners[1][2] + corners[2][2] + corners[3][2]) / 4;
            things.push([depth, corners, `rgb(${shade * c[0] | 0},${shade * c[1] | 0},${shade * c[2] | 0})`]);
          }
        }
        for (const row of [0, strips]) {
          for (let k = 0; k < n - 1; k++) {
            const a = grid[k * (strips + 1) + row], b = grid[(k + 1) * (strips + 1) + row];
            things.push([(a[2] + b[2]) / 2 + 0.012 * size, [a, b], null]);
          }
        }
        if (box("show-rulings").checked) {
          for (let k = 4; k < n - 1; k += 4) {
            const a = k * (strips + 1);
            for (let i = 0; i < strips; i++) {
              const p = grid[a + i], q = grid[a + i + 1];
              things.push([(p[2] + q[2]) / 2 + 0.01 * size, [p, q], "#b4460f"]);
            }
          }
        }
      }
    }
    if (box("show-cloud").checked) {
      for (let i = 0; i < points.length; i += 3) {
        const p = project(points[i], points[i + 1], points[i + 2]);
        things.push([p[2] + data.lift, p, `rgb(${colours[i]},${colours[i + 1]},${colours[i + 2]})`]);
      }
    }
    things.sort((a, b) => a[0] - b[0]);
    const radius = Math.max(1.2, scale * data.radius);
    g.lineJoin = "round";
    for (const [, shape, colour] of things) {
      if (typeof shape[0] === "number") {
        g.fillStyle = colour;
        g.beginPath();
        g.arc(shape[0], shape[1], radius, 0, 7);
        g.fill();
      } else if (shape.length === 2) {
        g.strokeStyle = colour || "#40332b";
        g.lineWidth = colour ? 0.7 : 1.6;
        g.beginPath();
        g.moveTo(shape[0][0], shape[0][1]);
        g.lineTo(shape[1][0], shape[1][1]);
        g.stroke();
      } else {
        g.fillStyle = g.strokeStyle = colour;
        g.lineWidth = 0.6;
        g.beginPath();
        g.moveTo(shape[0][0], shape[0][1]);
        for (let i = 1; i < 4; i++) g.lineTo(shape[i][0], shape[i][1]);
        g.closePath();
        g.fill();
        g.stroke();
      }
    }
    const bar = [1, 2, 5, 10, 20, 50, 100].filter((mm) => mm * scale < width / 4).pop() || 1;
    g.fillStyle = "#222";
    g.fillRect(14, height - 16, bar * scale, 3);
    g.font = "12px sans-serif";
    g.fillText(`${bar} mm`, 14, height - 22);
    canvas.dataset.drawn = String(things.length);
  }

  function redraw() {
    if (!pending) { pending = true; requestAnimationFrame(draw); }
  }
  function turn(dx, dy) {
    yaw += dx; pitch = Math.max(-1.57, Math.min(1.57, pitch + dy));
    redraw();
  }
  let held = null;
  canvas.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointermove", (e) => {
    if (!held) return;
    turn((e.clientX - held[0]) * 0.008, (e.clientY - held[1]) * 0.008);
    held = [e.clientX, e.clientY];
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    zoom = Math.max(0.3, Math.min(12, zoom * Math.exp(-0.0012 * e.deltaY)));
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
    if (steps) { e.preventDefault(); turn(...steps); }
    if (e.key === "+" || e.key === "-") { zoom *= e.key === "+" ? 1.15 : 0.87; redraw(); }
  });
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => { [yaw, pitch] = views[button.dataset.view]; zoom = 1; redraw(); });
  }
  for (const id of ["show-cup", "show-cloud", "show-rulings", "tint-cup"]) box(id).addEventListener("change", redraw);
  box("fold").addEventListener("input", (e) => {
    share = Number(e.target.value) / 100;
    box("fold-share").textContent = share === 1 ? "cup" : share === 0 ? "flat" : `${e.target.value} % folded`;
    redraw();
  });
  new ResizeObserver(redraw).observe(canvas);
  draw();
})();
