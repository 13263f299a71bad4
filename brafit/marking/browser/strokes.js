// How marks look: lines and dots in the picture, and their names.

const NAMES = { inner_end: "Inner end", outer_end: "Outer end", strap_point: "Strap point", apex: "Bust point" };
const COLOURS = {
  wire: [0.82, 0.28, 0.05, 1],
  inner: [0.11, 0.45, 0.18, 1],
  outer: [0.11, 0.45, 0.18, 1],
  inner_end: [0.82, 0.28, 0.05, 1],
  outer_end: [0.82, 0.28, 0.05, 1],
  strap_point: [0.11, 0.45, 0.18, 1],
  apex: [0.04, 0.33, 0.58, 1],
};
const HALO = [1, 1, 1, 0.85];
const faint = (colour) => [...colour.slice(0, 3), 0.45];

// Lines and dots of the breasts: those of the one that is worked on with handles.
function strokesOf(breasts, side, { held, chosen, over, pending }) {
  const lines = [],
    dots = [];
  for (const [own, breast] of Object.entries(breasts)) {
    const active = own === side;
    for (const key of Object.keys(ENDS)) {
      if (!breast[key]) continue;
      if (active) lines.push({ points: breast[key].points, width: 6, colour: HALO });
      lines.push({
        points: breast[key].points,
        width: active ? 2.6 : 1.8,
        colour: active ? COLOURS[key] : faint(COLOURS[key]),
      });
    }
    if (!active) continue;
    for (const { id, at, of } of allHandles(breast)) {
      const lit = id === held || id === chosen || id === over;
      dots.push({
        at,
        width: (of in NAMES ? 17 : 13) + (lit ? 5 : 0),
        colour: COLOURS[of],
        filled: lit || of in NAMES,
      });
    }
  }
  if (pending.length > 1)
    lines.push(
      { points: splined(pending), width: 6, colour: HALO },
      { points: splined(pending), width: 2.6, colour: COLOURS.wire },
    );
  for (const at of pending) dots.push({ at, width: 14, colour: COLOURS.wire, filled: true });
  return { lines, dots };
}
