"use strict";
// A splat renderer in one file: Gaussians in textures, sorted in a worker, drawn as quads from back to front.

const element = (id) => document.getElementById(id);
const scene = JSON.parse(element("manifest").textContent);
const canvas = element("canvas");
const ROW = 1024;
const PAUSE = 4000; // milliseconds between two styles or photographs that are shown in turn

// ---- Unpacking ----------------------------------------------------------------------------------------------------

async function unpack() {
  const packed = Uint8Array.from(atob(element("data").textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const n = scene.count;
  let offset = 0;
  const take = (type, length) => {
    const part = new type(bytes.buffer, offset, length);
    offset += part.byteLength;
    return part;
  };
  const rotations = scene.rotations.map(() => take(Uint32Array, n));
  const positions = take(Uint16Array, 3 * n);
  const scales = take(Uint8Array, 3 * n);
  const opacities = take(Uint8Array, n);
  const shades = scene.styles.map(() => take(Uint8Array, 3 * n));
  const means = spread(positions), geometries = rotations.map((packed) => geometry(means, packed, scales, opacities));
  return { n, rows: Math.ceil(n / ROW), means, geometries, colors: (style) => colored(shades[style]) };
}

function spread(positions) {
  const n = scene.count, means = new Float32Array(3 * n);
  for (let axis = 0; axis < 3; axis++) {
    const low = scene.low[axis], step = (scene.high[axis] - low) / 65535;
    for (let i = 0; i < n; i++) {
      const far = low + step * positions[axis * n + i];
      means[3 * i + axis] = Math.sign(far) * Math.expm1(Math.abs(far));
    }
  }
  return means;
}

function quaternion(packed, out) {
  const largest = packed >>> 30;
  let rest = 1, shift = 20;
  for (let k = 0; k < 4; k++) {
    if (k === largest) continue;
    out[k] = (((packed >>> shift) & 1023) / 1023 - 0.5) * Math.SQRT2;
    rest -= out[k] * out[k];
    shift -= 10;
  }
  out[largest] = Math.sqrt(Math.max(rest, 0));
}

function geometry(means, rotations, scales, opacities) {
  const n = scene.count, q = [1, 0, 0, 0], sigma = [0, 0, 0];
  const texels = new Float32Array(4 * 3 * ROW * Math.ceil(n / ROW));
  for (let i = 0; i < n; i++) {
    quaternion(rotations[i], q);
    const [w, x, y, z] = q;
    for (let k = 0; k < 3; k++) sigma[k] = Math.exp(2 * scene.scales[scales[k * n + i]]);
    const r = [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ];
    const cov = (a, b) => r[a][0] * r[b][0] * sigma[0] + r[a][1] * r[b][1] * sigma[1] + r[a][2] * r[b][2] * sigma[2];
    texels.set([
      means[3 * i], means[3 * i + 1], means[3 * i + 2], opacities[i] / 255,
      cov(0, 0), cov(0, 1), cov(0, 2), cov(1, 1), cov(1, 2), cov(2, 2), 0, 0,
    ], 12 * i);
  }
  return texels;
}

function colored(shades) {
  const n = scene.count, texels = new Uint8Array(4 * ROW * Math.ceil(n / ROW));
  for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) texels[4 * i + k] = shades[k * n + i];
  return texels;
}

// ---- Sorting ------------------------------------------------------------------------------------------------------

function sorter() {
  let means;
  onmessage = ({ data }) => {
    if (data.means) {
      means = data.means;
      return;
    }
    const n = means.length / 3, [a, b, c] = data.forward, depths = new Float32Array(n);
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < n; i++) {
      const depth = a * means[3 * i] + b * means[3 * i + 1] + c * means[3 * i + 2];
      depths[i] = depth;
      if (depth < low) low = depth;
      if (depth > high) high = depth;
    }
    // Far ones first: a counting sort over 2^18 depths.
    const bins = 1 << 18, scale = (bins - 1) / Math.max(high - low, 1e-12);
    const starts = new Uint32Array(bins + 1), keys = new Uint32Array(n), order = new Uint32Array(n);
    for (let i = 0; i < n; i++) { keys[i] = (high - depths[i]) * scale; starts[keys[i] + 1]++; }
    for (let k = 0; k < bins; k++) starts[k + 1] += starts[k];
    for (let i = 0; i < n; i++) order[starts[keys[i]]++] = i;
    postMessage({ order, forward: data.forward }, [order.buffer]);
  };
}

// ---- Drawing ------------------------------------------------------------------------------------------------------

const VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
uniform sampler2D geometry, colors;
uniform mat3 rotation; uniform vec3 translation; uniform vec2 focal, center, size; uniform float blur; uniform bool antialiased;
in vec2 corner; in uint index;
out vec4 color; out vec2 away; flat out vec3 conic;
void main() {
  int i = int(index);
  ivec2 cell = ivec2((i % ${ROW}) * 3, i / ${ROW});
  vec4 first = texelFetch(geometry, cell, 0), second = texelFetch(geometry, cell + ivec2(1, 0), 0);
  vec4 third = texelFetch(geometry, cell + ivec2(2, 0), 0);
  vec3 p = rotation * first.xyz + translation;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z < 1e-4 || first.w < 1.0 / 255.0) return;
  mat3 cov = mat3(second.x, second.y, second.z, second.y, second.w, third.x, second.z, third.x, third.y);
  vec2 tangent = clamp(p.xy / p.z, -0.15 * size / focal - center / focal, 0.15 * size / focal + (size - center) / focal);
  mat3 jacobian = mat3(focal.x / p.z, 0, 0, 0, focal.y / p.z, 0, -focal.x * tangent.x / p.z, -focal.y * tangent.y / p.z, 0);
  mat3 flat_cov = jacobian * rotation * cov * transpose(rotation) * transpose(jacobian);
  float xx = flat_cov[0][0] + blur, xy = flat_cov[0][1], yy = flat_cov[1][1] + blur, det = xx * yy - xy * xy;
  if (det <= 0.0) return;
  if (antialiased) first.w *= sqrt(max(((xx - blur) * (yy - blur) - xy * xy) / det, 0.0));
  if (first.w < 1.0 / 255.0) return;
  conic = vec3(yy, -xy, xx) / det;
  away = corner * sqrt(2.0 * log(255.0 * first.w)) * sqrt(vec2(xx, yy));
  vec2 pixel = focal * p.xy / p.z + center + away;
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  color = vec4(texelFetch(colors, ivec2(i % ${ROW}, i / ${ROW}), 0).rgb, first.w);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec4 color; in vec2 away; flat in vec3 conic; out vec4 shown;
void main() {
  float power = 0.5 * (conic.x * away.x * away.x + conic.z * away.y * away.y) + conic.y * away.x * away.y;
  float alpha = min(0.999, color.a * exp(-power));
  if (alpha < 1.0 / 255.0) discard;
  shown = vec4(color.rgb * alpha, alpha);
}`;

function program(gl) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

class Renderer {
  constructor(gl, { rows, geometries }) {
    this.gl = gl;
    this.rows = rows;
    this.program = program(gl);
    this.geometries = geometries.map((texels) => this.texture(gl.RGBA32F, 3 * ROW, gl.FLOAT, texels));
    this.colors = [];
    gl.useProgram(this.program);
    this.uniform = (name) => gl.getUniformLocation(this.program, name);
    gl.uniform1i(this.uniform("geometry"), 0);
    gl.uniform1i(this.uniform("colors"), 1);
    const corners = gl.createBuffer(), corner = gl.getAttribLocation(this.program, "corner");
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.order = gl.createBuffer();
    this.count = 0;
    const index = gl.getAttribLocation(this.program, "index");
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribIPointer(index, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(index, 1);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  texture(format, width, type, texels) {
    const gl = this.gl, made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, this.rows);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, this.rows, gl.RGBA, type, texels);
    return made;
  }

  paint(style, texels) {
    this.colors[style] = this.texture(this.gl.RGBA8, ROW, this.gl.UNSIGNED_BYTE, texels);
  }

  sorted(order) {
    this.count = order.length;
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.order);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, order, this.gl.DYNAMIC_DRAW);
  }

  draw(camera, left, right, divider, background) {
    const gl = this.gl, { width, height } = canvas;
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const { rotation: r, translation } = camera.pose(), { focal, center, fit } = camera.onto(width, height);
    gl.uniformMatrix3fv(this.uniform("rotation"), true, r.flat());
    gl.uniform3fv(this.uniform("translation"), translation);
    gl.uniform2f(this.uniform("focal"), ...focal);
    gl.uniform2f(this.uniform("center"), ...center);
    gl.uniform2f(this.uniform("size"), width, height);
    // The low-pass filter of a pixel of the photographs, so that no gaps open where the window is larger.
    gl.uniform1i(this.uniform("antialiased"), scene.antialiased);
    gl.uniform1f(this.uniform("blur"), 0.3 * Math.max(1, fit) ** 2);
    const split = Math.round(divider * width);
    gl.enable(gl.SCISSOR_TEST);
    for (const [style, start, wide] of [[left, 0, split], [right, split, width - split]]) {
      if (wide <= 0) continue;
      gl.scissor(start, 0, wide, height);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, this.geometries[scene.styles[style].rotation]);
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, this.colors[style]);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    }
  }
}

// ---- Camera: OpenCV's axes, turning about a point in front of it ---------------------------------------------------

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const unit = (a) => { const l = Math.hypot(...a); return a.map((x) => x / l); };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return plus(plus(v.map((x) => c * x), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

class Camera {
  constructor(means) {
    this.means = means;
    this.down = unit(scene.cameras.reduce((sum, one) => plus(sum, one.axes[1]), [0, 0, 0]));
    this.goTo(scene.opening);
  }

  goTo(view) {
    this.view = (view + scene.cameras.length) % scene.cameras.length;
    const one = scene.cameras[this.view];
    ({ focal: this.focal, center: this.center, size: this.size } = one);
    this.position = [...one.position];
    this.axes = one.axes.map((axis) => [...axis]);
    // The middle depth of what this camera sees is what it turns about.
    const depths = [];
    for (let i = 0; i < this.means.length; i += 3 * Math.ceil(this.means.length / 9000)) {
      const away = plus([this.means[i], this.means[i + 1], this.means[i + 2]], this.position, -1);
      const depth = dot(away, this.axes[2]);
      const aside = Math.max(Math.abs(dot(away, this.axes[0])), Math.abs(dot(away, this.axes[1])));
      if (depth > 0 && aside < 0.3 * depth) depths.push(depth);
    }
    depths.sort((a, b) => a - b);
    this.distance = depths.length ? depths[depths.length >> 1] : 1;
  }

  // The place in numbers of 32 bits: where they were taken and where they are given, the picture is the same.
  get place() { return Float32Array.of(...this.position, ...this.axes[1], ...this.axes[2], this.distance); }
  set place(numbers) {
    const [x, y, z, a, b, c, d, e, f, distance] = numbers, down = [a, b, c], forward = [d, e, f];
    Object.assign(this, { position: [x, y, z], axes: [unit(cross(down, forward)), down, forward], distance });
  }

  pose() {
    return { rotation: this.axes, translation: this.axes.map((axis) => -dot(axis, this.position)) };
  }

  // The photograph fills the window, unless more than two sevenths of a side were cut off: around it little was seen.
  onto(width, height) {
    const [small, large] = [width / this.size[0], height / this.size[1]].sort((a, b) => a - b), fit = Math.min(large, 1.4 * small);
    const center = [width, height].map((side, k) => side / 2 + (this.center[k] - this.size[k] / 2) * fit);
    return { position: this.position, axes: this.axes, focal: this.focal.map((one) => one * fit), center, size: [width, height], fit };
  }

  turn(x, y) {
    const pivot = plus(this.position, this.axes[2], this.distance);
    for (const [axis, angle] of [[this.down, -x], [this.axes[0], y]]) {
      const next = this.axes.map((one) => turned(one, axis, angle));
      if (axis === this.down || Math.abs(dot(next[2], this.down)) < 0.985) this.axes = next;
    }
    this.axes[0] = unit(cross(this.axes[1], this.axes[2]));
    this.axes[1] = unit(cross(this.axes[2], this.axes[0]));
    this.axes[2] = unit(this.axes[2]);
    this.position = plus(pivot, this.axes[2], -this.distance);
  }

  // The angle to turn by at a time in seconds: all around where photographs look at this point from all sides, else between the
  // outermost of them and back.
  orbit() {
    const pivot = plus(this.position, this.axes[2], this.distance), level = (v) => plus(v, this.down, -dot(v, this.down));
    const ahead = level(this.axes[2]), right = cross(this.down, ahead), angles = [0];
    for (const { position, axes } of scene.cameras) {
      const towards = plus(pivot, position, -1), flat = level(towards);
      if (dot(unit(towards), axes[2]) > 0.8) angles.push(Math.atan2(dot(flat, right), dot(flat, ahead)));
    }
    angles.sort((a, b) => a - b);
    const gaps = angles.map((angle, i) => (i ? angle - angles[i - 1] : angle + 2 * Math.PI - angles.at(-1))), gap = Math.max(...gaps);
    if (gap < Math.PI / 3) return (time) => 2 * Math.PI * time / 40;
    // The arc goes from the gap's end to its beginning, past 0, where this camera is.
    const i = gaps.indexOf(gap), first = angles[i] - 2 * Math.PI * (angles[i] > 0), last = angles.at(i - 1) + 2 * Math.PI * (angles.at(i - 1) < 0);
    const low = Math.max(-0.6, Math.min(-0.08, first)), high = Math.min(0.6, Math.max(0.08, last));
    const middle = (low + high) / 2, half = (high - low) / 2, begin = Math.asin(-middle / half);
    return (time) => middle + half * Math.sin(2 * Math.PI * time / 16 + begin);
  }

  move(right, down, forward) {
    const step = this.distance;
    [right, down, forward].forEach((amount, k) => { this.position = plus(this.position, this.axes[k], amount * step); });
  }

  nearer(factor) {
    const pivot = plus(this.position, this.axes[2], this.distance);
    this.distance = Math.max(1e-3, this.distance / factor);
    this.position = plus(pivot, this.axes[2], -this.distance);
  }
}

// ---- What no photograph shows from about there fades, as geometry/confidence.py of anystyle has it ---------------------

class Veil {
  constructor({ n, means, geometries }) {
    const { points, opaque, margin, rows, columns, near, far } = scene.fade, opacity = (i) => geometries[0][12 * i + 3];
    const all = Array.from({ length: n }, (_, i) => i).filter((i) => opacity(i) > opaque), step = Math.ceil(all.length / points);
    this.points = all.filter((_, k) => k % step === 0).map((i) => means.slice(3 * i, 3 * i + 3));
    this.directions = scene.cameras.map((one) => Float32Array.from(this.points.flatMap(
      (point) => (this.place(point, one, margin) ? unit(plus(one.position, point, -1)) : [0, 0, 0]),
    )));
    const places = Array.from({ length: rows * columns }, (_, k) => [Math.floor(k / columns), k % columns]);
    this.weights = places.map(([row, column]) => places.map(([y, x]) => {
      const apart = ((row - y) ** 2 + (column - x) ** 2) / 2;
      return Math.exp(-apart / near ** 2) + 1e-6 * Math.exp(-apart / far ** 2);
    }));
  }

  // Fractions of the picture from the left and from above, and the depth, if it is in there.
  place(point, { position, axes, focal, center, size }, margin = 0) {
    const away = plus(point, position, -1), depth = dot(away, axes[2]);
    const at = [0, 1].map((k) => (focal[k] * dot(away, axes[k]) / depth + center[k]) / size[k]);
    return depth > 0 && at.every((one) => one >= -margin && one < 1 + margin) ? [...at, depth] : null;
  }

  confidence(view) {
    const { rows, columns, behind, spacing, beyond } = scene.fade, seen = [], nearest = Array(rows * columns).fill(Infinity);
    this.points.forEach((point, i) => {
      const place = this.place(point, view);
      if (!place) return;
      const cell = Math.floor(place[1] * rows) * columns + Math.floor(place[0] * columns);
      nearest[cell] = Math.min(nearest[cell], place[2]);
      seen.push([i, cell, place[2]]);
    });
    const count = nearest.map(() => 0), total = nearest.map(() => 0);
    for (const [i, cell, depth] of seen) {
      if (depth > behind * nearest[cell]) continue;
      const [x, y, z] = unit(plus(view.position, this.points[i], -1));
      let cosine = 0;
      for (const one of this.directions) cosine = Math.max(cosine, x * one[3 * i] + y * one[3 * i + 1] + z * one[3 * i + 2]);
      const share = Math.min(Math.max((Math.acos(Math.min(cosine, 1)) - spacing) / beyond, 0), 1);
      count[cell] += 1;
      total[cell] += 1 - share * share * (3 - 2 * share);
    }
    return this.weights.map((row) => {
      let sum = 0, mean = 0;
      row.forEach((weight, k) => { if (count[k]) { sum += weight; mean += weight * total[k] / count[k]; } });
      return sum ? mean / sum : 1;
    });
  }

  draw(view, ground) {
    const { rows, columns } = scene.fade, texels = this.confidence(view).flatMap((one) => [...ground, 1 - one].map((part) => 255 * part));
    element("veil").getContext("2d").putImageData(new ImageData(Uint8ClampedArray.from(texels), columns, rows), 0, 0);
  }
}

// ---- The page ------------------------------------------------------------------------------------------------------

function listen(camera, redraw, stop, actions) {
  const pointers = new Map(), changed = () => { stop(); redraw(); };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const apart = () => { const [a, b] = [...pointers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
    const x = event.clientX - before[0], y = event.clientY - before[1], side = Math.min(innerWidth, innerHeight);
    const gap = pointers.size === 2 ? apart() : 0;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size === 2) {
      camera.nearer(apart() / Math.max(gap, 1));
      camera.move(-x / side / 2, -y / side / 2, 0);
    } else if (event.buttons & 2 || event.shiftKey) camera.move(-x / side, -y / side, 0);
    else camera.turn(3 * x / side, -3 * y / side);
    changed();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.nearer(Math.exp(-event.deltaY * (event.deltaMode ? 0.03 : 0.001)));
    changed();
  }, { passive: false });
  const keys = {
    ArrowLeft: () => camera.turn(-0.06, 0), ArrowRight: () => camera.turn(0.06, 0),
    ArrowUp: () => camera.turn(0, 0.06), ArrowDown: () => camera.turn(0, -0.06),
    "+": () => camera.nearer(1.1), "=": () => camera.nearer(1.1), "-": () => camera.nearer(1 / 1.1),
    w: () => camera.move(0, 0, 0.05), s: () => camera.move(0, 0, -0.05),
    a: () => camera.move(-0.05, 0, 0), d: () => camera.move(0.05, 0, 0),
  };
  addEventListener("keydown", (event) => {
    if (element("caption").open) return;
    const choosing = /^(INPUT|BUTTON)$/.test(event.target.tagName) && /^(Arrow|Enter| )/.test(event.key);
    if (event.ctrlKey || event.metaKey || event.altKey || choosing) return;
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (keys[name]) { keys[name](); changed(); }
    else if (actions[name]) actions[name]();
    else if (/^[1-9]$/.test(name)) actions.style(Number(name) - 1);
    else return;
    event.preventDefault();
  });
}

async function main() {
  element("title").textContent = scene.title;
  for (const note of scene.notes) {
    element("notes").append(Object.assign(document.createElement("p"), { textContent: note }));
  }
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
  if (!gl) throw new Error("This browser shows no WebGL 2, which the scene needs.");
  const packed = await unpack();
  const renderer = new Renderer(gl, packed), camera = new Camera(packed.means), veil = scene.fade && new Veil(packed);
  if (veil) Object.assign(element("veil"), { width: scene.fade.columns, height: scene.fade.rows, hidden: false });
  const worker = new Worker(URL.createObjectURL(new Blob([`(${sorter})()`], { type: "text/javascript" })));
  const state = { style: scene.first, other: 0, compare: false, divider: 0.5, playing: null, cycling: false };
  let wanted = null, sorting = false, waiting = false, settled = [];

  const press = (id, on) => element(id).setAttribute("aria-pressed", on);
  const say = (text) => {
    element("status").replaceChildren(text);
    clearTimeout(say.timer);
    if (text) say.timer = setTimeout(say, text.select ? 30000 : 4000, "");
  };
  const background = () => {
    const [r, g, b] = getComputedStyle(document.documentElement).getPropertyValue("--ground").match(/\w\w/g);
    return [r, g, b].map((two) => parseInt(two, 16) / 255);
  };
  const draw = () => {
    waiting = false;
    const scale = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(innerWidth * scale), Math.round(innerHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const { compare, divider, other, style } = state;
    renderer.draw(camera, compare ? other : style, style, compare ? divider : 0, background());
    if (!element("veil").hidden) veil.draw(camera.onto(width, height), background());
    if (!sorting && !wanted) settled.splice(0).forEach((resolve) => resolve());
  };
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };
  const sort = () => {
    if (sorting || !wanted) return;
    sorting = true;
    worker.postMessage({ forward: wanted });
    wanted = null;
  };
  worker.onmessage = ({ data: { order } }) => {
    sorting = false;
    renderer.sorted(order);
    sort();
    redraw();
  };
  const changed = () => { wanted = camera.axes[2]; sort(); redraw(); };

  const make = (name, options) => Object.assign(document.createElement(name), options);
  const radios = scene.styles.map((style, index) => {
    const label = make("label", { title: style.title }), input = make("input", { type: "radio", name: "style", value: index });
    label.append(input, make("canvas", { width: 2 * 88, height: 2 * 58 }));
    if (style.picture) label.append(make("img", { src: style.picture, alt: "" }));
    label.append(make("span", { textContent: style.title }));
    input.addEventListener("change", () => pick(index));
    element("styles").append(label);
    return input;
  });
  // Small pictures of the styles, as the page opens; they take nothing of the file.
  const thumbnail = (index) => {
    const small = radios[index].parentElement.querySelector("canvas");
    Object.assign(canvas, { width: small.width, height: small.height });
    renderer.draw(camera, index, index, 0, background());
    small.getContext("2d").drawImage(canvas, 0, 0);
    redraw();
  };
  const choose = (index) => {
    if (!radios[index]) return;
    state.style = index;
    radios[index].checked = true;
    radios[index].parentElement.scrollIntoView({ block: "nearest", inline: "nearest" });
    if (parent !== window) parent.postMessage({ style: scene.styles[index].title }, "*");
    redraw();
  };
  const pick = (index) => { cycle(false); choose(index); };
  const compare = (on) => {
    state.compare = on;
    press("compare", on);
    element("divider").hidden = !on;
    redraw();
  };
  const go = (view) => { play(false); camera.goTo(view); changed(); };

  // Moving by itself: the camera, or, where motion is not wanted, from photograph to photograph; and the styles in turn.
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const play = (on) => {
    if (on === Boolean(state.playing)) return;
    const run = state.playing = on ? {} : null;
    press("play", on);
    if (!on) return;
    const angle = camera.orbit();
    let begun, before = 0;
    const move = (now) => {
      if (state.playing !== run) return;
      const next = angle((now - (begun ??= now)) / 1000);
      camera.turn(before - next, 0);
      before = next;
      changed();
      requestAnimationFrame(move);
    };
    const cut = () => {
      if (state.playing !== run) return;
      camera.goTo(camera.view + 1);
      changed();
      setTimeout(cut, PAUSE);
    };
    if (still.matches) cut(); else requestAnimationFrame(move);
  };
  const cycle = (on) => {
    clearInterval(state.turns);
    press("cycle", on);
    const next = () => choose((state.style + 1) % scene.styles.length);
    if (on) { next(); state.turns = setInterval(next, PAUSE); }
    state.cycling = on;
  };
  const full = async () => {
    try {
      await (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
    } catch (error) { say(error.message); }
  };

  // What is shown, as the fragment of an address.
  const fragment = () => {
    play(false);
    camera.place = camera.place;
    changed();
    const place = btoa(String.fromCharCode(...new Uint8Array(camera.place.buffer))).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
    const shown = { style: state.style + 1, view: camera.view + 1, camera: place };
    if (state.compare) shown.compare = `${state.other + 1}_${state.divider}`;
    return `#${new URLSearchParams(shown)}`;
  };
  const restore = () => {
    const shown = new URLSearchParams(location.hash.slice(1)), number = (name) => Number.parseInt(shown.get(name), 10) - 1;
    play(false);
    cycle(false);
    if (scene.cameras[number("view")]) camera.goTo(number("view"));
    const letters = (shown.get("camera") ?? "").replace(/-/g, "+").replace(/_/g, "/");
    if (/^[A-Za-z0-9+/]{54}$/.test(letters)) {
      const place = new Float32Array(Uint8Array.from(atob(letters), (letter) => letter.charCodeAt(0)).buffer);
      if (place.every(Number.isFinite)) camera.place = place;
    }
    const [, other, divider] = /^(\d+)_(0|1|0?\.\d+)$/.exec(shown.get("compare")) ?? [];
    if (scene.styles[other - 1]) Object.assign(state, { other: other - 1, divider: element("divider").value = Number(divider) });
    if (shown.has("style")) compare(Boolean(scene.styles[other - 1]));
    choose(number("style"));
    changed();
  };
  const link = async () => {
    history.replaceState(null, "", fragment());
    const field = make("input", { value: location.href, readOnly: true, ariaLabel: "Link" });
    try {
      await navigator.clipboard.writeText(location.href);
      say("The link is copied");
    } catch { // not allowed, or this browser has none
      say(field);
      field.select();
    }
  };
  const about = () => element("caption").showModal();
  element("compare").disabled = element("cycle").disabled = scene.styles.length < 2;
  element("play").disabled = still.matches && scene.cameras.length < 2;
  element("full").hidden = element("full").disabled = !document.fullscreenEnabled;
  element("play").onclick = () => play(!state.playing);
  element("cycle").onclick = () => cycle(!state.cycling);
  element("full").onclick = full;
  element("link").onclick = link;
  element("compare").onclick = () => compare(!state.compare);
  element("divider").oninput = (event) => { state.divider = Number(event.target.value); redraw(); };
  element("previous").onclick = () => go(camera.view - 1);
  element("next").onclick = () => go(camera.view + 1);
  element("about").onclick = about;
  element("caption").onclick = (event) => { if (event.target === element("caption")) event.target.close(); }; // beside it
  const fade = () => { element("veil").hidden = !veil || !element("veil").hidden; redraw(); };
  const key = (id) => () => element(id).disabled || element(id).click();
  listen(camera, changed, () => play(false), {
    "[": key("previous"), "]": key("next"), r: () => go(scene.opening), c: key("compare"), p: key("play"), t: key("cycle"), f: key("full"),
    l: key("link"), v: fade, "?": about, h: () => document.body.classList.toggle("bare"), style: pick,
  });
  addEventListener("resize", redraw);
  addEventListener("hashchange", restore);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  // For other programs: what the page can be asked, each answered when the picture stands.
  const stands = () => new Promise((resolve) => { settled.push(resolve); changed(); });
  window.anystyle = {
    scene, choose: (index) => { choose(index); return stands(); }, go: (view) => { go(view); return stands(); },
    compare: (on, divider = 0.5) => { state.divider = element("divider").value = divider; compare(on); return stands(); }, camera, stands,
  };
  worker.postMessage({ means: packed.means });
  for (const style of scene.styles.keys()) renderer.paint(style, packed.colors(style));
  await stands();
  for (const style of scene.styles.keys()) thumbnail(style);
  choose(scene.first);
  restore();
  await stands();
  say("");
  document.body.dataset.ready = "true";
}

main().catch((error) => { element("status").textContent = error.message; document.body.dataset.ready = "failed"; throw error; });
