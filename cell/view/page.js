// Page of a run: the JSON of cell/view/page.py in #page-scene and #page-contents, drawn with three.js. Base frame, metres, seconds.
"use strict";
const data = Object.assign({}, ...["page-scene", "page-contents"].map((id) => JSON.parse(document.getElementById(id).textContent)));
const byId = (id) => document.getElementById(id);
const KINDS = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };

function element(tag, text, parent, className) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  if (parent) parent.append(made);
  return made;
}
function numbers(packed) {
  const text = atob(packed.base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new KINDS[packed.kind](bytes.buffer);
}
function places(packed) {
  const steps = numbers(packed.steps), out = new Float32Array(steps.length);
  for (let i = 0; i < out.length; i++) out[i] = packed.low[i % 3] + steps[i] * packed.step[i % 3];
  return out;
}
function matrix(rows) { return new THREE.Matrix4().set(...rows.flat()); }
function fixed(T) {
  const group = new THREE.Group();
  group.matrixAutoUpdate = false;
  group.matrix.copy(T);
  return group;
}
const rgb = (hex) => { const c = new THREE.Color(hex); return [c.r, c.g, c.b]; };
function ramp(colours, share) {
  const at = Math.min(Math.max(share, 0), 1) * (colours.length - 1), low = Math.min(Math.floor(at), colours.length - 2);
  return colours[low].map((value, k) => value + (at - low) * (colours[low + 1][k] - value));
}

// ---- scene and camera ----------------------------------------------------------------------------------------------
THREE.Object3D.DefaultUp.set(0, 0, 1);
const canvas = byId("scene");
let renderer = null;
try { renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true }); } catch {
  data.problems.unshift("This browser cannot draw in three dimensions (WebGL is missing or disabled); all numbers are on this page.");
}
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(35, 1, 0.01, 60);
const eye = new THREE.PerspectiveCamera(60, 1, 0.002, 20);
const lamp = new THREE.DirectionalLight(0xffffff, 0.55);
scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f98, 0.62), lamp);
const orbit = { target: new THREE.Vector3(...(data.camera.starts_at_part ? data.camera.part : data.camera.target)), distance: data.camera.starts_at_part ? data.camera.part_distance : data.camera.distance, azimuth: data.camera.azimuth, elevation: data.camera.elevation };
let dirty = true;
const redraw = () => { dirty = true; };

// ---- visibility and opacity: one entry per name ---------------------------------------------------------------------
const shown = new Map();
function register(name, object, materials) {
  if (!shown.has(name)) shown.set(name, { objects: [], materials: [], visible: true, opacity: 1 });
  shown.get(name).objects.push(object);
  shown.get(name).materials.push(...materials);
}
function apply(name) {
  const entry = shown.get(name);
  for (const object of entry.objects) object.visible = entry.visible && entry.opacity > 0;
  for (const material of entry.materials) {
    material.opacity = entry.opacity * (material.userData.opacity ?? 1);
    material.transparent = material.opacity < 1;
    material.depthWrite = material.opacity > 0.95;
    material.needsUpdate = true;
  }
  redraw();
}

const links = [new THREE.Group()];
scene.add(links[0]);
data.arm.T_parent_link.forEach((T, k) => {
  const joint = fixed(matrix(T)), link = new THREE.Group();
  links[data.arm.parent[k]].add(joint);
  joint.add(link);
  links.push(link);
});
const axes = data.arm.axis.map((axis) => new THREE.Vector3(...axis));
function pose(q, start = 0) {
  const { driver, ratio, reference } = data.arm;
  axes.forEach((axis, k) =>
    links[k + 1].quaternion.setFromAxisAngle(axis, ratio[k] * q[start + driver[k]] - reference[k]));
  redraw();
}
for (const piece of data.pieces) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places(piece.mesh.vertices), 3));
  geometry.setIndex(new THREE.BufferAttribute(numbers(piece.mesh.faces), 1));
  const material = new THREE.MeshPhongMaterial({ color: new THREE.Color(...piece.rgb), flatShading: true, specular: 0x111111, side: THREE.DoubleSide });
  const group = new THREE.Group();
  group.add(new THREE.Mesh(geometry, material));
  const materials = [material];
  if (piece.name !== "floor" && piece.mesh.faces.base64.length < 40000) {
    const edge = new THREE.LineBasicMaterial({ color: 0x101418, opacity: 0.35, transparent: true });
    edge.userData.opacity = 0.35;
    group.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), edge));
    materials.push(edge);
  }
  if (piece.name === "floor") {
    const grid = new THREE.GridHelper(6, 12, 0x888888, 0xaaaaaa);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(data.camera.target[0], data.camera.target[1], data.floor + 0.001);
    group.add(grid);
    material.transparent = true; material.opacity = material.userData.opacity = 0.25;
    materials.push(grid.material);
  }
  links[piece.link].add(group);
  register(piece.name, group, materials);
}

// ---- surfaces and their colours ------------------------------------------------------------------------------------
const T_base_object = matrix(data.T_base_object);
const onPart = fixed(matrix(data.T_part_link_base));  // objects that turn with the part, in base with a rotary table at 0
links[data.part_link].add(onPart);
const palette = Object.fromEntries(Object.entries(data.palette).map(([name, colours]) => [name, colours.map(rgb)]));
const surfaces = data.surfaces.map((surface) => {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places(surface.mesh.vertices), 3));
  geometry.setIndex(new THREE.BufferAttribute(numbers(surface.mesh.faces), 1));
  geometry.computeVertexNormals();
  const colours = new THREE.BufferAttribute(new Float32Array(geometry.attributes.position.array.length), 3);
  geometry.setAttribute("color", colours);
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
  const group = fixed(T_base_object);
  group.add(new THREE.Mesh(geometry, material));
  onPart.add(group);
  register(surface.name, group, [material]);
  const layers = surface.layers.map((layer) => ({ ...layer, values: numbers(layer.values), colours: layer.named.map((each) => rgb(each[1])) }));
  return { name: surface.name, colours, layers, count: colours.count };
});
const choices = [];
for (const surface of surfaces) {
  for (const layer of surface.layers) {
    choices.push({ surface, layer, title: layer.title });
    if (layer.kind === "views") choices.push({ surface, layer, title: "Measured by the selected view", single: true });
  }
  choices.push({ surface, layer: null, title: `${surface.name[0].toUpperCase()}${surface.name.slice(1)} without colours` });
}
let choice = choices[0], chosen = -1;

function bits(layer, vertex) {
  let count = 0;
  for (let k = 0; k < layer.width; k++) for (let b = layer.values[vertex * layer.width + k]; b; b &= b - 1) count++;
  return count;
}
const seenBy = (layer, vertex, view) => (layer.values[vertex * layer.width + (view >> 3)] >> (view & 7)) & 1;
function colourOf(vertex) {
  const { layer, single } = choice;
  if (!layer) return palette.plain[0];
  if (layer.kind === "views") {
    if (single && chosen >= 0) return seenBy(layer, vertex, chosen) ? palette.seen[3] : palette.measured[0];
    const count = bits(layer, vertex);
    return count ? palette.seen[Math.min(count, palette.seen.length) - 1] : palette.open[0];
  }
  const value = layer.values[vertex];
  if (layer.kind === "named") return layer.colours[value];
  if (value === 65535) return layer.kind === "signed" ? palette.measured[0] : palette.open[0];
  const real = layer.low + value * layer.step;
  return ramp(layer.kind === "signed" ? palette.signed : palette.lengths, (real - layer.limits[0]) / (layer.limits[1] - layer.limits[0]));
}
function paint() {
  if (!choice) return;
  const { surface } = choice;
  for (let i = 0; i < surface.count; i++) surface.colours.array.set(colourOf(i), 3 * i);
  surface.colours.needsUpdate = true;
  for (const other of surfaces) { shown.get(other.name).visible = other === surface; apply(other.name); ticks.get(other.name)?.(); }
  legend();
}
function legend() {
  const box = byId("legend"), { layer, single } = choice;
  box.replaceChildren();
  if (!layer) return;
  const swatch = (colour, text) => {
    const row = element("div", undefined, box, "row");
    element("span", undefined, row, "swatch").style.background = colour;
    element("span", text, row);
  };
  if (layer.kind === "views" && single) {
    swatch(data.palette.seen[3], chosen < 0 ? "select a view" : `measured by view ${data.views[chosen].number}`);
    swatch(data.palette.measured[0], "not measured by it");
  } else if (layer.kind === "views") {
    swatch(data.palette.open[0], "not measured");
    data.palette.seen.forEach((colour, k) => swatch(colour, k + 1 < data.palette.seen.length ? `${k + 1} view${k ? "s" : ""}` : `${k + 1} or more`));
  } else if (layer.kind === "named") {
    for (const [name, colour] of layer.named) swatch(colour, name);
  } else {
    const signed = layer.kind === "signed", bar = element("div", undefined, box, "bar");
    bar.style.background = `linear-gradient(to right, ${data.palette[signed ? "signed" : "lengths"].join(",")})`;
    const ends = element("div", undefined, box, "ends");
    const digits = (value) => Number(value.toPrecision(4)).toString();
    for (const share of [0, 0.5, 1]) element("span", digits(layer.limits[0] + share * (layer.limits[1] - layer.limits[0])), ends);
    const row = element("div", undefined, box, "row");
    layer.limits.forEach((limit, k) => {
      const input = element("input", undefined, row);
      input.type = "number"; input.step = "any"; input.value = digits(limit);
      input.setAttribute("aria-label", k ? "upper limit in mm" : "lower limit in mm");
      input.onchange = () => {
        const value = Number(input.value), limits = [...layer.limits];
        limits[k] = value;
        if (Number.isFinite(value) && limits[0] < limits[1]) layer.limits = limits;
        paint();
      };
    });
    element("span", "mm", row);
    swatch(data.palette[signed ? "measured" : "open"][0], signed ? "closes a hole, not measured" : "not measured");
  }
  if (layer.note) element("div", layer.note, box, "note");
}

// ---- views ---------------------------------------------------------------------------------------------------------
const frustum = data.frustum.map((corner) => new THREE.Vector3(...corner));
function pyramid(T, share) {
  const tip = new THREE.Vector3().applyMatrix4(T), base = frustum.map((c) => c.clone().multiplyScalar(share).applyMatrix4(T));
  return base.flatMap((corner, k) => [tip, corner, corner, base[(k + 1) % 4]]);
}
const poses = data.views.map((view) => matrix(view.T_base_scanner));
const sources = poses.map((T) => new THREE.Vector3().applyMatrix4(T));
const viewLines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true }));
viewLines.geometry.setFromPoints(poses.flatMap((T) => pyramid(T, data.glyph)));
viewLines.geometry.setAttribute("color", new THREE.Float32BufferAttribute(data.views.flatMap((view) => Array(16).fill(rgb(view.colour)).flat()), 3));
const beam = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints([...frustum, ...frustum]), new THREE.LineBasicMaterial({ color: data.palette.chosen[0] }));
beam.visible = false;
const marks = new THREE.Group();
marks.add(viewLines);
function sprite(text, place) {
  const board = document.createElement("canvas");
  board.width = 96; board.height = 48;
  const pen = board.getContext("2d");
  pen.font = "bold 34px system-ui, sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.lineWidth = 8; pen.strokeStyle = "#fff"; pen.strokeText(text, 48, 25);
  pen.fillStyle = "#10243a"; pen.fillText(text, 48, 25);
  const made = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(board), sizeAttenuation: false, depthTest: false }));
  made.position.copy(place); made.scale.set(0.034, 0.017, 1); made.center.set(0.5, -0.2);
  return made;
}
const signs = data.views.map((view, k) => sprite(String(view.number), sources[k]));
const crowded = signs.length > 60;
signs.forEach((sign) => { sign.visible = !crowded; marks.add(sign); });
if (data.views.length) { onPart.add(marks, beam); register("views", marks, []); }
if (data.cloud) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places(data.cloud), 3));
  const material = new THREE.PointsMaterial({ color: data.palette.cloud[0], size: 1.6, sizeAttenuation: false });
  const group = fixed(T_base_object);
  group.add(new THREE.Points(geometry, material));
  onPart.add(group);
  register("points", group, [material]);
  shown.get("points").visible = false;
}
function select(view, go = true) {
  chosen = view;
  byId("numbers").querySelectorAll("button").forEach((button, k) => button.classList.toggle("on", k === view));
  const list = byId("selected");
  list.replaceChildren();
  beam.visible = view >= 0;
  if (crowded) signs.forEach((sign, k) => { sign.visible = k === view; });
  byId("inset").hidden = view < 0;
  byId("commands").replaceChildren();
  if (view >= 0) {
    for (const text of data.views[view].commands) element("code", command(text), byId("commands"));
    for (const [name, value] of data.views[view].rows) { element("dt", name, list); element("dd", value, list); }
    beam.geometry.setFromPoints(pyramid(poses[view], 1));
    if (go && data.motion && data.views[view].time !== null) moment(data.views[view].time, false);
  }
  if (choice?.single) paint();
  redraw();
}

// ---- motion --------------------------------------------------------------------------------------------------------
const motion = data.motion && { t: numbers(data.motion.t), q: numbers(data.motion.q) };
const n = motion && motion.q.length / motion.t.length;
let now = 0, playing = false, last = 0;
function moment(t, free = true) {
  now = Math.min(Math.max(t, 0), motion.t[motion.t.length - 1]);
  let high = motion.t.findIndex((value) => value >= now);
  if (high < 1) high = Math.max(1, Math.min(motion.t.length - 1, high < 0 ? motion.t.length - 1 : 1));
  const share = (now - motion.t[high - 1]) / Math.max(motion.t[high] - motion.t[high - 1], 1e-9), q = [];
  for (let k = 0; k < n; k++) q.push(motion.q[n * high - n + k] + share * (motion.q[n * high + k] - motion.q[n * high - n + k]));
  pose(q);
  byId("time").value = now;
  const at = data.views.findIndex((view) => view.time !== null && Math.abs(view.time - now) < 0.02);
  byId("moment").textContent = `${now.toFixed(2)} s of ${motion.t[motion.t.length - 1].toFixed(2)} s` + (at < 0 ? "" : `, view ${data.views[at].number}`);
  if (free && at >= 0 && at !== chosen && playing) select(at, false);
}
function play(on) {
  if (!motion) return;
  if (on && now >= motion.t[motion.t.length - 1]) moment(0);
  playing = on; last = performance.now();
  byId("play").textContent = on ? "Pause" : "Play";
}

// ---- panel ---------------------------------------------------------------------------------------------------------
const folder = decodeURIComponent(location.pathname).replace(/^\/([A-Za-z]:)/, "$1").split("/").slice(0, -1);
const execution = data.folder_depth === 2 ? folder[folder.length - 1] : "latest";
if (data.folder_depth) folder.splice(-data.folder_depth);
function command(text) {
  const path = location.protocol === "file:" && data.folder_depth !== null ? folder.join("/") : "RUN";
  const quoted = /^[\w@%+=:,./-]+$/.test(path) ? path : `'${path.replace(/'/g, "'\\''")}'`;
  return text.replace("EXECUTION", () => execution).replace("RUN", () => quoted);
}
byId("inset").firstElementChild.textContent = "view of the scanner";
document.querySelector("h1").textContent = data.title;
for (const sentence of data.problems) element("p", sentence, byId("messages"), "problem");
for (const sentence of data.notes) element("p", sentence, byId("messages"), "note");
choices.forEach((each, k) => { element("option", each.title, byId("colour")).value = k; });
byId("of-colour").hidden = !choices.some((each) => each.layer);
byId("colour").onchange = () => { choice = choices[byId("colour").value]; paint(); };
const ticks = new Map();
for (const [name, entry] of shown) {
  const row = element("div", undefined, byId("shown"), "row"), label = element("label", undefined, row), box = element("input", undefined, label);
  box.type = "checkbox"; box.checked = entry.visible; box.dataset.name = name;
  label.append(` ${name}`);
  box.onchange = () => { entry.visible = box.checked; apply(name); };
  ticks.set(name, () => { box.checked = entry.visible; });
  const slider = element("input", undefined, row);
  slider.type = "range"; slider.min = 0; slider.max = 1; slider.step = 0.05; slider.value = 1;
  slider.setAttribute("aria-label", `opacity of ${name}`);
  slider.oninput = () => { entry.opacity = Number(slider.value); apply(name); };
  apply(name);
}
data.views.forEach((view, k) => { element("button", view.number, byId("numbers")).onclick = () => select(k === chosen ? -1 : k); });
byId("of-view").hidden = !data.views.length;
byId("of-curve").hidden = !data.curve;
if (data.curve) byId("curve").src = data.curve;
for (const [name, value] of data.rows) { element("dt", name, byId("report")); element("dd", value, byId("report")); }
byId("of-report").hidden = !data.rows.length;
for (const text of data.next_commands) element("code", command(text), byId("next"));
byId("of-next").hidden = !data.next_commands.length;
if (motion) {
  byId("player").hidden = false;
  byId("time").max = motion.t[motion.t.length - 1];
  byId("time").oninput = () => { play(false); moment(Number(byId("time").value)); };
  byId("play").onclick = () => play(!playing);
}

// ---- camera control -----------------------------------------------------------------------------------------------
let dragged = null, moved = 0;
canvas.onpointerdown = (event) => { dragged = [event.clientX, event.clientY]; moved = 0; canvas.setPointerCapture(event.pointerId); canvas.focus(); };
canvas.onpointermove = (event) => {
  if (!dragged) return;
  const dx = event.clientX - dragged[0], dy = event.clientY - dragged[1];
  dragged = [event.clientX, event.clientY];
  moved += Math.abs(dx) + Math.abs(dy);
  if (event.buttons & 6 || event.shiftKey) {
    const scale = 2 * orbit.distance * Math.tan((camera.fov * Math.PI) / 360) / canvas.clientHeight;
    orbit.target.addScaledVector(new THREE.Vector3().setFromMatrixColumn(camera.matrix, 0), -dx * scale).addScaledVector(new THREE.Vector3().setFromMatrixColumn(camera.matrix, 1), dy * scale);
  } else {
    orbit.azimuth -= dx * 0.006;
    orbit.elevation = Math.min(Math.max(orbit.elevation + dy * 0.006, -1.55), 1.55);
  }
  redraw();
};
canvas.onpointerup = (event) => { if (dragged && moved < 4) pick(event); dragged = null; };
canvas.onwheel = (event) => { event.preventDefault(); orbit.distance = Math.min(Math.max(orbit.distance * Math.exp(event.deltaY * 0.001), 0.02), 30); redraw(); };
canvas.oncontextmenu = (event) => event.preventDefault();
addEventListener("keydown", (event) => { if (event.key === " " && !/INPUT|SELECT|BUTTON/.test(event.target.tagName)) { event.preventDefault(); play(!playing); } });
function onScreen(place) {
  const at = place.clone().project(camera);
  return [(at.x + 1) / 2 * canvas.clientWidth, (1 - at.y) / 2 * canvas.clientHeight, at.z];
}
function pick(event) {
  if (!data.views.length || !shown.get("views").visible) return;
  let best = -1, least = 24;
  poses.forEach((T, k) => {
    const middle = new THREE.Vector3(0, 0, 0.5 * data.glyph * frustum[0].z).applyMatrix4(T);
    for (const place of [sources[k], middle]) {
      const [x, y, depth] = onScreen(place.clone().applyMatrix4(onPart.matrixWorld)), off = Math.hypot(x - event.offsetX, y - event.offsetY);
      if (depth < 1 && off < least) { least = off; best = k; }
    }
  });
  if (best >= 0) select(best);
}
function lookAt(target, distance) { orbit.target.set(...target); orbit.distance = distance; redraw(); }
element("button", "whole cell", byId("of-camera")).onclick = () => lookAt(data.camera.target, data.camera.distance);
element("button", "part", byId("of-camera")).onclick = () => lookAt(data.camera.part, data.camera.part_distance);
function resize() {
  renderer?.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer?.setSize(innerWidth, innerHeight, false);
  const [right, below] = innerWidth > 760 ? [330, 0] : [0, 0.42 * innerHeight + 70];  // of panel and player
  camera.fov = 2 * Math.atan(0.315 * innerHeight / Math.min(innerWidth - right, innerHeight - below)) * 180 / Math.PI;
  camera.aspect = innerWidth / innerHeight;
  camera.setViewOffset(innerWidth, innerHeight, right / 2, below / 2, innerWidth, innerHeight);
  redraw();
}
function draw() {
  if (!renderer) return;
  const { target, distance, azimuth, elevation } = orbit;
  camera.position.set(Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)).multiplyScalar(distance).add(target);
  camera.lookAt(target);
  camera.near = distance / 100; camera.updateProjectionMatrix(); camera.updateMatrixWorld();
  lamp.position.copy(camera.position).add(new THREE.Vector3(0, 0, 0.4 * distance));
  lamp.target.position.copy(target); lamp.target.updateMatrixWorld();
  renderer.setClearColor(getComputedStyle(document.documentElement).getPropertyValue("--back").trim());
  renderer.render(scene, camera);
  if (chosen < 0) return;
  // The scanner looks along +z with +x to the right; a three.js camera looks along -z.
  const T = onPart.matrixWorld.clone().multiply(poses[chosen]), across = frustum[1].x / frustum[1].z, up = frustum[2].y / frustum[2].z;
  const size = Math.min(240, canvas.clientWidth / 4), width = size * Math.min(1, Math.max(across / up, 0.2)), height = size * Math.min(1, up / across);
  const box = byId("inset"), area = canvas.getBoundingClientRect();
  box.style.width = `${width}px`; box.style.height = `${height}px`;
  const place = box.getBoundingClientRect();
  eye.fov = (2 * Math.atan(up) * 180) / Math.PI; eye.aspect = width / height; eye.updateProjectionMatrix();
  eye.matrixAutoUpdate = false;
  eye.matrix.copy(T).multiply(new THREE.Matrix4().makeScale(1, -1, -1));
  eye.updateMatrixWorld(true);
  const hidden = ["robot", "scanner", "views"].flatMap((name) => shown.get(name)?.objects ?? []), were = hidden.map((each) => each.visible);
  hidden.forEach((each) => { each.visible = false; });
  beam.visible = false;
  lamp.position.copy(sources[chosen]).applyMatrix4(onPart.matrixWorld);
  renderer.setScissorTest(true);
  const corner = [place.left - area.left, area.bottom - place.bottom, place.width, place.height];
  renderer.setScissor(...corner); renderer.setViewport(...corner);
  renderer.render(scene, eye);
  renderer.setScissorTest(false);
  renderer.setViewport(0, 0, canvas.clientWidth, canvas.clientHeight);
  hidden.forEach((each, k) => { each.visible = were[k]; });
  beam.visible = true;
}
function frame() {
  requestAnimationFrame(frame);
  const time = performance.now();
  if (playing) {
    moment(now + ((time - last) / 1000) * Number(byId("speed").value));
    if (now >= motion.t[motion.t.length - 1]) play(false);
  }
  last = time;
  if (dirty) { dirty = false; draw(); document.body.dataset.frames = Number(document.body.dataset.frames ?? 0) + 1; }
}
addEventListener("resize", resize);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
pose(data.arm.home);
if (choice) paint();
if (motion) moment(0);
resize();
requestAnimationFrame(frame);

// ---- cell view --watch: a file beside the page holds the stamp of its last version -------------------------------------
if (data.watch_stamp) {
  try { Object.assign(orbit, JSON.parse(sessionStorage.getItem("orbit") ?? "{}", (key, value) => key === "target" ? new THREE.Vector3(value.x, value.y, value.z) : value)); } catch { /* first visit */ }
  globalThis.reloadIfNew = (stamp) => { if (stamp !== data.watch_stamp) { sessionStorage.setItem("orbit", JSON.stringify(orbit)); location.reload(); } };
  setInterval(() => {
    const script = document.createElement("script");
    script.src = `${location.pathname.split("/").pop()}.stamp.js?${Date.now()}`;
    script.onload = script.onerror = () => script.remove();
    document.head.append(script);
  }, 700);
}
