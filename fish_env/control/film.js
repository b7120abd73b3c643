"use strict";
// Draws recorded episodes of a fish. Lengths are body lengths, z is up. A state is one row of every array of a reel.
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const words = (text) => new Uint16Array(bytes(text).buffer);

function unpack(part, scale = 1) {  // whole numbers of 16 bits back to numbers, column by column
  const whole = words(part.data), columns = part.low.length, out = new Float32Array(whole.length);
  for (let k = 0; k < whole.length; k++) out[k] = scale * (part.low[k % columns] + part.step[k % columns] * whole[k]);
  return out;
}

const ORANGE = [0.835, 0.369, 0], BLUE = [0, 0.318, 0.49], TARGET = [0.94, 0.72, 0.12], STONE = [0.42, 0.36, 0.42];
const GROUND = [0.76, 0.86, 0.885], SUN = [0.3, -0.35, 0.89], ARROW = [0.56, 0.8];
const unit = 1 / data.length;
const skin = {
  weights: unpack(data.skin.weights), quads: words(data.skin.quads), colour: bytes(data.skin.colour),
  influence: bytes(data.skin.influence), muscles: data.skin.muscles,
};
const landmarks = data.skin.weights.low.length, points = skin.colour.length / 3;
const reels = data.reels.map((reel) => ({
  ...reel, points: unpack(reel.points, unit), centre: unpack(reel.centre, unit), speed: unpack(reel.speed),
  gained: unpack(reel.gained), contraction: bytes(reel.contraction), command: unpack(reel.command),
  spheres: unpack(reel.spheres).map((value, k) => (k % 4 < 3 ? value * unit : value)),
}));
for (const reel of reels) {  // what the camera follows: the centre, smoothed over half a second
  const half = Math.max(1, Math.round(0.25 / reel.interval));
  reel.follow = reel.centre.map((_, k) => {
    const t = Math.floor(k / 3), first = Math.max(0, t - half), last = Math.min(reel.states - 1, t + half);
    let sum = 0;
    for (let s = first; s <= last; s++) sum += reel.centre[3 * s + (k % 3)];
    return sum / (last - first + 1);
  });
  let lowest = 0;
  for (let k = 2; k < reel.points.length; k += 3) lowest = Math.min(lowest, reel.points[k]);
  reel.ground = lowest - 0.35;
}

// The film as it is shown: also for scripts and tests.
const film = { reel: 0, time: 0, playing: true, rate: 0.5, yaw: 0, pitch: 0.55, distance: 2, drawn: 0 };
window.film = film;

// Small vectors and 4 x 4 matrices by columns.
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const normal = (a) => { const size = Math.hypot(...a) || 1; return [a[0] / size, a[1] / size, a[2] / size]; };

function camera(target, aspect) {
  const cos = Math.cos(film.pitch);
  const back = [Math.cos(film.yaw) * cos, Math.sin(film.yaw) * cos, Math.sin(film.pitch)];
  const eye = add(target, back, film.distance), right = normal(cross([0, 0, 1], back)), up = cross(back, right);
  const near = 0.05, far = 80, wide = 1 / (Math.tan(0.4) * Math.max(aspect, 1));
  const tall = wide * aspect, m = new Float32Array(16);
  const depth = [-(far + near) / (far - near), -2 * far * near / (far - near)];
  for (let c = 0; c < 3; c++) {
    m[4 * c] = wide * right[c]; m[4 * c + 1] = tall * up[c];
    m[4 * c + 2] = depth[0] * back[c]; m[4 * c + 3] = -back[c];
  }
  const away = -dot(back, eye);
  m[12] = -wide * dot(right, eye); m[13] = -tall * dot(up, eye); m[14] = depth[0] * away + depth[1]; m[15] = -away;
  return { matrix: m, eye };
}

// A mesh that is filled anew for every picture: position, normal and colour with opacity, 10 numbers a corner.
class Mesh {
  constructor() { this.corners = []; this.index = []; }
  corner(p, n, c) { this.corners.push(p[0], p[1], p[2], n[0], n[1], n[2], c[0], c[1], c[2], c[3] ?? 1); return this.corners.length / 10 - 1; }
  quad(a, b, c, d) { this.index.push(a, b, c, a, c, d); }
}

function ball(mesh, centre, radius, colour, rings = 20) {
  const start = mesh.corners.length / 10, around = 2 * rings;
  for (let i = 0; i <= rings; i++) for (let j = 0; j <= around; j++) {
    const a = Math.PI * i / rings, b = 2 * Math.PI * j / around;
    const n = [Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)];
    mesh.corner(add(centre, n, radius), n, colour);
  }
  for (let i = 0; i < rings; i++) for (let j = 0; j < around; j++) {
    const k = start + i * (around + 1) + j;
    mesh.quad(k, k + around + 1, k + around + 2, k + 1);
  }
}

function arrow(mesh, from, along, reach, colour) {  // a rod and a cone
  const side = normal(cross(along, Math.abs(along[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1])), other = cross(along, side);
  const neck = reach - 0.1, outline = [[0, 0], [0, 0.014], [neck, 0.014], [neck, 0.045], [reach, 0]], around = 20;
  for (let k = 0; k + 1 < outline.length; k++) {
    const [x0, r0] = outline[k], [x1, r1] = outline[k + 1], rows = [];
    for (let j = 0; j <= around; j++) {
      const a = 2 * Math.PI * j / around, out = add(side.map((v) => v * Math.cos(a)), other, Math.sin(a));
      const n = normal(add(out.map((v) => v * (x1 - x0)), along, r0 - r1));
      rows.push([mesh.corner(add(add(from, along, x0), out, r0), n, colour), mesh.corner(add(add(from, along, x1), out, r1), n, colour)]);
    }
    for (let j = 0; j < around; j++) mesh.quad(rows[j][0], rows[j + 1][0], rows[j + 1][1], rows[j][1]);
  }
}

function mixed(array, width, state, part, first = 0, count = width) {  // between two states
  const out = new Float32Array(count), next = part > 0 ? width : 0, k = state * width + first;
  for (let c = 0; c < count; c++) out[c] = (1 - part) * array[k + c] + part * array[k + c + next];
  return out;
}

function bend(marks) {  // points of the skin, the eyes last, from landmarks
  const count = skin.weights.length / landmarks, out = new Float32Array(3 * count);
  for (let v = 0; v < count; v++) for (let k = 0; k < landmarks; k++) {
    const w = skin.weights[v * landmarks + k];
    if (w) for (let c = 0; c < 3; c++) out[3 * v + c] += w * marks[3 * k + c];
  }
  return out;
}

function body(shape, contraction) {  // the skin, muscles that contract in orange
  const mesh = new Mesh(), normals = new Float32Array(3 * points), at = (v) => [shape[3 * v], shape[3 * v + 1], shape[3 * v + 2]];
  for (let q = 0; q < skin.quads.length; q += 4) {
    const [a, b, c, d] = skin.quads.subarray(q, q + 4), n = cross(sub(at(c), at(a)), sub(at(d), at(b)));
    for (const v of [a, b, c, d]) for (let k = 0; k < 3; k++) normals[3 * v + k] += n[k];
  }
  for (let v = 0; v < points; v++) {
    let warm = 0;
    for (let m = 0; m < skin.muscles; m++) warm += skin.influence[v * skin.muscles + m] * contraction[m] / 65025;
    warm = Math.min(1, warm);
    const own = [0, 1, 2].map((k) => skin.colour[3 * v + k] / 255);
    mesh.corner(at(v), normal(normals.subarray(3 * v, 3 * v + 3)), add(own.map((x) => x * (1 - warm)), ORANGE, warm));
  }
  for (let q = 0; q < skin.quads.length; q += 4) mesh.quad(...skin.quads.subarray(q, q + 4));
  return mesh;
}

function eyes(shape) {
  const mesh = new Mesh(), [left, right] = [0, 1].map((k) => [...shape.subarray(3 * (points + k), 3 * (points + k) + 3)]);
  for (const [place, out] of [[left, normal(sub(left, right))], [right, normal(sub(right, left))]]) {
    ball(mesh, add(place, out, -0.004), 0.017, [0.98, 0.97, 0.9], 10);
    ball(mesh, add(place, out, 0.0035), 0.0115, [0.05, 0.08, 0.1], 10);
  }
  return mesh;
}

function trail(reel, state, here) {  // the path so far, a ribbon that fades
  const mesh = new Mesh();
  const places = [here];
  let far = 0, previous = null;
  for (let t = state; t >= 0 && far < 4; t--) {
    const place = reel.centre.subarray(3 * t, 3 * t + 3), step = Math.hypot(...sub(places[places.length - 1], place));
    if (step > 0.02) { places.push([...place]); far += step; }
  }
  far = 0;
  for (let k = 0; k + 1 < places.length; k++) {
    const along = normal(sub(places[k], places[k + 1])), across = normal(cross([0, 0, 1], along)), fade = 0.8 * Math.exp(-far / 1.4);
    const row = [0.016, -0.016].map((s) => mesh.corner(add(places[k], across, s), [0, 0, 1], [...BLUE, fade]));
    if (previous) mesh.quad(previous[0], previous[1], row[1], row[0]);
    previous = row;
    far += Math.hypot(...sub(places[k], places[k + 1]));
  }
  return mesh;
}

function ground(target, height) {
  const mesh = new Mesh(), [x, y] = target;
  mesh.quad(...[[-60, -60], [60, -60], [60, 60], [-60, 60]].map(([a, b]) => mesh.corner([x + a, y + b, height], [0, 0, 1], GROUND)));
  return mesh;
}

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec4 colour;
uniform mat4 view; uniform float flatten; uniform vec3 sun;
out vec3 place; out vec3 facing; out vec4 paint;
void main() {
  place = position; facing = normal; paint = colour;
  if (flatten > -1e3) place -= sun * (position.z - flatten) / sun.z;
  gl_Position = view * vec4(place, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 place; in vec3 facing; in vec4 paint;
uniform vec3 eye; uniform vec3 sun; uniform vec3 middle; uniform int kind;
out vec4 result;
void main() {
  vec3 sky = vec3(0.87, 0.925, 0.94);
  if (kind == 1) {  // the ground: a grid of body lengths that fades into the distance
    vec2 width = fwidth(place.xy), near = abs(fract(place.xy - 0.5) - 0.5) / max(width, vec2(1e-6));
    float line = clamp(1.3 - min(near.x, near.y), 0.0, 1.0) * clamp(1.0 - 3.0 * max(width.x, width.y), 0.0, 1.0);
    float fade = clamp(distance(place.xy, middle.xy) / 14.0, 0.0, 1.0);
    result = vec4(mix(paint.rgb - 0.13 * line, sky, fade), 1.0);
    return;
  }
  if (kind == 2) { result = vec4(0.05, 0.16, 0.2, 0.24); return; }  // a shadow
  if (kind == 3) { result = paint; return; }                        // a mark without shading
  vec3 toEye = normalize(eye - place), n = normalize(facing);
  if (dot(n, toEye) < 0.0) n = -n;
  float light = 0.52 + 0.22 * n.z + 0.36 * max(dot(n, sun), 0.0), rim = 1.0 - max(dot(n, toEye), 0.0);
  float gleam = 0.22 * pow(max(dot(n, normalize(sun + toEye)), 0.0), 28.0);
  float solid = kind == 4 ? mix(0.34, 0.95, rim * rim) : paint.a;   // a bubble is clearest in its middle
  result = vec4(paint.rgb * (light - 0.12 * rim * rim) + gleam, solid);
}`;

function makeDraw(gl) {  // the function that draws a mesh: kind 0 lit, 1 ground, 2 shadow, 3 mark, 4 bubble
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  ["position", "normal", "colour"].forEach((name, k) => gl.bindAttribLocation(program, k, name));
  gl.linkProgram(program);
  gl.useProgram(program);
  const place = (name) => gl.getUniformLocation(program, name);
  const uniform = Object.fromEntries(["view", "flatten", "sun", "eye", "middle", "kind"].map((name) => [name, place(name)]));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  [[3, 0], [3, 12], [4, 24]].forEach(([size, offset], k) => {
    gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(k, size, gl.FLOAT, false, 40, offset);
  });
  gl.enable(gl.DEPTH_TEST);
  gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
  const draw = (mesh, kind, flatten = -1e4) => {
    gl.uniform1i(uniform.kind, kind);
    gl.uniform1f(uniform.flatten, flatten);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(mesh.corners), gl.STREAM_DRAW);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(mesh.index), gl.STREAM_DRAW);
    gl.drawElements(gl.TRIANGLES, mesh.index.length, gl.UNSIGNED_INT, 0);
  };
  return { draw, uniform };
}
