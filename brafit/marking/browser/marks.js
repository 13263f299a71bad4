// The marks of one breast, and what a person does to them. A breast is never changed: each edit makes a new one.
//
// A breast: inner_end, outer_end, strap_point, apex (places or null); wire, inner, outer (lines or null: the wire, and
// the neckline's parts from the inner end to the strap and on to the outer end); origin; looked (a person said that it
// was looked at; of marks made by hand alone there is nothing to say); touched (what was edited: "wire", which has its
// ends, "strap_point", "apex", "neckline"); named (the points that the landmark file or the proposal names, as they were;
// null where there is none); detected (the wire was not in the file, it was found in the crease); backwards (lines that
// the file has from their outer end: "wire", "neckline"); moved (mm, of a breast copied from the other side: how far its
// marks are from the mirror image, at most, since they are laid on the skin).
// A line: via (its handles between its ends), points (the line itself: as it was given until a handle is moved).

const ENDS = {
  wire: ["inner_end", "outer_end"],
  inner: ["inner_end", "strap_point"],
  outer: ["strap_point", "outer_end"],
};
const POINTS = ["inner_end", "outer_end", "strap_point", "apex"];
const HANDLES = { wire: [7, 13], inner: [4, 9], outer: [4, 9] }; // least and most that a given line gets, ends included
const MIRROR_REACH = 12; // a mirrored handle is laid on skin that is so near, mm

const nothing = (origin) => ({
  inner_end: null,
  outer_end: null,
  strap_point: null,
  apex: null,
  wire: null,
  inner: null,
  outer: null,
  origin,
  looked: origin === "hand",
  touched: [],
  named: null,
  detected: false,
  backwards: [],
  moved: 0,
});
// The breast with marks noted as edited.
const touching = (breast, ...marks) => ({ ...breast, touched: [...new Set([...breast.touched, ...marks])] });
const markOf = (id) => {
  const line = id.split(".")[0];
  return line in ENDS ? (line === "wire" ? line : "neckline") : line.endsWith("_end") ? "wire" : line;
};
// Marks that nobody made or looked at.
const isUnseen = (breast) => !isEmpty(breast) && !breast.looked;
const isEmpty = (breast) => POINTS.every((name) => breast[name] === null);
const lineOf = (points, key) => ({ via: handlesFor(points, ...HANDLES[key]).slice(1, -1), points });

// A breast as the page was told of it.
function breastOf(told) {
  const { origin, named, detected } = told,
    breast = { ...nothing(origin), looked: origin === "given" && !detected, named, detected };
  for (const name of POINTS) breast[name] = told.points[name] || null;
  if (!told.wire) return breast;
  breast.inner_end = told.wire[0];
  breast.outer_end = told.wire[told.wire.length - 1];
  breast.wire = lineOf(told.wire, "wire");
  breast.backwards = told.backwards ? ["wire"] : [];
  if (!told.upper) return breast;
  const outwards = apart(told.upper[0], breast.inner_end) <= apart(told.upper[0], breast.outer_end),
    upper = outwards ? told.upper : told.upper.slice().reverse();
  if (!outwards) breast.backwards.push("neckline");
  const corner = cornerOf(upper, breast.strap_point);
  breast.strap_point = breast.strap_point || upper[corner];
  breast.inner = lineOf(upper.slice(0, corner + 1), "inner");
  breast.outer = lineOf(upper.slice(corner), "outer");
  return breast;
}

// Where a neckline has the strap: next to the marked point, else farthest from the chord of its ends.
function cornerOf(upper, strap) {
  const chord = unit(minus(upper[upper.length - 1], upper[0])),
    last = upper.length - 1;
  const worth = (point) => {
    const away = minus(point, upper[0]);
    return strap ? -apart(point, strap) : size(along(away, -dot(away, chord), chord));
  };
  let best = 1;
  for (let i = 1; i < last; i++) if (worth(upper[i]) > worth(upper[best])) best = i;
  return best;
}

const endsOf = (breast, key) => ENDS[key].map((name) => breast[name]);
const handlesOf = (breast, key) => [breast[ENDS[key][0]], ...breast[key].via, breast[ENDS[key][1]]];

// All handles: id, place, the line or point that they belong to.
function allHandles(breast) {
  const via = Object.keys(ENDS)
    .filter((key) => breast[key])
    .flatMap((key) => breast[key].via.map((at, i) => ({ id: `${key}.${i}`, at, of: key })));
  return [...via, ...POINTS.filter((name) => breast[name]).map((name) => ({ id: name, at: breast[name], of: name }))];
}

const redrawn = (breast, keys, skin) =>
  keys
    .filter((key) => breast[key])
    .reduce(
      (changed, key) => ({
        ...changed,
        [key]: { via: changed[key].via, points: curveOnSkin(handlesOf(changed, key), skin) },
      }),
      breast,
    );

// The breast with a handle elsewhere.
function withHandle(breast, id, at, skin) {
  const [key, i] = id.split(".");
  if (i === undefined) {
    const touched = Object.keys(ENDS).filter((line) => ENDS[line].includes(id));
    return touching(redrawn({ ...breast, [id]: at }, touched, skin), markOf(id));
  }
  const via = breast[key].via.map((old, k) => (k === Number(i) ? at : old));
  return touching(redrawn({ ...breast, [key]: { ...breast[key], via } }, [key], skin), markOf(key));
}

// The breast with one more handle on a line, at the place of it that is next to a point; and the handle's id.
function withMore(breast, key, point, skin) {
  const at = nearestOn(breast[key].points, point).place,
    handles = handlesOf(breast, key);
  const order = (place) => {
    const { segment, place: on } = nearestOn(breast[key].points, place);
    return [segment, on];
  };
  const [segment, on] = order(at);
  const before = handles.slice(1, -1).filter((handle) => {
    const [own, where] = order(handle);
    return (
      own < segment || (own === segment && apart(where, breast[key].points[own]) < apart(on, breast[key].points[own]))
    );
  }).length;
  const via = [...breast[key].via.slice(0, before), at, ...breast[key].via.slice(before)];
  const more = redrawn({ ...breast, [key]: { ...breast[key], via } }, [key], skin);
  return [touching(more, markOf(key)), `${key}.${before}`];
}

// The breast without a handle of a line; null where the line needs it.
function withLess(breast, id, skin) {
  const [key, i] = id.split(".");
  if (i === undefined || breast[key].via.length <= (key === "wire" ? 2 : 1)) return null;
  const via = breast[key].via.filter((_, k) => k !== Number(i));
  return touching(redrawn({ ...breast, [key]: { ...breast[key], via } }, [key], skin), markOf(key));
}

// The breast with a wire through places from its inner to its outer end.
function withWire(breast, places, skin) {
  const handles = handlesFor(curveOnSkin(places, skin), ...HANDLES.wire),
    last = handles.length - 1;
  const wire = { via: handles.slice(1, -1), points: [] };
  const placed = { ...breast, inner_end: handles[0], outer_end: handles[last], wire };
  return touching(redrawn(placed, Object.keys(ENDS), skin), "wire");
}

// The breast with a neckline over the skin from wire end by wire end to the strap point, seen from the front.
function withNeckline(breast, towards, skin) {
  const made = (key) => {
    const [a, b] = endsOf(breast, key);
    return { via: [0.25, 0.5, 0.75].map((s) => skin.hit(between(a, b, s), towards) || between(a, b, s)), points: [] };
  };
  const laid = { ...breast, inner: made("inner"), outer: made("outer") };
  return touching(redrawn(laid, ["inner", "outer"], skin), "neckline");
}

// A breast's marks on the other side of the body, laid on the skin there.
function mirroredBreast(breast, mirror, skin) {
  const changed = { ...nothing("mirrored") };
  const image = (point) => {
    if (point === null) return null;
    const flipped = along(point, -2 * (dot(point, mirror.normal) - mirror.offset), mirror.normal),
      laid = skin.settled(flipped, MIRROR_REACH) || flipped;
    changed.moved = Math.max(changed.moved, apart(laid, flipped));
    return laid;
  };
  for (const name of POINTS) changed[name] = image(breast[name]);
  for (const key of Object.keys(ENDS)) if (breast[key]) changed[key] = { via: breast[key].via.map(image), points: [] };
  return redrawn(changed, Object.keys(ENDS), skin);
}

// Whether a wire that the file did not have is neither edited nor looked at: then it is not saved.
const isOnlyFound = (breast) => breast.detected && !breast.looked && !breast.touched.includes("wire");

// The points that a landmark file names, by name: those that nobody touched as they were, also if they were not there.
function namedOf(breast, up) {
  const own = Object.fromEntries(POINTS.map((name) => [name, breast[name]]));
  if (breast.wire) own.wire_bottom = breast.wire.points.reduce((low, p) => (dot(p, up) < dot(low, up) ? p : low));
  if (!breast.named) return own;
  const was = (name) => !breast.touched.includes(name === "wire_bottom" ? "wire" : markOf(name));
  const names = [...POINTS, "wire_bottom"];
  return Object.fromEntries(names.map((name) => [name, was(name) ? breast.named[name] : own[name]]));
}

// A line's points in the order of the file: one that nobody touched as it was.
function ordered(breast, mark, points) {
  const moved = mark === "wire" ? ["wire"] : ["neckline", "wire", "strap_point"],
    asItWas = breast.backwards.includes(mark) && !moved.some((name) => breast.touched.includes(name));
  return asItWas ? points.slice().reverse() : points;
}

// The landmark file of some breasts, by side, in the unit and frame of the scan.
function landmarkFile(breasts, told) {
  const place = (point) =>
    point.map((value, k) => {
      const own = (value + told.origin[k]) / told.factor;
      return Number(own.toFixed(told.decimals));
    });
  const blocks = Object.entries(breasts)
    .filter(([, breast]) => !isEmpty(breast))
    .map(([side, breast]) => {
      const block = { side },
        found = isOnlyFound(breast);
      if (!breast.looked && !found) block.proposed = true;
      const named = Object.entries(namedOf(breast, told.axes[1])).filter(([, point]) => point);
      block.landmarks = Object.fromEntries(named.map(([name, point]) => [name, place(point)]));
      if (breast.wire && !found) block.wire = ordered(breast, "wire", breast.wire.points).map(place);
      if (breast.inner && breast.outer) {
        const upper = [...breast.inner.points, ...breast.outer.points.slice(1)];
        block.upper_line = ordered(breast, "neckline", upper).map(place);
      }
      return block;
    });
  const head = { ...told.extra, name: told.name, units: told.unit };
  const data = blocks.length === 1 ? { ...head, ...blocks[0] } : { ...head, breasts: blocks };
  const number = "(-?[\\d.e+-]+)";
  const threes = new RegExp(`\\[\\s+${number},\\s+${number},\\s+${number}\\s+\\]`, "g");
  return JSON.stringify(data, null, 1).replace(threes, "[$1, $2, $3]") + "\n";
}
