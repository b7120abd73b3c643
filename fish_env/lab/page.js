// The laboratory's page: asks for pictures over a websocket, draws them, and sends what is chosen and touched.
const canvas = $("view"), KEPT = 20, MOST = 2000, FILLED = 0.85, view = { yaw: -2.3, pitch: 0.5, distance: 2.6 };
const css = (colour) => `rgb(${colour.join()})`;
const sharp = () => Math.min(window.devicePixelRatio || 1, 2);  // pixels drawn for a pixel of the page
let scene = null, renderer = null, looks = [], controls = [], socket = null, history = [], shown = null, back = 0;
let hover = null, followed = 0, legend = [], middle = [0, 0, 0], fitted = 0, opening = "The laboratory", ratio = sharp(), waiting = false, asked = 0, slow = 0, seen = null;

// The laboratory as it is shown: scripts may set the time between two pictures, take panels away, keep the distance of
// the camera, and hear of pictures.
const lab = window.lab = { drawn: 0, passed: null, bare: false, still: false, heard: null, get scene() { return scene; }, get controls() { return controls; }, get frame() { return shown; }, get camera() { return seen; }, get plots() { return history; }, view };

const send = (message) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
const set = (name, value = null) => {
  if (name !== "pause" || !value) { back = 0; $("scrub").value = 1000; }
  send({ do: "set", name, value });
};

function connect() {
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { asked = performance.now(); send({ do: "frame" }); };
  socket.onclose = ({ reason }) => busy(reason || "The laboratory has been closed. Start it again, and load this page again.");
  socket.onmessage = ({ data }) => {
    if (data instanceof ArrayBuffer) { take(data); return; }
    const message = JSON.parse(data);
    if (message.scene) enter(message.scene);
    if (message.controls) { controls = message.controls; arrange(); }
    if (message.error) warn(message.error);
    if (message.busy) busy(`${opening}: ${message.busy}`);
    if (message.download) save(new Blob([message.download.text], { type: "text/html" }), message.download.name);
  };
}

function busy(text) {
  $("busy").hidden = !text;
  if (text) $("doing").textContent = text;
}

function warn(text) {
  if (document.activeElement?.id.startsWith("control ")) document.activeElement.blur();  // it shows what was refused
  $("toast").textContent = text;
  $("toast").hidden = false;
  clearTimeout(warn.timer);
  warn.timer = setTimeout(() => { $("toast").hidden = true; }, 8000);
}

function enter(about) {  // another scene, or other bodies in it
  const again = scene?.name === about.name && scene.upright === about.upright;
  scene = about;
  renderer ??= makeRenderer(canvas, scene.palette);
  if (!renderer) { $("sorry").hidden = false; return; }
  looks = scene.looks.map((data) => new Look(data, scene.palette, scene.looks[0].length));
  if (!again) {
    Object.assign(view, scene.camera);
    middle = null;
  }
  fitted = 0;
  opening = scene.name;
  history = []; shown = null; back = 0;
  $("scrub").value = 1000;
  $("title").textContent = scene.title;
  $("hint").textContent = scene.hint;
  $("film").hidden = !scene.films;
  $("scenes").replaceChildren(...scene.scenes.map((name) => button(name, () => { opening = name; send({ do: "scene", name }); }, name === scene.name)));
  $("scenes").querySelector("[aria-pressed=true]").scrollIntoView({ block: "nearest", inline: "nearest" });
  legend = scene.plots.find((plot) => plot.lines.length > 1)?.lines ?? [];
  const named = new Set();  // lines of the same name have one colour in all charts, and are named once
  $("plots").replaceChildren(...scene.plots.map((plot) => {
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    const fresh = plot.lines.length > 1 && plot.lines.some((name) => !named.has(name));
    caption.append(plot.title, fresh ? ":" : "");
    if (fresh) plot.lines.forEach((name, j) => {
      const mark = document.createElement(plot === scene.plots[0] && scene.plots.length > 2 ? "div" : "span");
      mark.textContent = ` ${name}`;
      mark.style.color = css(colourOf(plot, j));
      named.add(name);
      caption.append(mark);
    });
    figure.append(caption, document.createElement("canvas"));
    return figure;
  }));
  $("labels").replaceChildren(...scene.labels.map((name, k) => {
    const label = document.createElement("span");
    label.textContent = name;
    label.style.color = css(scene.palette.lines[k]);
    return label;
  }));
}

const colourOf = ({ lines }, j) => scene.palette.lines[legend.includes(lines[j]) ? legend.indexOf(lines[j]) : j];

function button(label, action, pressed) {
  const made = document.createElement("button");
  made.textContent = label;
  if (pressed !== undefined) made.setAttribute("aria-pressed", pressed);
  made.addEventListener("click", action);
  return made;
}

const changed = (control) => control.default !== null && control.value !== control.default;

function widget(control) {
  if (control.kind === "button" || control.kind === "switch") {
    const pressed = control.kind === "switch" ? control.value : undefined;
    const made = button(control.label, () => set(control.name, pressed === undefined ? null : !pressed), pressed);
    made.title = [control.help, control.key && `key ${keyName(control.key)}`].filter(Boolean).join(", ");
    return made;
  }
  const row = document.createElement("div"), label = document.createElement("label"), id = `control ${control.name}`;
  row.className = "row";
  label.textContent = control.label; label.htmlFor = id; label.title = control.help;
  let input;
  if (control.kind === "choice") {
    input = document.createElement("select");
    control.options.forEach((name) => input.add(new Option(name + (name === control.default ? " (default)" : ""), name)));
    input.value = control.value;
    input.addEventListener("change", () => { set(control.name, input.value); input.blur(); });
    row.append(label, input);
  } else {
    input = document.createElement("input");
    const output = document.createElement("output");
    Object.assign(input, { type: "range", min: control.low, max: control.high, step: control.step, value: control.value });
    output.textContent = Number(control.value).toFixed(control.step < 1 ? 2 : 0);
    input.addEventListener("input", () => {
      output.textContent = Number(input.value).toFixed(control.step < 1 ? 2 : 0);
      if (control.name !== "fish" && control.group !== "Objects") set(control.name, Number(input.value));
    });
    input.addEventListener("change", () => set(control.name, Number(input.value)));
    row.append(label, output, input);
  }
  input.id = id;
  row.classList.toggle("moved", changed(control));
  label.addEventListener("dblclick", () => { input.blur(); if (control.default !== null) set(control.name, control.default); });
  return row;
}

function arrange() {  // controls in groups; one that is being used stays as it is
  const box = $("controls"), held = document.activeElement?.id.startsWith("control ") ? document.activeElement : null;
  const open = Object.fromEntries([...box.children].map((group) => [group.dataset.group, group.open]));
  const groups = [...new Set(["Act", ...controls.map((c) => c.group)])].filter((name) => controls.some((c) => c.group === name));
  const old = held?.closest(".row");
  box.replaceChildren(...groups.map((name) => {
    const group = document.createElement("details"), summary = document.createElement("summary"), buttons = document.createElement("div");
    group.dataset.group = summary.textContent = name;
    group.open = open[name] ?? ["Act", "Time", "Fish", "Objects"].includes(name);
    buttons.className = "buttons";
    group.append(summary, buttons);
    const mine = controls.filter((c) => c.group === name);
    for (const control of mine) {
      const made = `control ${control.name}` === held?.id ? old : widget(control);
      (control.kind === "button" || control.kind === "switch" ? buttons : group).append(made);
    }
    if (mine.some(changed)) group.append(button("Back to defaults", () => mine.filter(changed).forEach((c) => set(c.name, c.default))));
    return group;
  }));
  if (held) held.focus();
  $("rescue").replaceChildren(...controls.filter((c) => ["reset", "halve"].includes(c.name)).map(widget));
  const keys = controls.filter((c) => c.key).map((c) => [keyName(c.key), c.label, c.help]);
  $("keylist").replaceChildren(...[...keys, ["↑ ↓", "Turn the view"], ["+ −", "Zoom"], ["F1", "This help"]].map((words) => {
    const row = document.createElement("tr");
    words.forEach((word) => { row.insertCell().textContent = word; });
    return row;
  }));
}

const keyName = (key) => ({ " ": "space", ArrowLeft: "←", ArrowRight: "→" })[key] ?? key.toUpperCase();

// Pictures
function take(buffer) {
  const size = new DataView(buffer).getUint32(0, true), header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let at = 4 + size;
  const numbers = (count) => { const part = new Float32Array(buffer, at, count); at += 4 * count; return part; };
  header.bodies = header.bodies.map(([look, nodes, muscles, tones]) => ({ look, x: numbers(3 * nodes), contraction: muscles ? numbers(muscles) : null, tone: tones ? numbers(tones) : null }));
  if (header.time < (history.at(-1)?.time ?? 0) - 1e-9) history = [];
  if (!history.length || header.time > history.at(-1).time) history.push(header); else history[history.length - 1] = header;
  while (history.length > 2 && (header.time - history[0].time > KEPT || history.length > MOST)) history.shift();
  busy("");
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    try {
      show();
      if (lab.heard && shown) lab.heard();
    } finally {
      slow = 0.9 * slow + 0.1 * Math.min(performance.now() - asked, 150);  // as few pixels as 20 pictures a second need
      if (slow > 60 && ratio > 0.4 && !lab.bare) { ratio *= 0.85; slow = 40; }
      if (slow < 20 && ratio < sharp()) ratio = Math.min(1.02 * ratio, sharp());
      asked = performance.now();
      send({ do: "frame", passed: lab.passed });
    }
  });
}

function show() {
  if (!scene || !renderer || !history.length) return;
  shown = back ? history.find((frame) => frame.time >= history.at(-1).time - back) ?? history[0] : history.at(-1);
  const { bodies } = shown;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(ratio * side)));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  follow(shown.middle);
  const area = freeArea(), camera = () => makeCamera(view, middle, width / height, [-area[0], -area[1]]);
  if (!lab.still && !shown.balls.length) fit(camera(), area);  // not while something is dragged
  seen = camera();
  const failed = shown.failed[1] >= 0 ? bodies[shown.failed[0]]?.x.subarray(3 * shown.failed[1], 3 * shown.failed[1] + 3) : null;
  renderer.draw({
    ...shown, middle,
    bodies: bodies.map((body) => ({ ...body, look: looks[body.look], show: shown.show })),
    balls: [...shown.balls, ...(failed ? [{ at: [...failed], radius: 0.06, colour: [220, 40, 0] }] : [])],
  }, seen);
  [...$("labels").children].forEach((label, k) => {
    const places = points(bodies[k].x).map((p) => project(seen, p)), half = label.offsetWidth / 2 + 2;
    const [left, right] = [Math.min, Math.max].map((end) => end(...places.map((p) => p[0])));
    label.style.left = `${Math.max(half, Math.min(canvas.clientWidth - half, canvas.clientWidth * (left + right + 2) / 4))}px`;
    label.style.top = `${50 * (1 - Math.max(...places.map((p) => p[1])))}%`;
  });
  lab.drawn += 1;
  if (lab.drawn % 6 === 0 || history.length < 3 || shown.failure) write();
  const p = hover && scene.follows ? onWater(...hover) : null;
  if (p) point("hover", p);
  hover = null;
}

const points = (x) => Array.from({ length: x.length / 3 }, (_, n) => x.subarray(3 * n, 3 * n + 3));

function freeArea() {  // what the panels leave free of the picture: its middle, and half its sides, -1 to 1
  const { clientWidth: width, clientHeight: height } = canvas, box = (id) => $(id).getBoundingClientRect();
  const [left, right, top, bottom] = lab.bare ? [0, width, 0, height]
    : width <= 760 ? [0, width, box("plots").bottom, box("panel").top]
    : [box("plots").right, box("panel").left, box("facts").bottom, box("bottom").top];
  return [(left + right) / width - 1, 1 - (top + bottom) / height, ...[(right - left) / width, (bottom - top) / height].map((part) => Math.max(0.1, part))];
}

function fit({ right, up, back, wide, tall }, [, , across, high]) {  // all that is to be seen fills a part of the free area
  const { bodies, spheres, arrows } = shown, all = [...bodies.flatMap(({ x }) => points(x)), ...spheres, ...arrows.map(({ from, way }) => add(from, way))];
  const needed = Math.min(60, all.reduce((most, p) => {
    const way = sub(p, middle), side = Math.max(wide * Math.abs(dot(right, way)) / across, tall * Math.abs(dot(up, way)) / high);
    return Math.max(most, (p[3] ?? 0) + dot(back, way) + side / FILLED);
  }, 0.9));
  // at once in a new scene, then softly, and nearer only if much is free; what the user has zoomed by stays
  const change = !fitted ? needed / view.distance : needed > fitted ? Math.min(1.05, needed / fitted) : needed < 0.6 * fitted ? 0.99 : 1;
  fitted = fitted ? change * fitted : needed;
  view.distance *= change;
}

function follow(there) {  // the camera follows softly, and never by more than a third of a length behind
  const now = performance.now(), part = 1 - Math.exp(-(now - followed) / 250);
  followed = now;
  const way = middle ? sub(there, middle) : null, far = way ? Math.hypot(...way) : 0;
  middle = way && far < 5 ? add(middle, way, Math.max(part, far > 0.35 ? 1 - 0.35 / far : 0)) : there;
}

function write() {  // words and charts
  $("state").textContent = `${shown.time.toFixed(2)} s${shown.paused ? ", paused" : ""}`;
  $("note").textContent = shown.note;
  const strained = shown.bodies.some((body) => body.tone), [low, bar, high] = $("legend").children;
  $("legend").hidden = !strained && !looks.some((look) => look.muscles.length);
  [low.textContent, high.textContent] = strained ? ["30 % shorter", "30 % longer"] : ["relaxed", "contracted"];
  bar.style.background = `linear-gradient(90deg, ${(strained ? scene.palette.strain : [scene.palette.relaxed, scene.palette.contracted]).map(css)})`;
  $("trouble").hidden = !shown.failure;
  $("reason").textContent = shown.failure;
  $("when").textContent = back ? `−${back.toFixed(1)} s` : "now";
  [...$("plots").querySelectorAll("canvas")].forEach((chart, k) => plot(chart, k));
}

function plot(chart, k) {
  const [width, height] = [chart.clientWidth, chart.clientHeight], pen = chart.getContext("2d"), lines = scene.plots[k].lines.length;
  if (!width) return;
  const angle = scene.plots[k].title.includes("degrees");
  chart.width = 2 * width; chart.height = 2 * height;
  pen.scale(2, 2);
  pen.font = "11px system-ui";
  const until = history.at(-1).time, from = Math.max(history[0].time, until - KEPT), rows = history.filter((f) => f.values[k]);
  const every = Math.max(1, Math.floor(rows.length / width)), few = rows.filter((_, i) => i % every === 0);
  let low = Infinity, high = -Infinity;
  for (const { values } of few) for (const value of values[k]) if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); }
  if (low > high) return;
  if (high - low < 1e-9) { low -= 0.5; high += 0.5; }
  const left = 46, x = (t) => left + (width - left - 4) * (t - from) / Math.max(until - from, 0.1), y = (v) => height - 14 - (height - 20) * (v - low) / (high - low);
  pen.strokeStyle = "#b8c8ce"; pen.fillStyle = "#3b5a66";
  for (const value of [low, high]) {
    pen.beginPath(); pen.moveTo(left, y(value)); pen.lineTo(width - 4, y(value)); pen.stroke();
    pen.fillText(value.toFixed(Math.max(0, Math.min(4, 2 - Math.floor(Math.log10(high - low))))).slice(0, 7), 0, y(value) + 4);
  }
  pen.fillText(`${from.toFixed(1)} s`, left, height - 1);
  pen.textAlign = "right"; pen.fillText(`${until.toFixed(1)} s`, width - 4, height - 1); pen.textAlign = "left";
  pen.lineWidth = 1.6;
  for (let j = 0; j < lines; j++) {
    pen.strokeStyle = css(colourOf(scene.plots[k], j));
    pen.beginPath();
    let last = null;
    for (const { time, values: { [k]: row } } of few) if (row[j] !== null && row[j] !== undefined) {
      if (angle && Math.abs(row[j] - last) > 180) pen.moveTo(x(time), y(row[j])); else pen.lineTo(x(time), y(row[j]));  // 180 degrees are -180
      last = row[j];
    }
    pen.stroke();
  }
  if (back) { pen.strokeStyle = "#c43b00"; pen.beginPath(); pen.moveTo(x(shown.time), 0); pen.lineTo(x(shown.time), height - 14); pen.stroke(); }
}

// Pointers
function touched(x, y) {  // the body and the node nearest to a place in the picture, and the node's place
  let best = { body: -1, far: (canvas.clientWidth > 760 ? 26 : 40) / canvas.clientHeight };
  const aspect = canvas.clientWidth / canvas.clientHeight;
  shown.bodies.forEach((body, k) => {
    for (let n = 0; n < body.x.length / 3; n++) {
      const p = [body.x[3 * n], body.x[3 * n + 1], body.x[3 * n + 2]], [px, py, depth] = project(seen, p);
      const far = Math.hypot((px - x) * aspect, py - y) / 2;
      if (depth > 0 && far < best.far) best = { body: k, far, p, depth };
    }
  });
  return best;
}

function onWater(x, y) {  // where a line of sight hits the plane in which the fish swim
  const way = ray(seen, x, y), height = shown.middle[2], reach = (height - seen.eye[2]) / way[2];
  return reach > 0 && reach < 60 ? add(seen.eye, way, reach) : null;
}

const point = (phase, p, body = -1) => send({ do: "point", phase, point: [...p], body });
const { turn, zoom, place } = steerCamera(canvas, view, { lowest: 0.02, nearest: 0.9, farthest: 60 }, (x, y) => {
  if (!shown || back) return null;
  const found = touched(x, y);
  if (scene.follows || found.body < 0) return null;
  point("start", found.p, found.body);
  return { move: (a, b) => point("move", add(seen.eye, ray(seen, a, b), found.depth), found.body), end: () => point("end", found.p, found.body) };
});
let down = [0, 0];
canvas.addEventListener("pointerdown", (e) => { down = [e.clientX, e.clientY]; });
canvas.addEventListener("click", (e) => {  // on the water, unless it ends a drag
  const p = scene?.follows && shown && !back && Math.hypot(e.clientX - down[0], e.clientY - down[1]) < 6 ? onWater(...place(e)) : null;
  if (p) point("start", p);
});
canvas.addEventListener("pointermove", (e) => { if (e.buttons === 0 || e.pointerType === "touch") hover = place(e); });

// Time, keys, what is saved
$("scrub").addEventListener("input", () => {
  const whole = history.length ? Math.min(KEPT, history.at(-1).time - history[0].time) : 0;
  back = $("scrub").value >= 1000 ? 0 : whole * (1 - $("scrub").value / 1000);
  if (back && !controls.find((c) => c.name === "pause").value) set("pause", true);
});
$("fold").addEventListener("click", () => $("panel").classList.toggle("folded"));
$("help").addEventListener("click", () => $("keys").showModal());
$("film").addEventListener("click", () => send({ do: "save" }));

function save(blob, name) {
  const link = document.createElement("a");
  Object.assign(link, { href: URL.createObjectURL(blob), download: name });
  link.click();
}
$("picture").addEventListener("click", () => { show(); canvas.toBlob((blob) => save(blob, "fish_env.png")); });
let recorder = null;
$("record").addEventListener("click", () => {
  if (recorder) { recorder.stop(); return; }
  const pieces = [];
  recorder = new MediaRecorder(canvas.captureStream());
  recorder.ondataavailable = (e) => pieces.push(e.data);
  recorder.onstop = () => { save(new Blob(pieces, { type: "video/webm" }), "fish_env.webm"); recorder = null; $("record").textContent = "Record a video"; };
  recorder.start();
  $("record").textContent = "Stop recording";
});

window.addEventListener("keydown", (e) => {
  if (e.key === "F1") { e.preventDefault(); $("keys").showModal(); return; }
  if (e.ctrlKey || e.metaKey || e.altKey || ["SELECT", "INPUT"].includes(e.target.tagName) || $("keys").open) return;
  const control = controls.find((c) => c.key && c.key.toLowerCase() === e.key.toLowerCase());
  if (control) set(control.name, control.kind === "switch" ? !control.value : null);
  else if (e.key === "ArrowUp" || e.key === "ArrowDown") turn(0, e.key === "ArrowUp" ? 20 : -20);
  else if (e.key === "+" || e.key === "-") zoom(e.key === "+" ? 0.9 : 1.1);
  else return;
  e.preventDefault();
});
setInterval(() => {  // should a picture not have come, ask again
  if (scene && $("busy").hidden && !document.hidden && !waiting && performance.now() - asked > 3000) { asked = performance.now(); send({ do: "frame" }); }
}, 1000);
connect();
