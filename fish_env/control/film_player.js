// Shows a moment of the film, plays it, and answers mouse, touch and keys.
const canvas = $("view"), gl = canvas.getContext("webgl2", { antialias: true, stencil: true });
const title = data.task.replaceAll("_", " ").replace(/^./, (c) => c.toUpperCase());
const program = gl && makeDraw(gl);

function moment() {  // the state that is shown, and how far it has gone to the next
  const reel = reels[film.reel], at = Math.min(film.time / reel.interval, reel.states - 1);
  const state = Math.min(Math.floor(at), reel.states - 1);
  return { reel, state, part: state + 1 < reel.states ? at - state : 0 };
}

function spheresOf({ reel, state, part }) {  // a target that jumps to another place does not fly there
  return Array.from({ length: reel.sphereCount }, (_, k) => {
    const size = 4 * reel.sphereCount, now = reel.spheres.subarray(size * state + 4 * k, size * state + 4 * k + 4);
    const then = mixed(reel.spheres, size, state, part, 4 * k, 4);
    return Math.hypot(...sub(now, then)) < 0.2 ? then : now;
  }).filter((sphere) => sphere[3] > 0.005);
}

function show() {
  const now = moment(), { reel, state, part } = now, { draw, uniform } = program;
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(ratio * side)));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const middle = mixed(reel.follow, 3, state, part), centre = mixed(reel.centre, 3, state, part);
  const marks = mixed(reel.points, 3 * landmarks, state, part), shape = bend(marks);
  const fish = body(shape, mixed(reel.contraction, skin.muscles, state, part));
  const command = normal(mixed(reel.command, 3, state, part)), seen = camera(middle, width / height);
  const spheres = spheresOf(now), colour = data.touchable ? TARGET : STONE;
  const close = spheres.some((s) => Math.hypot(...sub(s, centre)) - s[3] < ARROW[1]) && data.touchable;
  gl.viewport(0, 0, width, height);
  gl.clearColor(0.87, 0.925, 0.94, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
  gl.uniformMatrix4fv(uniform.view, false, seen.matrix);
  gl.uniform3fv(uniform.eye, seen.eye);
  gl.uniform3fv(uniform.sun, normal(SUN));
  gl.uniform3fv(uniform.middle, middle);
  draw(ground(middle, reel.ground), 1);

  const stones = new Mesh(), marked = new Mesh();
  for (const sphere of spheres) ball(stones, sphere, sphere[3], colour);
  if (dot(command, command) > 0.5 && !close) arrow(marked, add(centre, command, ARROW[0]), command, ARROW[1] - ARROW[0], BLUE);
  gl.enable(gl.STENCIL_TEST);  // every place is in the shadow once
  gl.enable(gl.BLEND);
  gl.disable(gl.DEPTH_TEST);
  gl.stencilFunc(gl.EQUAL, 0, 255);
  gl.stencilOp(gl.KEEP, gl.INCR, gl.INCR);
  for (const mesh of data.touchable ? [fish] : [fish, stones]) draw(mesh, 2, reel.ground);
  gl.disable(gl.STENCIL_TEST);
  gl.enable(gl.DEPTH_TEST);
  gl.depthMask(false);
  draw(trail(reel, state, [...centre]), 3);
  gl.depthMask(true);
  gl.disable(gl.BLEND);
  draw(fish, 0);
  draw(eyes(shape), 0);
  draw(marked, 0);
  if (!data.touchable) draw(stones, 0);
  gl.enable(gl.BLEND);
  if (data.touchable) draw(stones, 4);
  gl.disable(gl.BLEND);
  const number = (array, digits) => mixed(array, 1, state, part)[0].toFixed(digits);
  $("scrub").value = state;
  $("time").textContent = film.time.toFixed(2);
  $("speed").textContent = number(reel.speed, 2);
  $("gained").textContent = number(reel.gained, 2);
  $("note").textContent = reel.note && state + 1 === reel.states ? `the physics failed: ${reel.note}` : "";
  film.drawn += 1;
}

function choose(reel) {  // an episode, from its beginning
  Object.assign(film, { reel, time: 0 });
  $("reel").value = reel;
  $("scrub").max = reels[reel].states - 1;
  $("task").textContent = `${title}, ${reels[reel].title}`;
  look("start");
}

function look(from) {  // turn the camera to where it sees the fish from
  const { reel, state } = moment(), place = (k) => [0, 1, 2].map((c) => reel.points[3 * (state * landmarks + k) + c]);
  const forward = sub(place(data.nose), place(data.tail)), along = Math.atan2(forward[1], forward[0]);
  const views = { start: [along - 2.3, 0.5], above: [along + Math.PI, 1.55], side: [along - Math.PI / 2, 0.05], behind: [along + Math.PI, 0.3] };
  [film.yaw, film.pitch] = views[from];
}

function play(playing) {
  film.playing = playing;
  $("play").textContent = playing ? "Pause" : "Play";
}

let last = 0;
function tick(now) {
  const passed = Math.min(0.1, (now - last) / 1000), end = reels[film.reel].interval * (reels[film.reel].states - 1);
  last = now;
  if (film.playing) {
    film.time += passed * film.rate;
    if (film.time > end) film.time = 0;
  }
  show();
  requestAnimationFrame(tick);
}

const fingers = new Map();
function turn(dx, dy) {
  film.yaw -= 0.008 * dx;
  film.pitch = Math.max(-0.1, Math.min(1.55, film.pitch + 0.008 * dy));
}
const zoom = (factor) => { film.distance = Math.max(0.8, Math.min(15, film.distance * factor)); };
const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
canvas.addEventListener("pointerdown", (e) => { fingers.set(e.pointerId, { x: e.clientX, y: e.clientY }); canvas.setPointerCapture(e.pointerId); });
canvas.addEventListener("pointermove", (e) => {
  const before = fingers.get(e.pointerId);
  if (!before) return;
  const apart = fingers.size === 2 ? spread() : 0;
  fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
  if (fingers.size === 1) turn(e.clientX - before.x, e.clientY - before.y);
  else if (apart) zoom(apart / Math.max(1, spread()));
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => fingers.delete(e.pointerId));
canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(0.0012 * e.deltaY)); }, { passive: false });
$("play").addEventListener("click", () => play(!film.playing));
$("scrub").addEventListener("input", () => { play(false); film.time = $("scrub").value * reels[film.reel].interval; });
$("rate").addEventListener("change", () => { film.rate = Number($("rate").value); });
$("reel").addEventListener("change", () => choose(Number($("reel").value)));
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
window.addEventListener("keydown", (e) => {
  if (["SELECT", "INPUT", "BUTTON"].includes(e.target.tagName)) return;
  const keys = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] };
  if (e.key === " ") play(!film.playing);
  else if (keys[e.key]) turn(...keys[e.key]);
  else if (e.key === "+" || e.key === "-") zoom(e.key === "+" ? 0.9 : 1.1);
  else return;
  e.preventDefault();
});

document.title = `fish_env: ${title}`;
$("keyCommand").hidden = !reels.some((reel) => reel.command.some((value) => Math.abs(value) > 1e-6));
if (reels.some((reel) => reel.sphereCount)) {
  $("keySphere").hidden = false;
  $("keySphere").children[0].style.background = data.touchable ? "#f0b81f" : "#6b5c6b";
  $("keySphere").children[1].textContent = data.touchable ? "target" : "obstacle";
}
reels.forEach((reel, k) => $("reel").add(new Option(reel.title, k)));
$("reel").hidden = reels.length < 2;
choose(0);
if (program) requestAnimationFrame(tick); else $("sorry").hidden = false;
