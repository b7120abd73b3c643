// Shows a moment of the film, plays it, and answers mouse, touch and keys. A state is one row of every array of a reel.
const data = JSON.parse($("data").textContent), palette = data.palette, canvas = $("view");
const title = data.task.replaceAll("_", " ").replace(/^./, (c) => c.toUpperCase());
const renderer = makeRenderer(canvas, palette), look = new Look(data.look, palette);
const unit = 1 / look.length, landmarks = look.node.length, muscles = look.muscles.length / 2, ARROW = data.arrow;
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

function mixed(array, width, state, part, first = 0, count = width) {  // between two states
  const out = new Float32Array(count), next = part > 0 ? width : 0, k = state * width + first;
  for (let c = 0; c < count; c++) out[c] = (1 - part) * array[k + c] + part * array[k + c + next];
  return out;
}

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

function sceneOf(now) {
  const { reel, state, part } = now, centre = mixed(reel.centre, 3, state, part), spheres = spheresOf(now), path = [centre];
  for (let t = state; t >= 0 && path.length < 1000; t--) path.push(reel.centre.subarray(3 * t, 3 * t + 3));
  const command = normal(mixed(reel.command, 3, state, part));
  const close = data.touchable && spheres.some((s) => Math.hypot(...sub(s, centre)) - s[3] < ARROW[1]);
  const shown = dot(command, command) > 0.5 && !close;
  return {
    bodies: [{ look, x: mixed(reel.points, 3 * landmarks, state, part), contraction: mixed(reel.contraction, muscles, state, part).map((v) => v / 255) }],
    spheres, touchable: data.touchable, path, floor: reel.ground, middle: mixed(reel.follow, 3, state, part), time: film.time,
    arrows: shown ? [{ from: add(centre, command, ARROW[0]), way: command.map((v) => v * (ARROW[1] - ARROW[0])), colour: palette.command }] : [],
  };
}

function show() {
  const now = moment(), { reel, state, part } = now, scene = sceneOf(now), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(ratio * side)));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  renderer.draw(scene, makeCamera(film, scene.middle, width / height));
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
  watch("start");
}

function watch(from) {  // turn the camera to where it sees the fish from
  const { reel, state } = moment(), place = (k) => [0, 1, 2].map((c) => reel.points[3 * (state * landmarks + k) + c]);
  const forward = sub(place(data.nose), place(data.tail)), heading = Math.atan2(forward[1], forward[0]);
  const views = { start: [heading - 2.3, 0.5], above: [heading + Math.PI, 1.55], side: [heading - Math.PI / 2, 0.05], behind: [heading + Math.PI, 0.3] };
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

const { turn, zoom } = steerCamera(canvas, film, { lowest: -0.1, nearest: 0.8, farthest: 15 });
$("play").addEventListener("click", () => play(!film.playing));
$("scrub").addEventListener("input", () => { play(false); film.time = $("scrub").value * reels[film.reel].interval; });
$("rate").addEventListener("change", () => { film.rate = Number($("rate").value); });
$("reel").addEventListener("change", () => choose(Number($("reel").value)));
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => watch(button.dataset.view));
window.addEventListener("keydown", (e) => {
  if (["SELECT", "INPUT", "BUTTON"].includes(e.target.tagName)) return;
  const keys = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] };
  if (e.key === " ") play(!film.playing);
  else if (keys[e.key]) turn(...keys[e.key]);
  else if (e.key === "+" || e.key === "-") zoom(e.key === "+" ? 0.9 : 1.1);
  else return;
  e.preventDefault();
});

const css = (colour) => `rgb(${colour.join()})`;
document.title = `fish_env: ${title}`;
$("bar").style.background = `linear-gradient(90deg, ${css(palette.relaxed)}, ${css(palette.contracted)})`;
$("keyCommand").hidden = !reels.some((reel) => reel.command.some((value) => Math.abs(value) > 1e-6));
$("keyCommand").children[0].style.background = css(palette.command);
if (reels.some((reel) => reel.sphereCount)) {
  $("keySphere").hidden = false;
  $("keySphere").children[0].style.background = css(data.touchable ? palette.target : palette.obstacle);
  $("keySphere").children[1].textContent = data.touchable ? "target" : "obstacle";
}
reels.forEach((reel, k) => $("reel").add(new Option(reel.title, k)));
$("reel").hidden = reels.length < 2;
choose(0);
if (renderer) requestAnimationFrame(tick); else $("sorry").hidden = false;
