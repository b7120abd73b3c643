"use strict";
// Draws scenes of soft bodies with WebGL. Lengths are those of the first body, z is up. Film and laboratory share it.
const $ = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const words = (text) => new Uint16Array(bytes(text).buffer);

function unpack(part, scale = 1) {  // whole numbers of 16 bits back to numbers, column by column
  const whole = words(part.data), columns = part.low.length, out = new Float32Array(whole.length);
  for (let k = 0; k < whole.length; k++) out[k] = scale * (part.low[k % columns] + part.step[k % columns] * whole[k]);
  return out;
}

// Small vectors and 4 x 4 matrices by columns.
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const normal = (a) => { const size = Math.hypot(...a) || 1; return [a[0] / size, a[1] / size, a[2] / size]; };
const paint = (colour, opacity = 1) => [colour[0] / 255, colour[1] / 255, colour[2] / 255, opacity];
const SUN = normal([0.3, -0.35, 0.89]), EYE = { radius: 0.017, out: -0.004, pupil: 0.0115, pupilOut: 0.0035 };

function along(scale, part) {  // the colour at a part, 0 to 1, of a scale of colours
  const place = Math.max(0, Math.min(1, part || 0)) * (scale.length - 1), low = Math.min(Math.floor(place), scale.length - 2);
  return [0, 1, 2].map((k) => scale[low][k] + (place - low) * (scale[low + 1][k] - scale[low][k]));
}

// Where the picture is seen from: angles, distance and the place that it looks at.
function makeCamera({ yaw, pitch, distance }, target, aspect, shift = [0, 0]) {  // shift: of the target from the middle, left and down
  const cos = Math.cos(pitch), back = [Math.cos(yaw) * cos, Math.sin(yaw) * cos, Math.sin(pitch)];
  const right = normal(cross([0, 0, 1], back)), up = cross(back, right), eye = add(target, back, distance);
  const near = 0.05, far = 120, wide = 1 / (Math.tan(0.4) * Math.max(aspect, 1)), tall = wide * aspect;
  const m = new Float32Array(16), depth = [-(far + near) / (far - near), -2 * far * near / (far - near)];
  for (let c = 0; c < 3; c++) {
    m[4 * c] = wide * right[c] + shift[0] * back[c]; m[4 * c + 1] = tall * up[c] + shift[1] * back[c];
    m[4 * c + 2] = depth[0] * back[c]; m[4 * c + 3] = -back[c];
  }
  const away = -dot(back, eye);
  m[12] = -wide * dot(right, eye) + shift[0] * away; m[13] = -tall * dot(up, eye) + shift[1] * away; m[14] = depth[0] * away + depth[1]; m[15] = -away;
  return { matrix: m, eye, back, right, up, wide, tall, shift };
}

function project(seen, p) {  // place in the picture, -1 to 1, and distance along the line of sight
  const m = seen.matrix, w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
  return [(m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12]) / w, (m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13]) / w, w];
}

function ray(seen, x, y) {  // direction of the line of sight through a place in the picture, one unit deep
  return add(add(seen.back.map((v) => -v), seen.right, (x + seen.shift[0]) / seen.wide), seen.up, (y + seen.shift[1]) / seen.tall);
}

// A surface of a body: points from its landmarks, corners of faces, and the colour of every point.
class Surface {
  constructor(part, landmarks) {
    this.faces = words(part.faces); this.opacity = part.opacity; this.count = part.points; this.landmarks = landmarks;
    this.colour = this.meet(bytes(part.colour)); this.influence = this.meet(bytes(part.influence));
    this.muscles = this.influence.length / this.count;
    this.first = new Uint32Array(this.count + 1);
    const which = [], weight = [], all = part.weights ? unpack(part.weights) : null;
    for (let v = 0; v < this.count; v++) {
      if (!all) { which.push(v); weight.push(1); }
      else for (let k = 0; k < landmarks; k++) if (Math.abs(all[v * landmarks + k]) > 1e-3) { which.push(k); weight.push(all[v * landmarks + k]); }
      this.first[v + 1] = which.length;
    }
    this.which = Uint16Array.from(which); this.weight = Float32Array.from(weight);
    this.index = new Uint32Array(1.5 * this.faces.length);
    for (let q = 0, k = 0; q < this.faces.length; q += 4) {
      const [a, b, c, d] = this.faces.subarray(q, q + 4);
      this.index.set([a, b, c, a, c, d], k); k += 6;
    }
  }

  meet(ofFaces) {  // the mean at every point of the faces that meet there
    const faces = this.faces.length / 4, width = ofFaces.length / faces, sum = new Float32Array(this.count * width), met = new Float32Array(this.count);
    for (let k = 0; k < this.faces.length; k++) {
      met[this.faces[k]] += 1;
      for (let c = 0; c < width; c++) sum[this.faces[k] * width + c] += ofFaces[(k >> 2) * width + c];
    }
    return sum.map((value, k) => value / Math.max(1, met[Math.floor(k / width)]));
  }

  mesh(marks, contraction, tone, look) {  // bent by the landmarks; contracted muscles warm its colour, strains replace it
    const corners = new Float32Array(10 * this.count), palette = look.palette;
    for (let v = 0; v < this.count; v++) {
      let strain = 0;
      for (let j = this.first[v]; j < this.first[v + 1]; j++) {
        for (let c = 0; c < 3; c++) corners[10 * v + c] += this.weight[j] * marks[3 * this.which[j] + c];
        if (tone) strain += this.weight[j] * tone[look.node[this.which[j]]];
      }
      let warm = 0;
      for (let m = 0; m < this.muscles && contraction; m++) warm += this.influence[v * this.muscles + m] * contraction[m] / 255;
      warm = Math.min(1, warm);
      const strained = tone && along(palette.strain, 0.5 + 0.5 * strain);
      for (let c = 0; c < 3; c++) {
        const own = strained ? strained[c] : this.colour[3 * v + c];
        corners[10 * v + 6 + c] = (own + warm * (palette.contracted[c] - own)) / 255;
      }
      corners[10 * v + 9] = this.opacity;
    }
    const f = this.faces;
    for (let q = 0; q < f.length; q += 4) {
      const [a, b, c, d] = [10 * f[q], 10 * f[q + 1], 10 * f[q + 2], 10 * f[q + 3]];
      for (let k = 0; k < 3; k++) {
        const i = (k + 1) % 3, j = (k + 2) % 3;
        const n = (corners[c + i] - corners[a + i]) * (corners[d + j] - corners[b + j]) - (corners[c + j] - corners[a + j]) * (corners[d + i] - corners[b + i]);
        corners[a + 3 + k] += n; corners[b + 3 + k] += n; corners[c + 3 + k] += n; corners[d + 3 + k] += n;
      }
    }
    return { corners, index: this.index };
  }
}

// How a body looks: its surfaces, eyes, springs and muscles, and the nodes that its landmarks lie on.
class Look {
  constructor(data, palette, unit = data.length) {  // unit: the length of the first body, m
    Object.assign(this, { length: data.length, palette, node: words(data.node), springs: words(data.springs), muscles: words(data.muscles) });
    this.height = data.height.map((h) => h / unit);
    this.surfaces = data.surfaces.map((part) => new Surface(part, this.node.length));
    this.eyes = data.eyes ? unpack(data.eyes) : null;
  }

  marks(x) {  // landmarks of nodes
    const out = new Float32Array(3 * this.node.length);
    for (let k = 0; k < this.node.length; k++) {
      for (let c = 0; c < 3; c++) out[3 * k + c] = x[3 * this.node[k] + c];
      out[3 * k + 2] += this.height[k];
    }
    return out;
  }
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

function rod(mesh, from, way, outline, colour, around = 12) {  // turned about its axis: places along and radii
  const axis = normal(way), side = normal(cross(axis, Math.abs(axis[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1])), other = cross(axis, side);
  for (let k = 0; k + 1 < outline.length; k++) {
    const [x0, r0] = outline[k], [x1, r1] = outline[k + 1], rows = [];
    for (let j = 0; j <= around; j++) {
      const a = 2 * Math.PI * j / around, out = add(side.map((v) => v * Math.cos(a)), other, Math.sin(a));
      const n = normal(add(out.map((v) => v * (x1 - x0)), axis, r0 - r1));
      rows.push([mesh.corner(add(add(from, axis, x0), out, r0), n, colour), mesh.corner(add(add(from, axis, x1), out, r1), n, colour)]);
    }
    for (let j = 0; j < around; j++) mesh.quad(rows[j][0], rows[j + 1][0], rows[j + 1][1], rows[j][1]);
  }
}

function arrow(mesh, from, way, colour, thick = 1) {
  const reach = Math.hypot(...way), head = Math.min(0.1 * thick, reach), neck = reach - head;
  if (reach > 1e-4) rod(mesh, from, way, [[0, 0], [0, 0.014 * thick], [neck, 0.014 * thick], [neck, 0.045 * thick], [reach, 0]], colour);
}

function eyes(mesh, look, marks) {
  const count = look.node.length, places = [0, 1].map((e) => {
    const out = [0, 0, 0];
    for (let k = 0; k < count; k++) for (let c = 0; c < 3; c++) out[c] += look.eyes[e * count + k] * marks[3 * k + c];
    return out;
  });
  for (const [place, other] of [places, [places[1], places[0]]]) {
    const out = normal(sub(place, other));
    ball(mesh, add(place, out, EYE.out), EYE.radius, paint(look.palette.eye), 8);
    ball(mesh, add(place, out, EYE.pupilOut), EYE.pupil, paint(look.palette.pupil), 8);
  }
}

function trail(places, colour) {  // the path so far, the last place first: a ribbon that fades
  const mesh = new Mesh();
  let far = 0, previous = null, last = null;
  for (const place of places) {
    const step = last ? Math.hypot(...sub(last, place)) : 1;
    if (step < 0.02) continue;
    if (last) {
      const across = normal(cross([0, 0, 1], sub(last, place))), fade = 0.8 * Math.exp(-far / 1.4);
      const row = [0.016, -0.016].map((s) => mesh.corner(add(last, across, s), [0, 0, 1], paint(colour, fade)));
      if (previous) mesh.quad(previous[0], previous[1], row[1], row[0]);
      previous = row; far += step;
      if (far > 4) break;
    }
    last = place;
  }
  return mesh;
}

function floor(middle, height, colour) {
  const mesh = new Mesh(), [x, y] = middle;
  mesh.quad(...[[-60, -60], [60, -60], [60, 60], [-60, 60]].map(([a, b]) => mesh.corner([x + a, y + b, height], [0, 0, 1], paint(colour))));
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
uniform vec3 eye; uniform vec3 sun; uniform vec3 middle; uniform vec3 sky; uniform vec3 shine; uniform int kind; uniform float time;
out vec4 result;
void main() {
  if (kind == 1) {  // the floor: rippling light and a grid of body lengths that fade into the distance
    vec2 p = place.xy, width = fwidth(p), near = abs(fract(p - 0.5) - 0.5) / max(width, vec2(1e-6));
    float blur = max(width.x, width.y), line = clamp(1.3 - min(near.x, near.y), 0.0, 1.0) * clamp(1.0 - 3.0 * blur, 0.0, 1.0);
    float a = sin(5.1 * p.x + 1.7 * sin(2.3 * p.y + 0.6 * time) + 0.9 * time), b = sin(4.7 * p.y + 1.9 * sin(2.9 * p.x - 0.5 * time) - 0.7 * time);
    float net = pow(1.0 - 0.5 * abs(a + b), 6.0) * clamp(1.0 - 2.0 * blur, 0.0, 1.0);
    float fade = clamp(distance(p, middle.xy) / 14.0, 0.0, 1.0);
    result = vec4(mix(mix(paint.rgb, shine, clamp(0.7 * net + 0.35 * line, 0.0, 1.0)), sky, fade * fade), 1.0);
    return;
  }
  if (kind == 2) { result = vec4(0.0, 0.12, 0.2, 0.24); return; }  // a shadow
  if (kind == 3) { result = paint; return; }                       // a mark without shading
  vec3 toEye = normalize(eye - place), n = normalize(facing);
  if (dot(n, toEye) < 0.0) n = -n;
  float light = 0.68 + 0.17 * n.z + 0.34 * max(dot(n, sun), 0.0), rim = 1.0 - max(dot(n, toEye), 0.0);
  float gleam = 0.22 * pow(max(dot(n, normalize(sun + toEye)), 0.0), 28.0);
  float solid = kind == 4 ? paint.a * mix(0.34, 0.95, rim * rim) : paint.a;  // a bubble is clearest in its middle
  result = vec4(paint.rgb * (light - 0.12 * rim * rim) + gleam, solid);
}`;

// A renderer of a canvas; null without WebGL. `draw(scene, camera)` draws
// { bodies: [{ look, x, contraction, tone, show }], spheres: [[x, y, z, radius]], touchable, arrows: [{ from, way, colour, thick }],
//   balls: [{ at, radius, colour }], path, floor, middle, time, walls: [corners of four] }.
function makeRenderer(canvas, palette) {
  const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, preserveDrawingBuffer: true });
  if (!gl) return null;
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
  const names = ["view", "flatten", "sun", "eye", "middle", "sky", "shine", "kind", "time"];
  const uniform = Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)]));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  [[3, 0], [3, 12], [4, 24]].forEach(([size, offset], k) => {
    gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(k, size, gl.FLOAT, false, 40, offset);
  });
  gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
  gl.uniform3fv(uniform.sun, SUN);
  gl.uniform3fv(uniform.sky, paint(palette.sky).slice(0, 3));
  gl.uniform3fv(uniform.shine, paint(palette.shine).slice(0, 3));
  const draw = (mesh, kind, flatten = -1e4) => {  // kind 0 lit, 1 floor, 2 shadow, 3 mark, 4 bubble
    if (!mesh.index.length) return;
    gl.uniform1i(uniform.kind, kind);
    gl.uniform1f(uniform.flatten, flatten);
    gl.bufferData(gl.ARRAY_BUFFER, mesh.corners instanceof Float32Array ? mesh.corners : new Float32Array(mesh.corners), gl.STREAM_DRAW);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.index instanceof Uint32Array ? mesh.index : new Uint32Array(mesh.index), gl.STREAM_DRAW);
    gl.drawElements(gl.TRIANGLES, mesh.index.length, gl.UNSIGNED_INT, 0);
  };

  function collect(scene) {  // the meshes of a scene: solid, translucent, marks
    const solid = [], clear = [], marks = new Mesh(), stones = new Mesh();
    for (const { look, x, contraction, tone, show = { skin: true } } of scene.bodies) {
      const landmarks = look.marks(x), see = show.springs;
      if (show.skin) for (const surface of look.surfaces) {
        const mesh = surface.mesh(landmarks, contraction, tone, look);
        if (see) for (let k = 9; k < mesh.corners.length; k += 10) mesh.corners[k] = 0.25 * surface.opacity;
        (see || surface.opacity < 1 ? clear : solid).push(mesh);
      }
      if (look.eyes && show.skin && !see) eyes(marks, look, landmarks);
      const at = (places, k) => places.subarray(3 * k, 3 * k + 3);
      const line = (places, a, b, colour, radius) => {
        const way = sub(at(places, b), at(places, a)), size = Math.hypot(...way);
        if (size > 1e-6) rod(marks, at(places, a), way, [[0, radius], [size, radius]], paint(colour), 5);
      };
      if (show.springs || !look.surfaces.length) for (let k = 0; k < look.springs.length; k += 2) {
        const [a, b] = look.springs.subarray(k, k + 2), strain = tone ? 0.5 * (tone[a] + tone[b]) : 0;
        line(x, a, b, along(palette.strain, 0.5 + 0.5 * strain), look.surfaces.length ? 0.004 : 0.02);
      }
      if (show.springs || !show.skin) for (let k = 0; k < look.muscles.length; k += 2)
        line(landmarks, look.muscles[k], look.muscles[k + 1], along([palette.relaxed, palette.contracted], contraction ? contraction[k / 2] : 0), 0.009);
      if (show.nodes || !look.surfaces.length) for (let k = 0; k < x.length / 3; k++) ball(marks, at(x, k), look.surfaces.length ? 0.012 : 0.04, paint(palette.node), 4);
    }
    for (const each of scene.arrows ?? []) arrow(marks, each.from, each.way, paint(each.colour), each.thick);
    for (const each of scene.balls ?? []) ball(marks, each.at, each.radius, paint(each.colour), 8);
    for (const sphere of scene.spheres ?? []) ball(stones, sphere, sphere[3], paint(scene.touchable ? palette.target : palette.obstacle));
    return { solid, clear, marks, stones };
  }

  return {
    draw(scene, seen) {
      const { solid, clear, marks, stones } = collect(scene);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(...paint(palette.sky));
      gl.depthMask(true);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      gl.uniformMatrix4fv(uniform.view, false, seen.matrix);
      gl.uniform3fv(uniform.eye, seen.eye);
      gl.uniform3fv(uniform.middle, scene.middle);
      gl.uniform1f(uniform.time, scene.time);
      gl.enable(gl.DEPTH_TEST);
      draw(floor(scene.middle, scene.floor, palette.floor), 1);
      gl.enable(gl.BLEND);
      gl.enable(gl.STENCIL_TEST);  // every place is in the shadow once
      gl.disable(gl.DEPTH_TEST);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.INCR, gl.INCR);
      if (seen.eye[2] > scene.floor) for (const mesh of [...solid, ...clear, ...(scene.touchable ? [] : [stones])]) draw(mesh, 2, scene.floor);
      gl.disable(gl.STENCIL_TEST);
      gl.enable(gl.DEPTH_TEST);
      gl.depthMask(false);
      draw(trail(scene.path ?? [], palette.path), 3);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
      for (const mesh of solid) draw(mesh, 0);
      draw(marks, 0);
      if (!scene.touchable) draw(stones, 0);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      for (const mesh of clear.reverse()) draw(mesh, 0);  // the inner layer comes last in a look, and is drawn first
      if (scene.touchable) draw(stones, 4);
      for (const wall of scene.walls ?? []) {
        const sheet = new Mesh();
        sheet.quad(...wall.map((p) => sheet.corner(p, [0, 0, 1], paint(palette.wall, 0.16))));
        draw(sheet, 3);
      }
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    },
  };
}

// Turns, zooms, and hands what is left to whoever wants it: `press(x, y)` may take a pointer that goes down.
function steerCamera(canvas, view, limits, press = () => null) {
  const fingers = new Map();
  const place = (e) => { const box = canvas.getBoundingClientRect(); return [2 * (e.clientX - box.left) / box.width - 1, 1 - 2 * (e.clientY - box.top) / box.height]; };
  const turn = (dx, dy) => { view.yaw -= 0.008 * dx; view.pitch = Math.max(limits.lowest, Math.min(1.55, view.pitch + 0.008 * dy)); };
  const zoom = (factor) => { view.distance = Math.max(limits.nearest, Math.min(limits.farthest, view.distance * factor)); };
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  let held = null;
  canvas.addEventListener("pointerdown", (e) => {
    fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    canvas.setPointerCapture(e.pointerId);
    if (fingers.size === 1 && e.button === 0) held = press(...place(e));
    else if (held) { held.end(); held = null; }
  });
  canvas.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) return;
    const apart = fingers.size === 2 ? spread() : 0;
    fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    if (held) held.move(...place(e));
    else if (fingers.size === 1) turn(e.clientX - before.x, e.clientY - before.y);
    else if (apart) zoom(apart / Math.max(1, spread()));
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => {
    fingers.delete(e.pointerId);
    if (held) { held.end(); held = null; }
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(0.0012 * e.deltaY)); }, { passive: false });
  return { turn, zoom, place };
}
