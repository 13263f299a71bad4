// Figures of a breast's marks in millimetres, and what brafit would refuse or warn of: its own bounds, which the page
// was told.

const DEPTH_REACH = 40; // the farthest place of a breast is so near to its apex, mm

// The normal of the plane that lies best through points: the axis along which they spread least.
function flattest(points) {
  const middle = middleOf(points),
    spread = [0, 1, 2].map((i) => {
      const row = [0, 0, 0];
      for (const point of points) for (let k = 0; k < 3; k++) row[k] += (point[i] - middle[i]) * (point[k] - middle[k]);
      return row;
    });
  const least = 1e-9 * (spread[0][0] + spread[1][1] + spread[2][2]);
  for (let k = 0; k < 3; k++) spread[k][k] += least;
  const [a, b, c] = spread,
    columns = [cross(b, c), cross(c, a), cross(a, b)]; // of the inverse, up to a factor
  let normal = columns.reduce((most, column) => (size(column) > size(most) ? column : most));
  for (let k = 0; k < 50; k++) {
    const [x, y, z] = unit(normal);
    normal = plus(times(x, columns[0]), plus(times(y, columns[1]), times(z, columns[2])));
  }
  return unit(normal);
}

// The wire's frame, as brafit has it: along its chord, out of the chest, down.
function wireFrame(breast, side) {
  const wire = breast.wire.points,
    first = wire[0],
    last = wire[wire.length - 1];
  const chord = unit(minus(last, first)),
    normal = flattest(evenly(wire, 200));
  let out = unit(along(normal, -dot(normal, chord), chord));
  if (breast.apex && dot(minus(breast.apex, first), out) < 0) out = times(-1, out);
  const down = times(side === "left" ? 1 : -1, cross(chord, out));
  return { chord, out, down };
}

function figuresOf(breast, side, catalogue, skin) {
  if (!breast.wire) return null;
  const wire = breast.wire.points,
    length = lengthOf(wire),
    span = apart(wire[0], wire[wire.length - 1]);
  const { chord, out, down } = wireFrame(breast, side);
  const rises = wire.map((p) => {
    const away = minus(p, wire[0]);
    return size(along(away, -dot(away, chord), chord));
  });
  const low = evenly(wire, 200).reduce((sum, p) => sum + dot(minus(p, wire[0]), down), 0) / 200;
  const makers = new Map();
  for (const sold of catalogue) {
    const near = { ...sold, longer: sold.length - length, wider: sold.span - span };
    near.off = Math.hypot(near.longer, near.wider);
    if (!makers.has(sold.maker) || makers.get(sold.maker).off > near.off) makers.set(sold.maker, near);
  }
  const neckline = breast.inner && breast.outer ? lengthOf(breast.inner.points) + lengthOf(breast.outer.points) : null;
  return {
    length,
    span,
    neckline,
    height: Math.max(...rises),
    low,
    // of the place of the breast that is farthest out of the wire's plane, as in brafit's reports
    depth: breast.apex ? skin.farthest(breast.apex, DEPTH_REACH, wire[0], out) : null,
    sold: [...makers.values()].sort((a, b) => a.off - b.off),
  };
}

const median = (values) => values.slice().sort((a, b) => a - b)[Math.floor(values.length / 2)];
const mm = (value) => `${value.toFixed(Math.abs(value) < 10 ? 1 : 0)} mm`;

// What is wrong with a breast's marks: {refused: whether brafit would refuse them, says}.
function faultsOf(breast, side, figures, told, skin) {
  const b = told.bounds,
    found = [],
    say = (refused, says) => found.push({ refused, says });
  const away = (line) => median(line.map((point) => skin.nearest(point, 2 * b.markDistance).away));
  if (figures) {
    const { length, span, height, low, depth } = figures;
    if (length < b.wirePossible[0] || length > b.wirePossible[1]) {
      say(true, `The wire is ${mm(length)} long; it must be ${b.wirePossible.join(" to ")} mm.`);
    } else if (length < b.wireUsual[0] || length > b.wireUsual[1]) {
      say(false, `The wire is ${mm(length)} long; ${b.wireUsual.join(" to ")} mm are usual.`);
    }
    if (span < b.leastSpan * length)
      say(true, "The wire's ends are too near to each other: trace it from the inner to the outer end only.");
    else if (height < b.leastHeight * span) say(true, "The wire is nearly straight: trace the bow under the breast.");
    else if (low <= 0 && breast.apex)
      say(
        true,
        `For a ${side} breast the wire runs the wrong way round: from the outer to the inner end, or it is the other breast's.`,
      );
    if (told.size > b.covered * length && told.size <= b.oneBreast && height < b.bow * span) {
      say(true, "The wire covers only a part of the breast's line: trace the whole crease.");
    }
    if (away(breast.wire.points) > b.wireDistance)
      say(true, `Most of the wire is more than ${b.wireDistance} mm off the skin.`);
    if (depth !== null) {
      const share = depth / length,
        [least, most] = b.depthUsual,
        refused = share < b.depthPossible[0] || share > b.depthPossible[1];
      if (share < least || share > most) {
        say(
          refused,
          `The breast comes ${mm(depth)} out of the wire's plane; ${mm(least * length)} to ${mm(most * length)} are usual.`,
        );
      }
    }
  }
  for (const name of POINTS) {
    if (breast[name] && away([breast[name]]) > b.markDistance)
      say(true, `${NAMES[name]}: more than ${b.markDistance} mm off the skin.`);
  }
  for (const name of ENDS.wire) {
    const off = breast[name] ? away([breast[name]]) : 0;
    if (off > b.endOff && off <= b.markDistance)
      say(false, `${NAMES[name]}: ${mm(off)} off the skin; up to ${b.endOff} mm are usual.`);
  }
  return found;
}
