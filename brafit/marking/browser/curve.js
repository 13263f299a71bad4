// Smooth curves through a few handles: natural cubic splines over the chords' lengths, laid on the skin.

const STEP = 2; // between points of a saved line, mm
const SKIN_REACH = 10; // a curve is laid on skin that is so near, mm
const FADES = 4; // less of it, where it is less than so much nearer than that, mm
const FAITHFUL = 0.5; // a curve may lie so far off the line that its handles were taken from, mm

const lengthOf = (line) => line.reduce((sum, point, i) => (i ? sum + apart(point, line[i - 1]) : 0), 0);

// Points at equal steps along a polyline, ends included.
function evenly(line, count) {
  const arc = [0];
  for (let i = 1; i < line.length; i++) arc.push(arc[i - 1] + apart(line[i], line[i - 1]));
  const out = [];
  for (let k = 0, i = 0; k < count; k++) {
    const at = (arc[arc.length - 1] * k) / (count - 1);
    while (i < line.length - 2 && arc[i + 1] < at) i++;
    out.push(between(line[i], line[i + 1], clamp((at - arc[i]) / Math.max(arc[i + 1] - arc[i], 1e-12), 0, 1)));
  }
  return out;
}

// Second derivatives at the knots of the natural cubic spline.
function bends(knots, values) {
  const n = knots.length,
    out = values.map(() => [0, 0, 0]),
    upper = new Float64Array(n);
  for (let i = 1; i < n - 1; i++) {
    const before = knots[i] - knots[i - 1],
      after = knots[i + 1] - knots[i];
    const pivot = 2 * (before + after) - before * upper[i - 1];
    upper[i] = after / pivot;
    for (let k = 0; k < 3; k++) {
      const turn = 6 * ((values[i + 1][k] - values[i][k]) / after - (values[i][k] - values[i - 1][k]) / before);
      out[i][k] = (turn - before * out[i - 1][k]) / pivot;
    }
  }
  for (let i = n - 2; i > 0; i--) for (let k = 0; k < 3; k++) out[i][k] -= upper[i] * out[i + 1][k];
  return out;
}

// The spline, sampled `fine` times between neighbouring handles.
function splined(handles, fine = 12) {
  const distinct = handles.filter((handle, i) => i === 0 || apart(handle, handles[i - 1]) > 1e-6);
  if (distinct.length < 2) return [handles[0], handles[handles.length - 1]];
  const knots = [0];
  for (let i = 1; i < distinct.length; i++) knots.push(knots[i - 1] + apart(distinct[i], distinct[i - 1]));
  const bent = bends(knots, distinct),
    out = [];
  for (let i = 0; i < distinct.length - 1; i++) {
    const h = knots[i + 1] - knots[i];
    for (let j = 0; j < fine; j++) {
      const b = j / fine,
        a = 1 - b;
      out.push(
        [0, 1, 2].map(
          (k) =>
            a * distinct[i][k] +
            b * distinct[i + 1][k] +
            (((a ** 3 - a) * bent[i][k] + (b ** 3 - b) * bent[i + 1][k]) * h * h) / 6,
        ),
      );
    }
  }
  out.push(distinct[distinct.length - 1]);
  return out;
}

// The curve through handles, every 2 mm, on the skin where there is some near.
function curveOnSkin(handles, skin) {
  const free = splined(handles),
    line = evenly(free, Math.max(4, Math.ceil(lengthOf(free) / STEP)) + 1);
  const moves = line.map((place) => {
    const there = skin.settled(place, SKIN_REACH);
    if (there === null) return [0, 0, 0];
    const move = minus(there, place);
    return times(clamp((SKIN_REACH - size(move)) / FADES, 0, 1), move);
  });
  const last = line.length - 1;
  return line.map((place, i) => {
    if (i === 0 || i === last) return place;
    // Means of the neighbours' moves: a curve in a crease does not jump between its two sides.
    const near = Math.min(2, i, last - i);
    let sum = [0, 0, 0];
    for (let j = i - near; j <= i + near; j++) sum = plus(sum, moves[j]);
    return along(place, 1 / (2 * near + 1), sum);
  });
}

// As few handles as show a line well, ends included.
function handlesFor(line, least, most) {
  const dense = evenly(line, 200);
  for (let count = least; ; count++) {
    const handles = evenly(line, count);
    if (count >= most || farthestFrom(dense, splined(handles)) <= FAITHFUL) return handles;
  }
}

const farthestFrom = (points, line) => Math.max(...points.map((point) => nearestOn(line, point).away));

// The place on a polyline next to a point: segment, distance, place.
function nearestOn(line, point) {
  let best = { away: Infinity, segment: 0, place: line[0] };
  for (let i = 0; i < line.length - 1; i++) {
    const step = minus(line[i + 1], line[i]);
    const share = clamp(dot(minus(point, line[i]), step) / Math.max(dot(step, step), 1e-12), 0, 1);
    const place = along(line[i], share, step),
      away = apart(place, point);
    if (away < best.away) best = { away, segment: i, place };
  }
  return best;
}
