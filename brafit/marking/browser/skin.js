// The skin: the scan's points with normals, and where a ray meets the surface that they lie on. Millimetres from the
// corner of the scan's box, as everywhere on this page.
//
// The surface about a place x is the zero of f(x) = sum w (n_i + n) . (x - p_i) / 2, over points p_i with normals n_i of
// about one direction, n their mean. Where a surface is round, n . (x - p_i) errs by as much as n_i . (x - p_i), to the
// other side: their mean is exact to the second order, without a fit.

function bytesOf(text) {
  const raw = atob(text),
    out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}

class Skin {
  static CELL = 1.4; // side of a cell of the grid, in discs of median size
  static SMOOTH = 1.3; // radius of the neighbourhood whose surface counts, likewise
  static ALIKE = 0.5; // least cosine between normals of one sheet
  static RIM = 1.5; // farther from the nearest point there is no skin, in its discs
  static FEW = 6; // points that make a surface

  constructor(data) {
    const buffer = bytesOf(data.records).buffer,
      count = data.count;
    Object.assign(this, {
      buffer,
      count,
      sizes: new Uint8Array(buffer, 8 * count),
      unitSize: data.spacing / data.sizes,
    });
    this.spacing = data.spacing;
    this.extent = 65535 * data.step;
    const shorts = new Uint16Array(buffer, 0, 4 * count),
      signed = new Int8Array(buffer, 0, 8 * count);
    this.points = new Float32Array(3 * count);
    this.normals = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) {
      for (let k = 0; k < 3; k++) this.points[3 * i + k] = data.step * shorts[4 * i + k];
      const u = signed[8 * i + 6] / 127,
        v = signed[8 * i + 7] / 127,
        w = 1 - Math.abs(u) - Math.abs(v);
      const x = w < 0 ? (1 - Math.abs(v)) * (u < 0 ? -1 : 1) : u,
        y = w < 0 ? (1 - Math.abs(u)) * (v < 0 ? -1 : 1) : v;
      const norm = Math.hypot(x, y, w);
      this.normals[3 * i] = x / norm;
      this.normals[3 * i + 1] = y / norm;
      this.normals[3 * i + 2] = w / norm;
    }
    this.#sort();
  }

  // Points by the cells of a grid: those of cell c are order[starts[c]] to order[starts[c + 1]].
  #sort() {
    const high = [0, 1, 2].map((k) => {
      let most = 0;
      for (let i = k; i < this.points.length; i += 3) if (this.points[i] > most) most = this.points[i];
      return most;
    });
    this.high = high;
    const volume = high.reduce((product, side) => product * (side + 1), 1);
    this.cell = Math.max(Skin.CELL * this.spacing, Math.cbrt(volume / 3e6));
    this.sides = high.map((side) => Math.floor(side / this.cell) + 2);
    const cells = new Int32Array(this.count),
      [wide, deep] = this.sides,
      p = this.points,
      share = 1 / this.cell;
    this.starts = new Int32Array(wide * deep * this.sides[2] + 1);
    for (let i = 0; i < this.count; i++) {
      const x = Math.floor(share * p[3 * i]),
        y = Math.floor(share * p[3 * i + 1]),
        z = Math.floor(share * p[3 * i + 2]);
      cells[i] = (z * deep + y) * wide + x;
      this.starts[cells[i] + 1]++;
    }
    for (let c = 1; c < this.starts.length; c++) this.starts[c] += this.starts[c - 1];
    const next = this.starts.slice();
    this.order = new Int32Array(this.count);
    for (let i = 0; i < this.count; i++) this.order[next[cells[i]]++] = i;
  }

  point(i) {
    return [this.points[3 * i], this.points[3 * i + 1], this.points[3 * i + 2]];
  }
  normal(i) {
    return [this.normals[3 * i], this.normals[3 * i + 1], this.normals[3 * i + 2]];
  }

  // Calls use(index, squared distance) for all points nearer to a place than a radius.
  #around(place, radius, use) {
    const low = [0, 0, 0],
      high = [0, 0, 0],
      p = this.points,
      square = radius * radius;
    for (let k = 0; k < 3; k++) {
      low[k] = Math.max(0, Math.floor((place[k] - radius) / this.cell));
      high[k] = Math.min(this.sides[k] - 1, Math.floor((place[k] + radius) / this.cell));
    }
    for (let z = low[2]; z <= high[2]; z++) {
      for (let y = low[1]; y <= high[1]; y++) {
        const row = (z * this.sides[1] + y) * this.sides[0];
        if (low[0] > high[0]) continue;
        for (let j = this.starts[row + low[0]]; j < this.starts[row + high[0] + 1]; j++) {
          const i = this.order[j];
          const dx = p[3 * i] - place[0],
            dy = p[3 * i + 1] - place[1],
            dz = p[3 * i + 2] - place[2];
          const away = dx * dx + dy * dy + dz * dz;
          if (away < square) use(i, away);
        }
      }
    }
  }

  // Index of the nearest point and its distance; -1 where none is within reach.
  nearest(place, reach) {
    let best = -1,
      least = Infinity;
    for (let radius = Math.min(2 * this.spacing, reach); best < 0; radius = Math.min(2.5 * radius, reach)) {
      this.#around(place, radius, (i, away) => {
        if (away < least) {
          least = away;
          best = i;
        }
      });
      if (radius >= reach) break;
    }
    return { index: best, away: Math.sqrt(least) };
  }

  // How far the skin about a place comes out in a direction, from an origin on: at least as far as the place.
  farthest(place, radius, origin, out) {
    const p = this.points;
    let most = dot(minus(place, origin), out);
    this.#around(place, radius, (i) => {
      const far = (p[3 * i] - origin[0]) * out[0] + (p[3 * i + 1] - origin[1]) * out[1] + (p[3 * i + 2] - origin[2]) * out[2];
      if (far > most) most = far;
    });
    return most;
  }

  // f and n of the surface about a place, of the sheet that looks about as `facing`; null where there are too few points.
  #field(place, facing) {
    const n = this.normals,
      p = this.points;
    for (let radius = Skin.SMOOTH * this.spacing, k = 0; k < 3; k++, radius *= 1.7) {
      const found = [];
      let mean = [0, 0, 0];
      this.#around(place, radius, (i, away) => {
        const cosine = n[3 * i] * facing[0] + n[3 * i + 1] * facing[1] + n[3 * i + 2] * facing[2];
        if (Math.abs(cosine) < Skin.ALIKE) return;
        const weight = (1 - away / (radius * radius)) ** 2 * Math.sign(cosine);
        found.push(i, weight);
        mean = along(mean, weight, [n[3 * i], n[3 * i + 1], n[3 * i + 2]]);
      });
      if (found.length < 2 * Skin.FEW) continue;
      mean = unit(mean);
      let sum = 0,
        total = 0;
      for (let j = 0; j < found.length; j += 2) {
        const i = 3 * found[j],
          weight = Math.abs(found[j + 1]),
          sign = Math.sign(found[j + 1]);
        sum +=
          (weight *
            ((sign * n[i] + mean[0]) * (place[0] - p[i]) +
              (sign * n[i + 1] + mean[1]) * (place[1] - p[i + 1]) +
              (sign * n[i + 2] + mean[2]) * (place[2] - p[i + 2]))) /
          2;
        total += weight;
      }
      return { value: sum / total, normal: mean };
    }
    return null;
  }

  // The place on the skin next to a place; null where there is none within reach, or only the rim of a hole.
  settled(place, reach) {
    const { index } = this.nearest(place, reach);
    if (index < 0) return null;
    // From the nearest point's tangent plane on, so that the neighbourhoods looked at are those of the surface.
    const facing = this.normal(index);
    let at = along(place, dot(minus(this.point(index), place), facing), facing);
    if (apart(at, this.point(index)) > Skin.RIM * Math.max(this.spacing, this.unitSize * this.sizes[index])) return null;
    for (let k = 0; k < 3; k++) {
      const field = this.#field(at, facing);
      if (field === null) return this.point(index);
      at = along(at, -field.value, field.normal);
    }
    return at;
  }

  // Where a ray first meets the skin, seen against `towards` (a unit vector to the viewer); null where it does not.
  // Every point is a disc: the one that is hit first says which sheet is seen, the surface about it where.
  hit(origin, towards) {
    for (const widen of [1, 2, 4]) {
      const first = this.#firstDisc(origin, towards, widen * this.unitSize);
      if (first !== null) return this.#refined(origin, towards, first);
    }
    return null;
  }

  #firstDisc(origin, towards, step) {
    const { points: p, normals: n, sizes } = this,
      [ox, oy, oz] = origin,
      [dx, dy, dz] = towards,
      most = (255 * step) ** 2;
    let best = -1,
      farthest = -Infinity;
    for (let i = 0; i < p.length; i += 3) {
      const x = p[i] - ox,
        y = p[i + 1] - oy,
        z = p[i + 2] - oz,
        t = x * dx + y * dy + z * dz;
      const away = x * x + y * y + z * z - t * t;
      if (away > most) continue;
      const radius = step * sizes[i / 3],
        square = radius * radius;
      if (away > square || t + radius < farthest) continue;
      const slant = n[i] * dx + n[i + 1] * dy + n[i + 2] * dz;
      if (Math.abs(slant) < 0.05) continue;
      const s = (n[i] * x + n[i + 1] * y + n[i + 2] * z) / slant;
      if (away + (s - t) * (s - t) <= square && s > farthest) {
        farthest = s;
        best = i / 3;
      }
    }
    return best < 0 ? null : { index: best, t: farthest };
  }

  #refined(origin, towards, first) {
    const facing = this.normal(first.index),
      most = 2 * this.spacing;
    let t = first.t;
    for (let k = 0; k < 6; k++) {
      const field = this.#field(along(origin, t, towards), facing);
      if (field === null) break;
      const slant = dot(field.normal, towards);
      if (Math.abs(slant) < 0.05) break;
      const step = clamp(field.value / slant, -most, most);
      t -= step;
      if (Math.abs(step) < 1e-3) break;
    }
    return along(origin, t, towards);
  }
}
