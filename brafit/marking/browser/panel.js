// The panel beside the picture: which breast, which marks, figures, what is wrong, what to do next.

const box = (id) => document.getElementById(id);
const escaped = (words) =>
  String(words).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const signed = (value) => `${value >= 0 ? "+" : "−"}${Math.abs(value).toFixed(1)}`;
const other = (side) => (side === "left" ? "right" : "left");
const list = (lines) => `<ul>${lines.map((line) => `<li>${escaped(line)}</li>`).join("")}</ul>`;
const shade = (name) =>
  `rgb(${COLOURS[name]
    .slice(0, 3)
    .map((c) => Math.round(255 * c))
    .join(" ")})`;
const MARKS = [
  ["wire", "Wire"],
  ["strap_point", "Strap point"],
  ["apex", "Bust point"],
  ["neckline", "Neckline"],
];
const has = (breast, mark) =>
  mark === "neckline" ? breast.inner !== null && breast.outer !== null : breast[mark] !== null;

// What is to be placed next on a breast that is marked by hand; null where all is there.
function nextMark(breast) {
  return ["wire", "strap_point", "apex"].find((mark) => !has(breast, mark)) || null;
}

const HINTS = {
  wire: (count) =>
    count === 0
      ? "Wire: click its inner end, by the breastbone; then go along the crease under the breast."
      : count < 4
        ? `Wire: go on along the crease, 5 to 8 clicks up to the outer end (${count} so far).`
        : `Wire: go on, or finish it at the outer end with a double click or Enter (${count} so far).`,
  strap_point: () => "Strap point: click where the strap is to meet the cup's upper edge.",
  apex: () => "Bust point: click where the breast comes out farthest. From the side one sees it best.",
};

// What to do next.
function hintFor({ breast, side, breasts, told, placing, pending, dirty }) {
  if (placing) return HINTS[placing](pending.length);
  if (isUnseen(breast))
    return "Look from several sides, drag what is off. Then tick that you have looked at this breast.";
  const missing = nextMark(breast),
    beside = told.sides.includes(other(side)) ? breasts[other(side)] : null;
  if (missing) return `${missing === "wire" ? "Wire" : NAMES[missing]}: not marked. Place it, or leave it to brafit.`;
  if (beside && isUnseen(beside)) return `The ${other(side)} breast's marks are not looked at yet.`;
  return dirty ? "Save when you are done." : "Drag a mark to move it, drag beside the marks to turn the scan.";
}

function showMarks(breast, placing, pending) {
  box("marks").tBodies[0].innerHTML = MARKS.map(([mark, name]) => {
    const there = has(breast, mark),
      usable = mark !== "neckline" || (breast.wire && breast.strap_point);
    const word =
      placing === mark
        ? pending.length >= 4
          ? "finish"
          : "stop"
        : mark === "neckline"
          ? there
            ? "lay anew"
            : "lay"
          : there
            ? "place anew"
            : "place";
    const said = there ? "" : mark === "neckline" ? "brafit builds one" : "none";
    return (
      `<tr><td style="--dot: ${shade(mark === "neckline" ? "inner" : mark)}">${name}</td><td class="soft">${said}</td>` +
      `<td><button type="button" data-mark="${mark}" aria-label="${word} ${name.toLowerCase()}"${usable ? "" : " disabled"}>${word}</button></td></tr>`
    );
  }).join("");
}

function showFigures(figures) {
  const line = (name, value, title = "") =>
    `<tr title="${escaped(title)}"><td>${name}</td><td class="number">${value}</td></tr>`;
  if (!figures) {
    box("figures").tBodies[0].innerHTML = line("Wire", "not marked yet");
    return;
  }
  const rows = [
    line("Wire, length", `${figures.length.toFixed(1)} mm`),
    line("Wire, end to end", `${figures.span.toFixed(1)} mm`),
    line(
      "Depth of the breast",
      figures.depth === null ? "no bust point" : `${figures.depth.toFixed(1)} mm`,
      "how far the breast comes out of the wire's plane",
    ),
    ...(figures.neckline === null ? [] : [line("Neckline, length", `${figures.neckline.toFixed(1)} mm`)]),
    ...figures.sold.map(
      (wire, i) =>
        `<tr${i ? "" : ' class="rule"'} title="how much longer and wider it is than the wire line, mm"><td>` +
        `${i ? escaped(wire.name) : `<b>${escaped(wire.name)}</b>`}</td><td class="number"><span>${signed(wire.longer)} long,</span> <span>${signed(wire.wider)} wide</span></td></tr>`,
    ),
  ];
  box("figures").tBodies[0].innerHTML = rows.join("");
}

// `unseen`: why it can't be said that nothing is implausible, though no fault is found; else empty.
function showFaults(faults, complete, unseen) {
  const of = (refused) => faults.filter((fault) => fault.refused === refused).map((fault) => fault.says);
  const [bad, odd] = [of(true), of(false)];
  box("faults").innerHTML =
    (bad.length ? `<div class="warnings">brafit would refuse this:${list(bad)}</div>` : "") +
    (odd.length ? `<div class="unsure">Unusual:${list(odd)}</div>` : "") +
    (complete && !faults.length
      ? unseen
        ? `<div class="soft">All measures are within their usual ranges, but ${unseen}.</div>`
        : '<div class="fine">Nothing is implausible.</div>'
      : "");
}

// What is said against the marks with which a breast began, as long as it stands: a doubt until the mark that it speaks
// of is moved or all are looked at; never of other marks than those, like copied ones.
function doubtsOf(breast, told, faults = []) {
  if (isEmpty(breast)) return faults;
  if (!told || breast.origin !== told.origin) return [];
  if (breast.origin === "given") return breast.touched.length ? [] : faults;
  if (breast.looked) return [];
  return [...faults, ...told.doubts.filter((doubt) => !breast.touched.includes(doubt.mark)).map((doubt) => doubt.says)];
}

const TOLD = 1; // copied marks that lie closer to the mirror image than so many mm are said to be copied, no more

// Where the marks of a breast are from, and how far they can be trusted.
function showOrigin(breast, told, doubts) {
  const origins = {
    given: "Marks of the landmark file.",
    proposed: `Proposed by brafit, confidence ${told && told.confidence !== null ? told.confidence.toFixed(1) : "unknown"}. Nobody has looked at them yet.`,
    mirrored: `Copied from the other side${
      breast.moved >= TOLD ? ` and laid on the skin here, which moved marks by up to ${breast.moved.toFixed(1)} mm` : ""
    }; look at it.`,
    hand: isEmpty(breast) ? "Nothing is marked on this side." : "",
  };
  const said = breast.looked && ["proposed", "mirrored"].includes(breast.origin) ? "" : origins[breast.origin];
  const more =
    breast.origin === "given" && told && told.detected
      ? ["The file has no wire: this one was found in the crease."]
      : [];
  const words = [...doubts, ...more];
  box("origin").innerHTML =
    said || words.length
      ? `<div class="${(breast.looked || isEmpty(breast)) && !doubts.length ? "soft" : "unsure"}">${escaped(said)}${words.length ? list(words) : ""}</div>`
      : "";
}
