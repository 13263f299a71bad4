// What was done, to be undone; and kept by the browser, so that a closed page loses nothing.

class History {
  constructor(first) {
    this.states = [first];
    this.at = 0;
  }
  get now() {
    return this.states[this.at];
  }
  get canUndo() {
    return this.at > 0;
  }
  get canRedo() {
    return this.at < this.states.length - 1;
  }
  push(state) {
    this.states = [...this.states.slice(Math.max(0, this.at - 300), this.at + 1), state];
    this.at = this.states.length - 1;
  }
  undo() {
    if (this.canUndo) this.at--;
  }
  redo() {
    if (this.canRedo) this.at++;
  }
}

// The browser's store under one key, in tenths of a micrometre, since it is small; where the browser keeps none for pages of files, nothing is kept.
class Store {
  constructor(key) {
    this.key = key;
  }
  read() {
    try {
      return JSON.parse(localStorage.getItem(this.key));
    } catch {
      return null;
    }
  }
  write(value) {
    const short = (_, part) => (typeof part === "number" ? Number(part.toFixed(4)) : part);
    try {
      localStorage.setItem(this.key, JSON.stringify(value, short));
      return true;
    } catch {
      return false;
    }
  }
}
