// The picture of the skin, and lines and handles over it (WebGL 2). While the view turns, so many points are drawn as
// the machine draws in time; once it rests, all of them, smoothed.

class Picture {
  static FRAME = 22; // ms that a picture may take while the view turns
  static FINE = 400; // ms that it may take once the view rests
  static FEWEST = 8000; // points that are always drawn
  static LIFT = 4; // lines are seen this far (mm) below the skin

  constructor(canvas, skin, diagonal) {
    this.canvas = canvas;
    this.skin = skin;
    this.deep = 1.2 * diagonal;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
    if (!gl)
      throw new Error(
        "This browser has no WebGL 2, which the picture needs: take a current Chromium, Firefox or Safari.",
      );
    this.gl = gl;
    this.discs = this.#program(DISCS_VERTEX, DISCS_FRAGMENT);
    this.fine = this.#program(DISCS_VERTEX, DISCS_FRAGMENT.replace("precision", "#define FINE\nprecision"));
    this.smooth = this.#program(WHOLE_VERTEX, SMOOTH_FRAGMENT);
    this.shade = this.#program(WHOLE_VERTEX, SHADE_FRAGMENT);
    this.copy = this.#program(WHOLE_VERTEX, COPY_FRAGMENT);
    this.strokes = this.#program(STROKES_VERTEX, STROKES_FRAGMENT);
    this.points = this.#array(skin.buffer, gl.STATIC_DRAW, [
      [3, gl.UNSIGNED_SHORT, 8, 0],
      [2, gl.BYTE, 8, 6],
      [1, gl.UNSIGNED_BYTE, 1, 8 * skin.count],
    ]);
    this.dynamic = this.#array(0, gl.DYNAMIC_DRAW, [
      [3, gl.FLOAT, 40, 0],
      [3, gl.FLOAT, 40, 12],
      [4, gl.FLOAT, 40, 24],
    ]);
    this.empty = gl.createVertexArray();
    this.budget = Math.min(skin.count, 40000);
    this.sharpness = 0.64;
    this.fineness = 1;
    this.drawn = null;
  }

  #program(vertex, fragment) {
    const gl = this.gl,
      program = gl.createProgram();
    for (const [kind, source] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  #array(data, usage, attributes) {
    const gl = this.gl,
      vertices = gl.createVertexArray(),
      buffer = gl.createBuffer();
    gl.bindVertexArray(vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    attributes.forEach(([count, type, stride, offset], place) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, count, type, type !== gl.FLOAT, stride, offset);
    });
    return { vertices, buffer };
  }

  // The textures that the passes write to, as large as the picture.
  #targets(width, height) {
    if (this.size && this.size[0] === width && this.size[1] === height) return;
    const gl = this.gl;
    const texture = (inside, filter = gl.NEAREST) => {
      const made = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, made);
      gl.texStorage2D(gl.TEXTURE_2D, 1, inside, width, height);
      for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, filter);
      return made;
    };
    const frame = (colour, depth) => {
      const made = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, made);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, colour, 0);
      if (depth) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
      return made;
    };
    for (const old of [this.normals, this.depths, this.smoothed, this.shaded]) if (old) gl.deleteTexture(old);
    for (const old of [this.first, this.halfway, this.again, this.second]) if (old) gl.deleteFramebuffer(old);
    this.normals = texture(gl.RGBA8);
    this.smoothed = texture(gl.RGBA8);
    this.depths = texture(gl.DEPTH_COMPONENT24);
    this.shaded = texture(gl.RGBA8, gl.LINEAR);
    this.first = frame(this.normals, this.depths);
    this.halfway = frame(this.smoothed, null);
    this.again = frame(this.normals, null);
    this.second = frame(this.shaded, null);
    this.size = [width, height];
  }

  // Draw the scan as the camera sees it, unless that picture is there already; then the strokes.
  draw(camera, strokes, turning) {
    const begun = performance.now(),
      ratio = window.devicePixelRatio || 1,
      rows = camera.rows;
    const whole = [camera.width, camera.height].map((side) => Math.max(1, Math.round(side * ratio)));
    const wanted = JSON.stringify([rows, camera.centre, camera.scale, whole, turning ? this.budget : 0]),
      anew = this.drawn !== wanted;
    if (anew) {
      // In steps, so that the textures are not made anew for every picture.
      const share = 0.8 ** Math.round(Math.log(turning ? this.sharpness : this.fineness) / Math.log(0.8));
      const part = whole.map((side) => Math.max(1, Math.round(share * side)));
      const [width, height] = turning ? part : whole;
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      this.#targets(...part);
      this.#drawSkin(camera, rows, turning);
      this.drawn = wanted;
    }
    const { width, height } = this.canvas;
    this.#drawCopy(width, height);
    this.#drawStrokes(camera, strokes, width, height, width / camera.width);
    if (!anew) return;
    this.finish();
    this.#adapt(performance.now() - begun, turning);
  }

  #drawSkin(camera, rows, turning) {
    const gl = this.gl,
      { program, places } = turning ? this.discs : this.fine,
      [width, height] = this.size,
      skin = this.skin;
    const count = turning ? Math.min(this.budget, skin.count) : skin.count,
      pixels = (camera.scale * height) / camera.height;
    // Fewer points are larger, so that the skin stays closed.
    const wider = Math.sqrt(skin.count / count) * (turning ? 0.75 : 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.first);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(program);
    gl.uniformMatrix3fv(places.rows, true, rows.flat());
    gl.uniform3fv(places.centre, camera.centre);
    gl.uniform1f(places.extent, skin.extent);
    gl.uniform1f(places.depth, this.deep);
    gl.uniform1f(places.radius, 255 * skin.unitSize * wider);
    gl.uniform1f(places.pixels, pixels);
    gl.uniform2f(places.scale, (2 * pixels) / width, (2 * pixels) / height);
    gl.bindVertexArray(this.points.vertices);
    gl.drawArrays(gl.POINTS, 0, count);
    this.#drawShade(pixels, wider * skin.spacing, turning);
  }

  // One picture of the size of the targets, made by a program from two textures.
  #pass({ program, places }, target, normals, numbers) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, normals);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.depths);
    gl.uniform1i(places.normals, 0);
    gl.uniform1i(places.depths, 1);
    gl.uniform1f(places.deep, 2 * this.deep);
    for (const [name, value] of Object.entries(numbers)) {
      if (Array.isArray(value)) gl.uniform2fv(places[name], value);
      else if (name === "rings") gl.uniform1i(places[name], value);
      else gl.uniform1f(places[name], value);
    }
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #drawShade(pixels, radius, turning) {
    this.gl.disable(this.gl.DEPTH_TEST);
    if (!turning) {
      const stride = Math.max(1, (radius * pixels) / 2.2),
        reach = Math.max(0.8, 0.7 * radius);
      this.#pass(this.smooth, this.halfway, this.normals, { reach, stride: [stride, 0] });
      this.#pass(this.smooth, this.again, this.smoothed, { reach, stride: [0, stride] });
    }
    this.#pass(this.shade, this.second, this.normals, { pixel: 1 / pixels, rings: turning ? 0 : 2 });
  }

  #drawCopy(width, height) {
    const gl = this.gl,
      { program, places } = this.copy;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.shaded);
    gl.uniform1i(places.shaded, 0);
    gl.uniform2f(places.size, width, height);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Strokes: lines {points, width, colour} and dots {at, width, colour, filled}, painted in their order, lines first.
  #drawStrokes(camera, { lines, dots }, width, height, ratio) {
    const gl = this.gl,
      { program, places } = this.strokes;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.depths);
    gl.uniform1i(places.depths, 1);
    gl.uniform1f(places.bias, Picture.LIFT / (2 * this.deep));
    gl.uniform2f(places.share, this.size[0] / width, this.size[1] / height);
    const clip = (point) => {
      const [x, y, z] = camera.project(point);
      return [(2 * x) / camera.width - 1, 1 - (2 * y) / camera.height, -z / this.deep];
    };
    const corners = lines.flatMap((line) => ribbon(line, clip, width, height, ratio));
    const spots = dots.flatMap((spot) => [
      ...clip(spot.at),
      spot.width * ratio,
      spot.filled ? 1 : 0,
      0,
      ...spot.colour,
    ]);
    gl.bindVertexArray(this.dynamic.vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.dynamic.buffer);
    for (const [numbers, kind, round] of [
      [corners, gl.TRIANGLES, 0],
      [spots, gl.POINTS, 1],
    ]) {
      gl.uniform1f(places.round, round);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.DYNAMIC_DRAW);
      gl.drawArrays(kind, 0, numbers.length / 10);
    }
  }

  // Take more or fewer points from now on, and draw them more or less sharply, as the last picture took more or less
  // time than there is.
  #adapt(took, turning) {
    if (!turning) {
      this.fineness = clamp(this.fineness * clamp(Math.sqrt(Picture.FINE / Math.max(took, 1)), 0.6, 1.1), 0.5, 1);
      return;
    }
    const factor = clamp(Math.sqrt(Picture.FRAME / Math.max(took, 1)), 0.5, 1.25);
    this.budget = clamp(Math.round(this.budget * factor), Math.min(Picture.FEWEST, this.skin.count), this.skin.count);
    this.sharpness = clamp(this.sharpness * factor, 0.25, 1);
  }

  // A few pictures, to see how fast this machine is.
  warm(camera) {
    for (let k = 0; k < 3; k++) {
      this.drawn = null;
      this.draw(camera, { lines: [], dots: [] }, true);
    }
    this.fineness = clamp(1.5 * this.sharpness, 0.5, 1);
  }

  // Wait until everything is drawn.
  finish() {
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
}

// A polyline as triangles, three corners of ten numbers each.
function ribbon({ points, width: wide, colour }, clip, width, height, ratio) {
  const flat = points.map(clip),
    half = (wide * ratio) / 2 + 1,
    out = [];
  const aside = flat.map((_, i) => {
    const a = flat[Math.max(0, i - 1)],
      b = flat[Math.min(flat.length - 1, i + 1)];
    const x = (b[0] - a[0]) * width,
      y = (b[1] - a[1]) * height,
      norm = Math.hypot(x, y) || 1;
    return [(-2 * half * y) / norm / width, (2 * half * x) / norm / height];
  });
  const corner = (i, side) => [
    flat[i][0] + side * aside[i][0],
    flat[i][1] + side * aside[i][1],
    flat[i][2],
    side,
    half,
    0,
    ...colour,
  ];
  for (let i = 0; i + 1 < flat.length; i++) {
    for (const [k, side] of [
      [i, -1],
      [i, 1],
      [i + 1, 1],
      [i, -1],
      [i + 1, 1],
      [i + 1, -1],
    ])
      out.push(...corner(k, side));
  }
  return out;
}
