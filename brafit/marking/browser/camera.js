// How the scan is looked at: without perspective, turned about the body's own axes. View axes: right, up, to the viewer.

class Camera {
  static VIEWS = {
    front: [0, 0],
    left: [-Math.PI / 2, 0],
    right: [Math.PI / 2, 0],
    below: [0, -1.1],
    above: [0, 1.1],
    back: [Math.PI, 0],
  };

  constructor(axes, centre, extent) {
    this.axes = axes;
    this.home = { centre, extent };
    this.rolled = 0;
    this.width = this.height = 1;
    this.show("front");
  }

  show(view) {
    [this.yaw, this.pitch] = Camera.VIEWS[view];
  }

  // The centre of the picture, and how much (mm) is seen at least.
  look(centre, extent) {
    this.centre = centre;
    this.zoom = 1;
    this.extent = extent;
  }

  roll() {
    const [x, y, z] = this.axes;
    this.axes = [y, times(-1, x), z];
  }

  turn(dx, dy) {
    this.yaw += dx;
    this.pitch = clamp(this.pitch + dy, -Math.PI / 2, Math.PI / 2);
  }

  get scale() {
    return (this.zoom * Math.min(this.width, this.height)) / this.extent;
  }

  // Rows: to the picture's right, up and to the viewer, in the scan's frame.
  get rows() {
    const cy = Math.cos(this.yaw),
      sy = Math.sin(this.yaw),
      cp = Math.cos(this.pitch),
      sp = Math.sin(this.pitch);
    const turned = [
      [cy, 0, sy],
      [sp * sy, cp, -sp * cy],
      [-cp * sy, sp, cp * cy],
    ];
    return turned.map((row) => this.axes.reduce((sum, axis, k) => along(sum, row[k], axis), [0, 0, 0]));
  }

  // Place in the picture (px from its upper left corner) and depth (mm to the viewer).
  project(point) {
    const [right, up, towards] = this.rows,
      away = minus(point, this.centre),
      scale = this.scale;
    return [this.width / 2 + scale * dot(away, right), this.height / 2 - scale * dot(away, up), dot(away, towards)];
  }

  // The place of the scan's frame in the plane through a point (else the centre) at a place of the picture.
  unproject(x, y, through = this.centre) {
    const [right, up, towards] = this.rows,
      depth = dot(minus(through, this.centre), towards),
      scale = this.scale;
    const flat = along(along(this.centre, (x - this.width / 2) / scale, right), (this.height / 2 - y) / scale, up);
    return along(flat, depth, towards);
  }

  get towards() {
    return this.rows[2];
  }

  pan(dx, dy) {
    const [right, up] = this.rows,
      scale = this.scale;
    this.centre = along(along(this.centre, -dx / scale, right), dy / scale, up);
  }

  // Nearer or farther, the place under the pointer stays where it is.
  approach(factor, x, y) {
    const before = this.unproject(x, y);
    this.zoom = clamp(this.zoom * factor, 0.3, 40);
    this.centre = plus(this.centre, minus(before, this.unproject(x, y)));
  }
}
