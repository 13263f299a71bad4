// The page comes to life.

function connect(desk) {
  box("labels").innerHTML = POINTS.map(
    (name) => `<span data-name="${name}" style="color: ${shade(name)}">${NAMES[name]}</span>`,
  ).join("");
  const told = desk.told,
    click = (id, act) => box(id).addEventListener("click", act);
  const tabs = document.querySelector(".tabs");
  tabs.innerHTML = told.sides
    .map((side) => `<button type="button" data-side="${side}">${side === "left" ? "Left" : "Right"} breast</button>`)
    .join("");
  for (const tab of tabs.children)
    tab.addEventListener("click", () => {
      desk.choose(tab.dataset.side);
      if (!isEmpty(desk.breast)) desk.near();
    });
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => {
      desk.camera.show(button.dataset.view);
      desk.redraw();
    });
  }
  click("near", () => desk.near());
  click("whole", () => desk.whole());
  click("roll", () => {
    desk.camera.roll();
    desk.redraw();
  });
  click("undo", () => desk.undo());
  click("redo", () => desk.redo());
  click("add", () => desk.addBeside());
  click("remove", () => desk.remove(desk.chosen));
  click("mirror", () => desk.mirror());
  click("save", () => desk.save());
  box("marks").addEventListener("click", (e) => {
    const mark = e.target.dataset.mark;
    if (mark && mark === desk.placing && desk.pending.length >= 4) desk.finishWire();
    else if (mark) desk.place(mark === desk.placing ? null : mark);
  });
  box("looked").addEventListener("change", (e) => desk.look(e.target.checked));
  addEventListener("beforeunload", (e) => {
    if (desk.dirty && desk.kept === false) e.preventDefault();
  });
  new ResizeObserver(() => desk.redraw()).observe(box("scan"));
}

function describe(desk) {
  const told = desk.told,
    skin = desk.skin;
  box("name").textContent = told.title;
  const shown =
    skin.count < told.skin.of
      ? `${told.skin.of.toLocaleString("en")} points, ${skin.count.toLocaleString("en")} shown`
      : `${skin.count.toLocaleString("en")} points`;
  const unit = `${told.unitName}${told.unitFrom ? `, found from ${told.unitFrom}` : ""}`;
  box("about").innerHTML = [`${shown}; ${unit}`, ...told.notes]
    .map((line) => `<span>${escaped(line)}</span>`)
    .join("<br>");
  box("looked").nextElementSibling.textContent = "I have looked at this breast's marks";
  box("save").textContent = `Save ${told.file}`;
}

// What the browser kept of work on other marks than the page begins with now.
function offer(desk, kept) {
  const note = document.createElement("p"),
    button = document.createElement("button");
  note.className = "unsure";
  note.textContent = `This browser kept marks that were not saved (${new Date(kept.editedAt).toLocaleString()}). `;
  button.type = "button";
  button.textContent = "Bring them back";
  button.addEventListener("click", () => {
    desk.bringBack(kept);
    note.remove();
  });
  note.append(button);
  box("about").after(note);
}

function start() {
  const desk = new Desk(JSON.parse(box("scan-data").textContent));
  const kept = desk.restore();
  connect(desk);
  describe(desk);
  if (kept) offer(desk, kept);
  const canvas = box("scan");
  Object.assign(desk.camera, { width: canvas.clientWidth, height: canvas.clientHeight });
  desk.whole();
  desk.choose(desk.side);
  if (!isEmpty(desk.breast)) desk.near();
  new Hands(desk);
  // For tests and measurements.
  window.brafitMark = desk;
  desk.picture.warm(desk.camera);
  desk.redraw(true);
  requestAnimationFrame(() => {
    desk.picture.finish();
    document.body.dataset.ready = String(Math.round(performance.now()));
  });
}

try {
  start();
} catch (error) {
  document.querySelector(".desk").innerHTML =
    `<p class="warnings broken">This page cannot be shown: ${escaped(error.message)}</p>`;
  throw error;
}
