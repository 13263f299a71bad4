// Mouse, touch and keys.

const MOUSE_REACH = 13,
  TOUCH_REACH = 24,
  STILL = 5; // px

class Hands {
  constructor(desk) {
    this.desk = desk;
    this.fingers = new Map();
    const canvas = box("scan"),
      on = (kind, act, options) => canvas.addEventListener(kind, act, options);
    on("pointerdown", (e) => this.#down(e));
    on("pointermove", (e) => this.#move(e));
    on("pointerup", (e) => this.#up(e));
    on("pointercancel", (e) => this.#up(e));
    on("pointerleave", () => this.#hover(null));
    on("dblclick", (e) => this.#double(e));
    on("contextmenu", (e) => e.preventDefault());
    on(
      "wheel",
      (e) => {
        e.preventDefault();
        desk.camera.approach(Math.exp(-0.0013 * e.deltaY * (e.deltaMode === 1 ? 30 : 1)), e.offsetX, e.offsetY);
        desk.redraw(true);
      },
      { passive: false },
    );
    on("keydown", (e) => this.#key(e));
    addEventListener("keydown", (e) => this.#shortcut(e));
  }

  #down(e) {
    const desk = this.desk,
      canvas = box("scan");
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(e.pointerId);
    this.fingers.set(e.pointerId, { x: e.offsetX, y: e.offsetY, from: [e.offsetX, e.offsetY] });
    this.moved = this.fingers.size > 1;
    if (this.fingers.size > 1) {
      this.#release();
      return;
    }
    this.panning = e.button === 2 || e.button === 1 || e.shiftKey;
    const id =
      this.panning || desk.placing
        ? null
        : desk.handleAt(e.offsetX, e.offsetY, e.pointerType === "touch" ? TOUCH_REACH : MOUSE_REACH);
    if (id) {
      const [x, y] = desk.camera.project(desk.placeOf(id));
      this.offset = [x - e.offsetX, y - e.offsetY];
      desk.held = desk.chosen = id;
      desk.changed();
    }
    canvas.classList.add("held");
  }

  #move(e) {
    const desk = this.desk,
      finger = this.fingers.get(e.pointerId);
    if (!finger) {
      if (e.pointerType !== "touch") this.#hover(e);
      return;
    }
    const dx = e.offsetX - finger.x,
      dy = e.offsetY - finger.y;
    if (Math.hypot(e.offsetX - finger.from[0], e.offsetY - finger.from[1]) > STILL) this.moved = true;
    if (this.fingers.size === 2) this.#pinch(e, dx, dy);
    else if (desk.held) {
      if (this.moved) desk.drag(desk.held, e.offsetX + this.offset[0], e.offsetY + this.offset[1]);
    } else if (this.moved) {
      if (this.panning) desk.camera.pan(dx, dy);
      else desk.camera.turn(0.008 * dx, 0.008 * dy);
      desk.redraw(true);
    }
    Object.assign(finger, { x: e.offsetX, y: e.offsetY });
  }

  // Two fingers: apart and together brings nearer and away, both moved move the picture.
  #pinch(e, dx, dy) {
    const [one, two] = [...this.fingers.values()],
      own = this.fingers.get(e.pointerId),
      rest = own === one ? two : one;
    const before = Math.hypot(own.x - rest.x, own.y - rest.y),
      after = Math.hypot(e.offsetX - rest.x, e.offsetY - rest.y);
    this.desk.camera.approach(after / Math.max(before, 1), rest.x, rest.y);
    this.desk.camera.pan(dx / 2, dy / 2);
    this.desk.redraw(true);
  }

  #up(e) {
    const desk = this.desk;
    if (!this.fingers.delete(e.pointerId)) return;
    if (!desk.held && !this.moved && e.type === "pointerup" && e.button === 0) {
      if (desk.placing) desk.click(e.offsetX, e.offsetY);
      else if (desk.chosen) {
        desk.chosen = null;
        desk.changed();
      }
    }
    this.#release();
    if (!this.fingers.size) box("scan").classList.remove("held");
  }

  #release() {
    const desk = this.desk;
    if (!desk.held) return;
    desk.held = null;
    desk.drop();
    desk.changed();
  }

  #hover(e) {
    const desk = this.desk,
      over = e && !desk.placing ? desk.handleAt(e.offsetX, e.offsetY, MOUSE_REACH) : null;
    if (over === desk.over) return;
    desk.over = over;
    box("scan").classList.toggle("over", over !== null);
    desk.redraw();
  }

  #double(e) {
    const desk = this.desk,
      { offsetX: x, offsetY: y } = e;
    if (desk.placing === "wire") {
      // The second click of the two put its place twice.
      const [a, b] = desk.pending.slice(-2);
      if (b && apart(a, b) * desk.camera.scale < 2 * STILL) desk.pending = desk.pending.slice(0, -1);
      desk.finishWire();
    }
    if (desk.placing) return;
    const id = desk.handleAt(x, y, MOUSE_REACH),
      key = desk.lineAt(x, y, MOUSE_REACH);
    if (id) desk.remove(id);
    else if (key) desk.add(key, desk.pick(x, y) || desk.camera.unproject(x, y));
  }

  // Keys of the picture.
  #key(e) {
    const desk = this.desk,
      steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (steps && e.altKey) desk.nudge(...steps.map((step) => step * (e.shiftKey ? 5 : 1)));
    else if (steps) {
      desk.camera.turn(0.1 * steps[0], 0.1 * steps[1]);
      desk.redraw(true);
    } else if (e.key === "+" || e.key === "-") {
      desk.camera.approach(e.key === "+" ? 1.15 : 0.87, desk.camera.width / 2, desk.camera.height / 2);
      desk.redraw(true);
    } else if (e.key === "Tab") {
      if (!this.#next(e.shiftKey ? -1 : 1)) return;
    } else if (e.key === "Enter" && desk.placing === "wire") desk.finishWire();
    else if (e.key === "Escape") desk.place(null);
    else if (e.key === "Backspace" && desk.pending.length) desk.undo();
    else if (e.key === "Delete" || e.key === "Backspace") desk.remove(desk.chosen);
    else return;
    e.preventDefault();
  }

  // The next or previous handle; false behind the last one, so that Tab leaves the picture.
  #next(step) {
    const desk = this.desk,
      ids = allHandles(desk.breast).map((handle) => handle.id);
    const at = desk.chosen ? ids.indexOf(desk.chosen) + step : step > 0 ? 0 : -1;
    desk.chosen = ids[at] || null;
    desk.changed();
    return desk.chosen !== null;
  }

  // Keys of the whole page.
  #shortcut(e) {
    const desk = this.desk,
      key = e.key.toLowerCase(),
      command = e.ctrlKey || e.metaKey;
    if (command && key === "z") e.shiftKey ? desk.redo() : desk.undo();
    else if (command && key === "y") desk.redo();
    else if (command && key === "s") {
      if (!box("save").disabled) desk.save();
    } else if (command || e.altKey) return;
    else if ("12345".includes(key) && key) document.querySelectorAll("[data-view]")[Number(key) - 1].click();
    else if ("nwr".includes(key) && key.length === 1) box({ n: "near", w: "whole", r: "roll" }[key]).click();
    else return;
    e.preventDefault();
  }
}
