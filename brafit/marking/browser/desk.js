// The desk: the state of the page, and what each act does to it. Drawing and panel follow by `changed` and `redraw`.

class Desk {
  static REST = 160; // ms after which a view that does not turn any more is drawn in full
  static OWN = 10; // skin within so many mm of a mark is its own

  constructor(told) {
    this.told = told;
    this.skin = new Skin(told.skin);
    this.picture = new Picture(box("scan"), this.skin, size(this.skin.high));
    this.camera = new Camera(told.axes, times(0.5, this.skin.high), 1.06 * told.extent);
    this.store = new Store(told.key);
    this.side = told.side;
    this.history = new History(this.#begin());
    this.held = this.chosen = this.over = this.placing = null;
    this.pending = [];
    this.frames = [];
    this.turning = false;
  }

  // Each breast as the landmark file or the proposals have it, else empty. One that is not to be marked is saved too.
  #begin() {
    const breasts = {};
    for (const side of new Set([...this.told.sides, ...this.told.breasts.map((breast) => breast.side)])) {
      const own = this.told.breasts.find((breast) => breast.side === side);
      breasts[side] = own ? breastOf(own) : nothing("hand");
    }
    return breasts;
  }

  get breasts() {
    return this.history.now;
  }
  get breast() {
    return this.breasts[this.side];
  }
  get toldOf() {
    return this.told.breasts.find((breast) => breast.side === this.side) || null;
  }

  get doubts() {
    return doubtsOf(this.breast, this.toldOf, this.told.faults[this.side]);
  }

  // Take up what this browser kept: at once if it goes on from the same start, else it is offered.
  restore() {
    const kept = this.store.read();
    if (!kept || !kept.breasts || Object.keys(kept.breasts).some((side) => !(side in this.breasts))) return null;
    this.savedAt = kept.savedAt || null;
    if (kept.start === this.told.start || !kept.dirty) {
      if (kept.start === this.told.start) this.#take(kept);
      return null;
    }
    return kept;
  }

  #take(kept) {
    const whole = Object.entries(kept.breasts).map(([side, breast]) => [side, { ...nothing(breast.origin), ...breast }]);
    this.history.push({ ...this.breasts, ...Object.fromEntries(whole) });
    this.dirty = kept.dirty;
  }

  bringBack(kept) {
    this.#take(kept);
    this.changed();
  }

  keep() {
    const now = new Date().toISOString();
    this.kept = this.store.write({
      start: this.told.start,
      breasts: this.breasts,
      unseen: Object.keys(this.breasts).filter((side) => isUnseen(this.breasts[side])),
      editedAt: now,
      savedAt: this.savedAt || null,
      dirty: this.dirty,
    });
  }

  commit(breasts) {
    this.history.push(breasts);
    this.dirty = true;
    this.keep();
    this.changed();
  }
  set(breast) {
    this.commit({ ...this.breasts, [this.side]: breast });
  }

  undo() {
    if (this.pending.length) {
      this.pending = this.pending.slice(0, -1);
      return this.changed();
    }
    this.history.undo();
    this.#after();
  }
  redo() {
    this.history.redo();
    this.#after();
  }
  #after() {
    this.dirty = true;
    this.chosen = this.held = null;
    this.keep();
    this.changed();
  }

  choose(side) {
    Object.assign(this, { side, chosen: null, placing: null, pending: [] });
    if (isEmpty(this.breast)) this.place(nextMark(this.breast));
    this.changed();
  }

  // Views

  near() {
    const breast = this.breast,
      marks = breast.wire ? breast.wire.points : POINTS.map((name) => breast[name]).filter(Boolean);
    const all = [...marks, ...[breast.strap_point, breast.apex].filter(Boolean)];
    if (!all.length) return this.whole();
    const low = [0, 1, 2].map((k) => Math.min(...all.map((p) => p[k]))),
      high = [0, 1, 2].map((k) => Math.max(...all.map((p) => p[k])));
    this.camera.look(between(low, high, 0.5), Math.max(120, 1.25 * apart(low, high)));
    this.redraw();
  }
  whole() {
    this.camera.look(this.camera.home.centre, this.camera.home.extent);
    this.redraw();
  }

  // Marks

  // The place on the skin at a place of the picture, if there is some.
  pick(x, y) {
    return this.skin.hit(this.camera.unproject(x, y), this.camera.towards);
  }

  // Where a mark at a place comes to when it is moved in the picture: on the skin that is seen; if it is hidden, on its
  // own part of the skin; where there is no skin, in the plane of the picture.
  moved(at, x, y, hidden) {
    const flat = this.camera.unproject(x, y, at);
    return (hidden ? this.skin.settled(flat, Desk.OWN) : this.pick(x, y)) || flat;
  }
  isHidden(at) {
    const seen = this.skin.hit(at, this.camera.towards);
    return seen !== null && dot(minus(seen, at), this.camera.towards) > Desk.OWN;
  }

  handleAt(x, y, reach) {
    let best = null,
      least = reach;
    for (const { id, at } of allHandles(this.breast)) {
      const [u, v] = this.camera.project(at),
        away = Math.hypot(u - x, v - y);
      // Of two at one place the named one, which comes last, is meant.
      if (away <= least) {
        least = away;
        best = id;
      }
    }
    return best;
  }

  lineAt(x, y, reach) {
    let best = null,
      least = reach;
    for (const key of Object.keys(ENDS)) {
      if (!this.breast[key]) continue;
      const flat = this.breast[key].points.map((point) => [...this.camera.project(point).slice(0, 2), 0]);
      const { away } = nearestOn(flat, [x, y, 0]);
      if (away <= least) {
        least = away;
        best = key;
      }
    }
    return best;
  }

  placeOf(id) {
    return allHandles(this.breast).find((handle) => handle.id === id).at;
  }

  // While a handle is dragged the state is shown, but not yet kept: one drag is one step to undo. It is moved once a
  // picture, however many moves of the pointer there are.
  drag(id, x, y) {
    this.wanted = { id, x, y };
    this.redraw();
  }
  #dragged() {
    if (!this.wanted) return;
    const { id, x, y } = this.wanted,
      from = this.placeOf(id);
    this.wanted = null;
    if (!this.before) Object.assign(this, { before: this.breasts, hidden: this.isHidden(from) });
    const at = this.moved(from, x, y, this.hidden);
    this.history.states[this.history.at] = { ...this.breasts, [this.side]: withHandle(this.breast, id, at, this.skin) };
    this.#judge();
  }
  drop() {
    this.#dragged();
    if (!this.before) return;
    const after = this.breasts;
    this.history.states[this.history.at] = this.before;
    this.before = null;
    this.commit(after);
  }

  nudge(dx, dy) {
    if (!this.chosen) return;
    const at = this.placeOf(this.chosen),
      [x, y] = this.camera.project(at),
      scale = this.camera.scale;
    const to = this.moved(at, x + dx * scale, y + dy * scale, this.isHidden(at));
    this.set(withHandle(this.breast, this.chosen, to, this.skin));
  }

  add(key, point) {
    const [breast, id] = withMore(this.breast, key, point, this.skin);
    this.chosen = id;
    this.set(breast);
  }
  // Between the chosen handle and the next one.
  addBeside() {
    const key =
      this.chosen &&
      (this.chosen in NAMES
        ? Object.keys(ENDS).find((line) => this.breast[line] && ENDS[line].includes(this.chosen))
        : this.chosen.split(".")[0]);
    if (!key) return;
    const handles = handlesOf(this.breast, key),
      at = this.placeOf(this.chosen),
      points = this.breast[key].points;
    const i = Math.min(handles.indexOf(at), handles.length - 2);
    const [a, b] = [handles[i], handles[i + 1]].map((place) => nearestOn(points, place).segment);
    this.add(key, points[Math.round((a + b + 1) / 2)]);
  }
  remove(id) {
    const breast = id && withLess(this.breast, id, this.skin);
    if (breast) {
      this.chosen = null;
      this.set(breast);
    }
  }

  // Begin to place a mark by clicks, or stop it.
  place(mark) {
    if (mark === "neckline") return this.set(withNeckline(this.breast, this.told.axes[2], this.skin));
    this.placing = mark;
    this.pending = [];
    this.chosen = null;
    this.changed();
  }
  click(x, y) {
    const at = this.placing && this.pick(x, y);
    if (!at) return;
    if (this.placing === "wire") {
      this.pending = [...this.pending, at];
      this.changed();
      return;
    }
    this.#placed(touching({ ...this.breast, [this.placing]: at }, this.placing));
  }
  finishWire() {
    if (this.pending.length >= 4) this.#placed(withWire(this.breast, this.pending, this.skin));
  }
  #placed(breast) {
    const mark = this.placing,
      ends = breast.wire && breast.strap_point;
    let placed = breast;
    if (mark === "strap_point") placed = redrawn(placed, ["inner", "outer"], this.skin);
    if (ends && !placed.inner) placed = withNeckline(placed, this.told.axes[2], this.skin);
    this.pending = [];
    const next = nextMark(placed);
    this.placing = next;
    this.set(placed);
  }

  mirror() {
    if (!this.told.mirror || isEmpty(this.breast)) return;
    const there = other(this.side),
      breasts = { ...this.breasts, [there]: mirroredBreast(this.breast, this.told.mirror, this.skin) };
    Object.assign(this, { side: there, chosen: null, placing: null, pending: [] });
    this.commit(breasts);
    this.near();
  }
  look(looked) {
    this.set({ ...this.breast, looked });
  }

  // The landmark file, to be put beside the scan.
  save() {
    const text = landmarkFile(this.breasts, this.told),
      link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = this.told.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    this.savedAt = new Date().toISOString();
    this.dirty = false;
    this.keep();
    this.changed();
  }

  // Drawing

  changed() {
    this.#judge();
    this.#showPanel();
    this.redraw();
  }

  #judge() {
    const breast = this.breast,
      figures = figuresOf(breast, this.side, this.told.catalogue, this.skin);
    showFigures(figures);
    const unseen = this.doubts.length
      ? "the doubts above stand"
      : isUnseen(breast)
        ? "nobody has looked at these marks yet"
        : "";
    showFaults(faultsOf(breast, this.side, figures, this.told, this.skin), breast.wire && breast.apex, unseen);
  }

  #showPanel() {
    const breast = this.breast,
      empty = Object.values(this.breasts).every(isEmpty);
    showMarks(breast, this.placing, this.pending);
    showOrigin(breast, this.toldOf, this.doubts);
    for (const tab of document.querySelectorAll("[data-side]"))
      tab.setAttribute("aria-pressed", String(tab.dataset.side === this.side));
    box("undo").disabled = !this.history.canUndo && !this.pending.length;
    box("redo").disabled = !this.history.canRedo;
    box("add").disabled = !this.chosen || this.chosen === "apex" || !this.breast.wire;
    box("remove").disabled = !this.chosen || this.chosen in NAMES;
    box("save").disabled = empty;
    box("looked").checked = breast.looked;
    box("looked").parentElement.hidden = breast.origin === "hand";
    const can = this.told.mirror && !isEmpty(breast) && this.told.sides.length > 1;
    box("mirror").disabled = !can;
    box("mirror").title = this.told.mirror ? "" : "The scan is no torso that is symmetric enough";
    box("hint").textContent = hintFor(this);
    box("scan").classList.toggle("placing", this.placing !== null);
    box("mirror").textContent = `Copy to the ${other(this.side)} side`;
    const when = this.savedAt
      ? `Saved ${new Date(this.savedAt).toLocaleString()}${this.dirty ? ", changed since" : ""}. `
      : "";
    const lost =
      this.dirty && this.kept === false ? "This browser keeps nothing: save before you close the page. " : "";
    box("saved").textContent =
      `${lost}${when}Put ${this.told.file} into ${this.told.folder}, beside ${this.told.scan}.`;
  }

  redraw(turning = false) {
    if (turning) {
      this.turning = true;
      clearTimeout(this.rest);
      this.rest = setTimeout(() => {
        this.turning = false;
        this.redraw();
      }, Desk.REST);
    }
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.#draw());
  }

  #draw() {
    this.waiting = false;
    this.#dragged();
    const canvas = box("scan"),
      begun = performance.now();
    Object.assign(this.camera, { width: canvas.clientWidth, height: canvas.clientHeight });
    this.picture.draw(this.camera, strokesOf(this.breasts, this.side, this), this.turning);
    if (this.turning) {
      this.picture.finish();
      this.frames.push(performance.now() - begun);
    }
    this.#drawLabels();
  }

  // Elements are moved, not made anew: that is cheaper by far.
  #drawLabels() {
    const scale = this.camera.scale,
      step = [1, 2, 5, 10, 20, 50, 100, 200].filter((mm) => mm * scale < 140).pop() || 1;
    const [words, line] = box("bar").children;
    if (words.textContent !== `${step} mm`) words.textContent = `${step} mm`;
    if (line.style.width !== `${step * scale}px`) line.style.width = `${step * scale}px`;
    for (const label of box("labels").children) {
      const at = this.breast[label.dataset.name];
      label.hidden = at === null;
      if (at === null) continue;
      const [x, y] = this.camera.project(at);
      label.style.transform = `translate(${Math.round(x + 13)}px, ${Math.round(y - 26)}px)`;
    }
  }
}
