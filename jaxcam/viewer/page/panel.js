// The panel beside the scene: time, pictures, and the ray of the pixel under the pointer.

const data = JSON.parse(document.getElementById("exhibit").textContent);
const panel = document.getElementById("panel");
const cameras = data.views.map((view) => new Camera(view));
const moving = data.moving.map((m) => ({
  node: m.node,
  positions: floats(m.positions),
  rotations: floats(m.rotations),
}));
const ways = data.ways.map((way) => ({ node: way.node, points: floats(way.points) }));
const outcomes = data.outcomes.map((o) => ({ ...o, places: floats(o.places) }));
const colour = (rgb) => `rgb(${rgb.join(",")})`;
const MARK = "#ff00a0";
const LONG = 3;

const state = { t: 0, playing: false, pin: null, hover: null };

function element(tag, parent, properties = {}) {
  const made = Object.assign(document.createElement(tag), properties);
  parent.append(made);
  return made;
}

// ---- What stands in the panel -------------------------------------------------------------------

element("h1", panel, { textContent: data.title });
element("p", panel, { textContent: data.subtitle, className: "subtitle" });
if (data.episodes.length > 1) {
  const select = element("select", panel, { id: "episode", ariaLabel: "Episode" });
  for (const { number, label } of data.episodes)
    element("option", select, { value: number, textContent: `${number}: ${label}` });
  select.value = data.number;
  select.onchange = () => window.location.assign(`/${select.value}`);
}
const clock = element("div", panel, { className: "clock", hidden: data.length < 2 });
const play = element("button", clock, { textContent: "▶", ariaLabel: "Play", type: "button" });
const slider = element("input", clock, {
  type: "range", id: "time", min: 0, max: data.length - 1, step: 1, value: 0, ariaLabel: "Time",
});
const now = element("output", clock, { id: "now" });
const grid = element("div", panel, { className: "pictures" });
const tiles = cameras.map((camera, i) => {
  const figure = element("figure", grid);
  const canvas = element("canvas", figure, { width: camera.width, height: camera.height });
  canvas.dataset.camera = i;
  canvas.style.borderColor = colour(camera.colour);
  element("figcaption", figure, { textContent: camera.name, title: camera.name });
  return canvas;
});
const info = element("div", panel, { id: "ray", role: "status" });
const words = element("p", info);
const far = element("label", info, { textContent: "distance (m) ", hidden: true });
const reach = element("input", far, { type: "range", min: 0.05, max: LONG, step: 0.005 });
const clear = element("button", info, { type: "button", textContent: "clear", hidden: true });
const legend = element("ul", panel, { className: "legend" });
for (const [name, { colour: rgb, count }] of Object.entries(data.groups)) {
  const item = element("li", legend);
  element("span", item, { className: "dot" }).style.background = colour(rgb);
  item.append(`${name}: ${count} camera${count === 1 ? "" : "s"}`);
}
if (outcomes.length) {
  const item = element("li", legend);
  element("span", item, { className: "rate" });
  item.append("sphere: success from 0 to 100 %");
}
const shown = element("div", panel, { className: "shown" });
const kinds = { bodies: data.moving.length, cameras: 1, ways: ways.length, outcomes: outcomes.length };
for (const [kind, count] of Object.entries(kinds)) {
  if (!count) continue;
  const label = element("label", shown);
  const box = element("input", label, { type: "checkbox", checked: true });
  label.append(` ${kind}`);
  box.onchange = () => say([show(`/${kind}`, box.checked)]);
}
const notes = element("ul", panel, { className: "notes" });
for (const note of data.notes) element("li", notes, { textContent: note });

// ---- Pictures -----------------------------------------------------------------------------------

const files = cameras.map((camera) =>
  camera.pictures.map((text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0))),
);
const bitmaps = files.map((all) => all.map(() => null));

async function bitmap(i, n) {
  const blob = new Blob([files[i][n]], { type: "image/jpeg" });
  return (bitmaps[i][n] ??= await createImageBitmap(blob));
}

async function draw(i) {
  const [camera, canvas] = [cameras[i], tiles[i]];
  const n = camera.shown(state.t);
  const picture = n < 0 ? null : (bitmaps[i][n] ?? (await bitmap(i, n)));
  if (n !== camera.shown(state.t)) return; // by now another one is due
  const context = canvas.getContext("2d", { willReadFrequently: true }); // small: kept off the GPU
  context.fillStyle = "#2b2f36";
  context.fillRect(0, 0, camera.width, camera.height);
  if (picture) context.drawImage(picture, 0, 0, camera.width, camera.height);
  const chosen = chosenRay();
  if (!chosen) return;
  const size = camera.width / 160;
  context.lineWidth = 1.2 * size;
  context.strokeStyle = MARK;
  if (chosen.rays.length && chosen.camera !== i) line(context, camera, chosen.rays[0]);
  const at = chosen.camera === i ? chosen.pixel : chosen.point && camera.pixel(chosen.point, state.t);
  canvas.dataset.pixel = at ? at.map((x) => x.toFixed(3)).join(",") : "";
  if (at) cross(context, at, 5 * size);
}

// A ray as another camera sees it: between two of its points the lens may bend it.
function line(context, camera, { origin, direction }) {
  const steps = 60;
  let before = null;
  context.beginPath();
  for (let k = 1; k <= steps; k++) {
    const pixel = camera.pixel(add(origin, direction, (LONG * k) / steps / norm(direction)), state.t);
    if (pixel) (before ? context.lineTo : context.moveTo).apply(context, pixel);
    before = pixel;
  }
  context.stroke();
}
function cross(context, [u, v], r) {
  context.beginPath();
  context.moveTo(u - r, v);
  context.lineTo(u + r, v);
  context.moveTo(u, v - r);
  context.lineTo(u, v + r);
  context.stroke();
}

// ---- The ray that is shown: of the pixel under the pointer, else of the one that was clicked -----

function chosenRay() {
  const pick = state.hover ?? state.pin;
  if (!pick) return null;
  if (!pick.pixel) {
    const seeing = cameras.filter((camera) => camera.pixel(pick.point, state.t));
    return {
      point: pick.point,
      rays: seeing.map((camera) => {
        const origin = camera.centre(state.t);
        return { origin, direction: add(pick.point, origin, -1) };
      }),
    };
  }
  const ray = cameras[pick.camera].ray(...pick.pixel, state.t);
  if (!ray) return { ...pick, rays: [], point: null };
  const depth = pick.reach ? pick.reach / norm(ray.direction) : (pick.depths[state.t] ??= depthOf(ray));
  return { ...pick, rays: [ray], point: add(ray.origin, ray.direction, depth) };
}

// Where a ray ends: at the first body, else where it passes nearest to a grip, else after a metre.
function depthOf({ origin, direction }) {
  const depth = hit(origin, direction);
  if (Number.isFinite(depth)) return depth;
  if (!ways.length) return 1 / norm(direction);
  const grip = block(ways[0].points, 3, state.t);
  return Math.max(0.05, dot(add([...grip], origin, -1), direction) / dot(direction, direction));
}

function pick(camera, u, v) {
  return { camera, pixel: [u, v], depths: {} };
}

const three = (p) => p.map((x) => x.toFixed(3)).join(", ");
function tell() {
  const chosen = chosenRay();
  clear.hidden = far.hidden = !state.pin;
  if (!chosen) {
    words.textContent = "Point at a picture, here or in space: its ray. A click keeps it.";
  } else if (!chosen.pixel) {
    const count = chosen.rays.length;
    words.textContent = `Point (${three(chosen.point)}) m, in ${count} picture${count === 1 ? "" : "s"}.`;
  } else if (!chosen.point) {
    words.textContent = `${cameras[chosen.camera].name}: this pixel has no ray.`;
  } else {
    const [ray] = chosen.rays;
    const length = norm(ray.direction);
    const away = norm(add(chosen.point, ray.origin, -1));
    words.textContent =
      `${cameras[chosen.camera].name}, pixel (${chosen.pixel.map((x) => x.toFixed(1)).join(", ")}): ` +
      `from (${three(ray.origin)}) m towards (${three(ray.direction.map((x) => x / length))}); ` +
      `point (${three(chosen.point)}) m, ${away.toFixed(3)} m away.`;
    if (state.pin) reach.value = away;
  }
  far.hidden ||= !state.pin?.pixel;
}

function update() {
  const { t } = state;
  slider.value = t;
  now.textContent = `${t} of ${data.length - 1} · ${(t / data.rate).toFixed(2)} s`;
  const messages = [];
  for (const { node, positions, rotations } of moving) {
    messages.push(place(node, [...block(positions, 3, t)]), turn(node, [...block(rotations, 4, t)]));
  }
  for (const { node, points } of ways) messages.push(place(node, [...block(points, 3, t)]));
  cameras.forEach((camera, i) => {
    const n = camera.shown(t);
    if (n >= 0 && camera.last !== n)
      messages.push(change(`${camera.node}/picture`, { _data: files[i][(camera.last = n)] }));
  });
  const chosen = chosenRay();
  messages.push(show(data.ray, Boolean(chosen?.rays.length)), show(data.point, Boolean(chosen?.point)));
  if (chosen?.rays.length) {
    const lines = chosen.rays.flatMap(({ origin, direction }) => {
      const length = chosen.pixel ? LONG / norm(direction) : 1;
      return [...origin, ...add(origin, direction, length)];
    });
    messages.push(change(data.ray, { points: new Float32Array(lines) }));
  }
  if (chosen?.point) messages.push(place(data.point, chosen.point));
  say(messages);
  cameras.forEach((_, i) => draw(i));
  tell();
}

// ---- What answers the user ----------------------------------------------------------------------

slider.oninput = () => {
  state.t = Number(slider.value);
  update();
};
play.onclick = () => {
  state.playing = !state.playing;
  play.textContent = state.playing ? "❚❚" : "▶";
  if (state.playing) run(performance.now());
};
function run(before) {
  if (!state.playing) return;
  requestAnimationFrame((time) => {
    const steps = Math.floor(((time - before) / 1000) * data.rate);
    if (steps) {
      state.t = (state.t + steps) % data.length;
      update();
    }
    run(steps ? time : before);
  });
}
clear.onclick = () => {
  state.pin = null;
  update();
};
reach.oninput = () => {
  if (state.pin?.pixel) state.pin.reach = Number(reach.value);
  update();
};
tiles.forEach((canvas, i) => {
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    return pick(i, x * cameras[i].width, y * cameras[i].height);
  };
  canvas.onpointermove = (event) => {
    state.hover = at(event);
    update();
  };
  canvas.onpointerleave = () => {
    state.hover = null;
    update();
  };
  canvas.onclick = (event) => {
    state.pin = at(event);
    state.hover = null;
    update();
  };
});

// What of the scene is under the pointer: a picture, a camera of the sphere, or a point of a body.
function under(event) {
  const { origin, direction } = pointed(event);
  let best = { s: hit(origin, direction) };
  cameras.forEach((camera, i) => {
    const met = camera.met(origin, direction, data.depth, state.t);
    if (met && met.s < best.s) best = { ...met, camera: i };
  });
  for (const { places, labels, numbers } of outcomes) {
    labels.forEach((label, n) => {
      const there = add([...block(places, 3, n)], origin, -1);
      const s = dot(there, direction);
      if (s > 0 && s < best.s && norm(add(there, direction, -s)) < 0.02)
        best = { s, label, number: numbers[n] };
    });
  }
  if (!Number.isFinite(best.s)) return null;
  return { ...best, point: add(origin, direction, best.s) };
}

let pressed = null;
function listen(canvas) {
  canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) return;
    const there = under(event);
    canvas.title = there?.label ?? "";
    const hover = there?.camera === undefined ? null : pick(there.camera, there.u, there.v);
    if (hover || state.hover) {
      state.hover = hover;
      update();
    }
  });
  canvas.addEventListener("pointerleave", () => {
    if (!state.hover) return;
    state.hover = null;
    update();
  });
  canvas.addEventListener("pointerup", (event) => {
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
    const there = under(event);
    if (!there) return;
    state.hover = null;
    if (there.label !== undefined) {
      words.textContent = there.label;
      if (data.episodes.some(({ number }) => number === there.number) && there.number !== data.number)
        window.location.assign(`/${there.number}`);
      return;
    }
    state.pin = there.camera === undefined ? { point: there.point } : pick(there.camera, there.u, there.v);
    update();
  });
}

// For a browser's console, and for tests.
window.jaxcam = { cameras, data, state, add, onScreen };

const nodes = ["/base", data.ray, data.point, ...cameras.map((camera) => camera.node), ...moving.map((m) => m.node)];
function start() {
  if (!ready(nodes)) return requestAnimationFrame(start);
  listen(client().canvas);
  window.addEventListener("resize", update);
  update();
  document.documentElement.dataset.ready = "yes";
}
start();
