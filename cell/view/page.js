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
try {
  renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.localClippingEnabled = true;
} catch {
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
    material.opacity = entry.opacity * (entry.fade ?? 1) * (material.userData.opacity ?? 1);
    if (material.uniforms) material.uniforms.opacity.value = material.opacity;
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
const { ramps: namedRamps, ...flat } = data.palette;
const coloursOf = (table) => Object.fromEntries(Object.entries(table).map(([name, colours]) => [name, colours.map(rgb)]));
const palette = { ...coloursOf(flat), ramps: { length: coloursOf(namedRamps.length), signed: coloursOf(namedRamps.signed) } };
const SHADER = {
  // The colour of the legend, at most a fifth darker where the surface turns away.
  vertexShader: `#include <clipping_planes_pars_vertex>
    attribute vec3 colour; varying vec3 vColour; varying vec3 vNormal;
    void main() {
      #include <begin_vertex>
      vec4 mvPosition = modelViewMatrix * vec4(transformed, 1.0);
      vColour = colour; vNormal = normalize(normalMatrix * normal);
      gl_Position = projectionMatrix * mvPosition;
      #include <clipping_planes_vertex>
    }`,
  fragmentShader: `#include <clipping_planes_pars_fragment>
    uniform float opacity; varying vec3 vColour; varying vec3 vNormal;
    void main() {
      #include <clipping_planes_fragment>
      gl_FragColor = vec4(vColour * (0.8 + 0.2 * abs(normalize(vNormal).z)), opacity);
    }`,
};
function facetted(geometry) {
  // Three corners per face; smooth normals except across edges of more than 35 deg.
  geometry.computeVertexNormals();
  const made = geometry.toNonIndexed(), place = made.attributes.position.array, normal = made.attributes.normal.array;
  const a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3();
  for (let i = 0; i < place.length; i += 9) {
    a.fromArray(place, i); b.fromArray(place, i + 3).sub(a); c.fromArray(place, i + 6).sub(a);
    b.cross(c).normalize();
    for (let k = i; k < i + 9; k += 3) {
      if (normal[k] * b.x + normal[k + 1] * b.y + normal[k + 2] * b.z < 0.82) { normal[k] = b.x; normal[k + 1] = b.y; normal[k + 2] = b.z; }
    }
  }
  return made;
}
const surfaces = data.surfaces.map((surface) => {
  const indexed = new THREE.BufferGeometry(), corners = numbers(surface.mesh.faces);
  indexed.setAttribute("position", new THREE.BufferAttribute(places(surface.mesh.vertices), 3));
  indexed.setIndex(new THREE.BufferAttribute(corners, 1));
  const geometry = facetted(indexed);
  const colours = new THREE.BufferAttribute(new Float32Array(3 * corners.length), 3);
  geometry.setAttribute("colour", colours);
  const material = new THREE.ShaderMaterial({ ...SHADER, uniforms: { opacity: { value: 1 } }, side: THREE.DoubleSide, clipping: true });
  const group = fixed(T_base_object), mesh = new THREE.Mesh(geometry, material);
  group.add(mesh);
  onPart.add(group);
  register(surface.name, group, [material]);
  const layers = surface.layers.map((layer) => ({ ...layer, given: layer.limits, values: numbers(layer.values), colours: layer.named.map((each) => rgb(each[1])) }));
  return { name: surface.name, colours, layers, corners, geometry, mesh, material };
});
const choices = [];
for (const surface of surfaces) {
  for (const layer of surface.layers) {
    choices.push({ surface, layer, title: layer.title });
    if (layer.kind === "views") choices.push({ surface, layer, title: "Measured by the selected view", single: true });
  }
  choices.push({ surface, layer: null, title: `${surface.name[0].toUpperCase()}${surface.name.slice(1)} without colours` });
}
let choice = choices.find((each) => each.title === data.opens_on) ?? choices[0], chosen = -1;
let bands = 0, tolerance = 0;  // number of colour steps, 0: smooth; half of the green band in mm, 0: none
const ramps = { length: Object.keys(palette.ramps.length)[0], signed: Object.keys(palette.ramps.signed)[0] };

function bits(layer, vertex) {
  let count = 0;
  for (let k = 0; k < layer.width; k++) for (let b = layer.values[vertex * layer.width + k]; b; b &= b - 1) count++;
  return count;
}
const seenBy = (layer, vertex, view) => (layer.values[vertex * layer.width + (view >> 3)] >> (view & 7)) & 1;
const isField = (layer) => layer && (layer.kind === "length" || layer.kind === "signed");
/** Value of a field [mm], or NaN. */
const fieldValue = (layer, vertex) => layer.values[vertex] === 65535 ? NaN : layer.low + layer.values[vertex] * layer.step;
function fieldColour(layer, value) {
  if (Number.isNaN(value)) return layer.kind === "signed" ? palette.measured[0] : palette.open[0];
  if (layer.kind === "signed" && tolerance && Math.abs(value) <= tolerance) return palette.cloud[0];
  let share = (value - layer.limits[0]) / (layer.limits[1] - layer.limits[0]);
  if (bands) share = (Math.min(Math.floor(Math.min(Math.max(share, 0), 1) * bands), bands - 1) + 0.5) / bands;
  return ramp(palette.ramps[layer.kind][ramps[layer.kind]], share);
}
/** Category of a vertex: number of views, whether the selected view measures it, or a named class. */
function category(vertex) {
  const { layer, single } = choice;
  if (layer.kind === "named") return layer.values[vertex];
  return single && chosen >= 0 ? seenBy(layer, vertex, chosen) : bits(layer, vertex);
}
function categoryColour(value) {
  const { layer, single } = choice;
  if (layer.kind === "named") return layer.colours[value];
  if (single && chosen >= 0) return value ? palette.seen[3] : palette.measured[0];
  return value ? palette.seen[Math.min(value, palette.seen.length) - 1] : palette.open[0];
}
function paint() {
  if (!choice) return;
  const { surface, layer } = choice, { corners, colours } = surface, array = colours.array;
  for (let i = 0; i < corners.length; i += 3) {
    if (isField(layer)) {
      for (let k = i; k < i + 3; k++) array.set(fieldColour(layer, fieldValue(layer, corners[k])), 3 * k);
      continue;
    }
    let colour = palette.plain[0];
    if (layer) {  // one colour per face: the category of two corners, or the middle one
      const [a, b, c] = [category(corners[i]), category(corners[i + 1]), category(corners[i + 2])];
      colour = categoryColour(a === b || a === c ? a : b === c ? b : Math.max(Math.min(a, b), Math.min(Math.max(a, b), c)));
    }
    for (let k = i; k < i + 3; k++) array.set(colour, 3 * k);
  }
  colours.needsUpdate = true;
  for (const other of surfaces) { shown.get(other.name).visible = other === surface; apply(other.name); ticks.get(other.name)?.(); }
  legend();
}
/** Shares of the area of a field in equal classes between its limits; values beyond count in the outer classes. */
function areasOfField(surface, layer, classes) {
  const counts = new Float64Array(classes), place = surface.geometry.attributes.position.array;
  const a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3();
  for (let i = 0; i < surface.corners.length; i += 3) {
    a.fromArray(place, 3 * i); b.fromArray(place, 3 * i + 3).sub(a); c.fromArray(place, 3 * i + 6).sub(a);
    const value = (fieldValue(layer, surface.corners[i]) + fieldValue(layer, surface.corners[i + 1]) + fieldValue(layer, surface.corners[i + 2])) / 3;
    if (Number.isNaN(value)) continue;
    const share = (value - layer.limits[0]) / (layer.limits[1] - layer.limits[0]);
    counts[Math.min(Math.max(Math.floor(share * classes), 0), classes - 1)] += b.cross(c).length();
  }
  return counts;
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
    const signed = layer.kind === "signed", digits = (value) => Number(value.toPrecision(4)).toString();
    const [low, high] = layer.limits, css = (colour) => `rgb(${colour.map((part) => Math.round(255 * part)).join(",")})`;
    const histogram = element("canvas", undefined, box, "histogram"), pen = histogram.getContext("2d");
    histogram.width = 280; histogram.height = 60;
    histogram.setAttribute("aria-label", "Area over the value");
    const counts = areasOfField(choice.surface, layer, 70), most = Math.max(...counts, 1e-30);
    pen.fillStyle = "#8884"; pen.fillRect(0, 0, 280, 60);
    counts.forEach((count, k) => {
      pen.fillStyle = css(fieldColour(layer, low + (k + 0.5) / 70 * (high - low)));
      pen.fillRect(4 * k, 60 - 58 * count / most, 4, 58 * count / most);
    });
    const bar = element("div", undefined, box, "bar"), stops = [];
    for (let k = 0; k < 140; k++) stops.push(`${css(fieldColour(layer, low + (k + 0.5) / 140 * (high - low)))} ${k / 1.4}% ${(k + 1) / 1.4}%`);
    bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const ends = element("div", undefined, box, "ends");
    for (const share of [0, 0.5, 1]) element("span", digits(low + share * (high - low)), ends);
    const number = (parent, value, label, change) => {
      const input = element("input", undefined, parent);
      input.type = "number"; input.step = "any"; input.value = value;
      input.setAttribute("aria-label", label); input.title = label;
      input.onchange = () => { change(Number(input.value)); paint(); };
    };
    let row = element("div", undefined, box, "row");
    layer.limits.forEach((limit, k) => number(row, digits(limit), k ? "upper limit in mm" : "lower limit in mm", (value) => {
      const limits = [...layer.limits];
      limits[k] = value;
      if (Number.isFinite(value) && limits[0] < limits[1]) layer.limits = limits;
    }));
    element("span", "mm", row);
    element("button", "reset", row).onclick = () => { layer.limits = layer.given; paint(); };
    row = element("div", undefined, box, "row");
    const select = element("select", undefined, row);
    select.setAttribute("aria-label", "palette");
    for (const name of Object.keys(palette.ramps[layer.kind])) element("option", name, select).selected = name === ramps[layer.kind];
    select.onchange = () => { ramps[layer.kind] = select.value; paint(); };
    number(row, bands, "colour steps, 0: smooth", (value) => { bands = Math.min(Math.max(Math.round(value) || 0, 0), 40); });
    element("span", "steps", row);
    if (signed) {
      row = element("div", undefined, box, "row");
      element("span", "\u00b1", row);
      number(row, tolerance, "half of the tolerance in mm, 0: none", (value) => { tolerance = Math.max(value || 0, 0); });
      element("span", "mm tolerance, green inside", row);
    }
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
/** Show the numbers of views that do not overlap; the selected view's first. */
function placeSigns() {
  if (!data.views.length || !shown.get("views").visible) return;
  const height = 0.017 * canvas.clientHeight / (2 * Math.tan((camera.fov * Math.PI) / 360)) * camera.projectionMatrix.elements[5] * Math.tan((camera.fov * Math.PI) / 360);
  const taken = [], order = [...signs.keys()].sort((a, b) => (b === chosen) - (a === chosen) || a - b);
  for (const k of order) {
    const [x, y, depth] = onScreen(sources[k].clone().applyMatrix4(onPart.matrixWorld));
    const free = depth < 1 && taken.every(([u, v]) => Math.abs(u - x) > 1.5 * height || Math.abs(v - y) > height);
    signs[k].visible = k === chosen || (free && !crowded);
    if (signs[k].visible) taken.push([x, y]);
  }
}
function select(view, go = true) {
  chosen = view;
  byId("numbers").querySelectorAll("button").forEach((button, k) => button.classList.toggle("on", k === view));
  const list = byId("selected");
  list.replaceChildren();
  beam.visible = view >= 0;
  byId("inset").hidden = view < 0;
  byId("commands").replaceChildren();
  if (view >= 0) {
    for (const text of data.views[view].commands) element("code", command(text), byId("commands"));
    for (const [name, value] of data.views[view].rows) { element("dt", name, list); element("dd", value, list); }
    beam.geometry.setFromPoints(pyramid(poses[view], 1));
    if (go && data.motion && data.views[view].time !== null) { play(false); moment(data.views[view].time, false); }
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
  showAxes(q);
  const at = data.views.findIndex((view) => view.time !== null && Math.abs(view.time - now) < 0.02);
  byId("moment").textContent = `${now.toFixed(2)} s of ${motion.t[motion.t.length - 1].toFixed(2)} s` + (at < 0 ? "" : `, view ${data.views[at].number}`);
  if (free && at >= 0 && at !== chosen && playing) select(at, false);
}
const axisRows = [];
const T_link_scanner = matrix(data.arm.T_link_scanner);
/** Pose of the scanner in base with the arm as drawn. */
const scannerPose = () => { links[6].updateWorldMatrix(true, false); return links[6].matrixWorld.clone().multiply(T_link_scanner); };
function showAxes(q) {
  if (!axisRows.length) {
    q.forEach((_, k) => {
      const row = element("div", undefined, byId("axes"), "axis"), [low, high] = data.arm.limits[k];
      element("span", k < 6 ? `A${k + 1}` : `E${k - 5}`, row);
      const rail = element("div", undefined, row, "rail"), mark = element("i", undefined, rail);
      rail.title = `${(low * 180 / Math.PI).toFixed(1)} to ${(high * 180 / Math.PI).toFixed(1)} deg`;
      axisRows.push({ mark, value: element("span", undefined, row, "value"), low, high });
    });
  }
  axisRows.forEach(({ mark, value, low, high }, k) => {
    mark.style.left = `${100 * Math.min(Math.max((q[k] - low) / (high - low), 0), 1)}%`;
    value.textContent = `${(q[k] * 180 / Math.PI).toFixed(2)}\u00b0`;
  });
  const place = new THREE.Vector3().setFromMatrixPosition(scannerPose());
  byId("tcp").textContent = `scanner at ${place.toArray().map((each) => (1000 * each).toFixed(1)).join(", ")} mm in base`;
}
function drawPath() {
  // Path of the scanner during the motion, at up to 1500 moments.
  const every = Math.max(1, Math.floor(motion.t.length / 1500)), points = [];
  for (let k = 0; k < motion.t.length; k += every) { pose(motion.q, n * k); scene.updateMatrixWorld(true); points.push(new THREE.Vector3().setFromMatrixPosition(scannerPose())); }
  const line = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: data.palette.path[0] }));
  scene.add(line);
  register("path", line, []);
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
if (motion) drawPath();
byId("of-axes").hidden = !motion;
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
byId("of-features").hidden = !data.characteristics.length;
const featurePoints = fixed(T_base_object);
onPart.add(featurePoints);
/** Show points of a feature in the colours of their deviations: blue below, red above the element. */
function showDeviations(rows) {
  featurePoints.clear();
  const largest = Math.max(...rows.map((row) => Math.abs(row[3])), 1e-6), grey = new THREE.Color("#f2f2f2");
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(rows.flatMap((row) => row.slice(0, 3).map((value) => value / 1000)), 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(rows.flatMap((row) => grey.clone().lerp(new THREE.Color(row[3] < 0 ? "#2166ac" : "#b2182b"), Math.abs(row[3]) / largest).toArray()), 3));
  featurePoints.add(new THREE.Points(geometry, new THREE.PointsMaterial({ vertexColors: true, size: 5, sizeAttenuation: false })));
}
for (const each of data.characteristics) {
  const button = element("button", each.name, byId("features"));
  button.style.borderLeftColor = each.colour;
  button.onclick = () => {
    byId("feature").replaceChildren();
    for (const [name, value] of each.rows) { element("dt", name, byId("feature")); element("dd", value, byId("feature")); }
    showDeviations(each.points);
    if (each.place) lookAt(inScene(new THREE.Vector3(...each.place)).toArray(), data.camera.part_distance / 3);
  };
}
for (const text of data.next_commands) element("code", command(text), byId("next"));
byId("of-next").hidden = !data.next_commands.length;
if (motion) {
  byId("player").hidden = false;
  byId("time").max = motion.t[motion.t.length - 1];
  byId("time").oninput = () => { play(false); moment(Number(byId("time").value)); };
  byId("play").onclick = () => play(!playing);
  byId("before").onclick = () => step(-1);
  byId("after").onclick = () => step(1);
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
canvas.onwheel = (event) => {  // towards the place under the pointer
  event.preventDefault();
  const before = orbit.distance;
  orbit.distance = Math.min(Math.max(before * Math.exp(event.deltaY * 0.001), 0.02), 30);
  const scale = 2 * Math.tan((camera.fov * Math.PI) / 360) * (before - orbit.distance) / canvas.clientHeight;
  const [x, y] = onScreen(orbit.target), axis = (k) => new THREE.Vector3().setFromMatrixColumn(camera.matrix, k);
  orbit.target.addScaledVector(axis(0), (event.offsetX - x) * scale).addScaledVector(axis(1), (y - event.offsetY) * scale);
  redraw();
};
canvas.oncontextmenu = (event) => event.preventDefault();
canvas.ondblclick = (event) => { const hit = surfaceAt(event.offsetX, event.offsetY); if (hit) { orbit.target.copy(hit.point); redraw(); } };
const STANDARD = { front: [-90, 0], back: [90, 0], left: [180, 0], right: [0, 0], top: [-90, 89], iso: [-45, 35] };
function standardView(name) { [orbit.azimuth, orbit.elevation] = STANDARD[name].map((angle) => (angle * Math.PI) / 180); redraw(); }
function step(by) {
  if (!data.views.length) return;
  const count = data.views.length;
  select(chosen < 0 ? (by > 0 ? 0 : count - 1) : (chosen + by + count) % count);
}
function foldPanel() { document.body.classList.toggle("folded"); resize(); }
const KEYS = {
  " ": () => play(!playing), ArrowRight: () => step(1), ArrowLeft: () => step(-1), f: () => lookAt(data.camera.part, data.camera.part_distance),
  c: () => lookAt(data.camera.target, data.camera.distance), t: () => standardView("top"), p: foldPanel, Escape: () => globalThis.endTool?.(),
};
addEventListener("keydown", (event) => {
  if (/INPUT|SELECT|TEXTAREA/.test(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.tagName === "BUTTON" && event.key === " ") return;
  const digit = Number(event.key);
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key] ?? (digit >= 1 && digit <= data.views.length ? () => select(digit - 1) : null);
  if (act) { event.preventDefault(); act(); }
});
/** Place, face and surface under a point of the canvas, or undefined. */
function surfaceAt(x, y) {
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2(2 * x / canvas.clientWidth - 1, 1 - 2 * y / canvas.clientHeight), camera);
  const visible = surfaces.filter((surface) => shown.get(surface.name).visible);
  const hits = visible.flatMap((surface) => ray.intersectObject(surface.mesh).map((hit) => ({ ...hit, surface })));
  const clip = surfaces[0]?.material.clippingPlanes?.[0];
  return hits.filter((hit) => !clip || clip.distanceToPoint(hit.point) >= 0).sort((a, b) => a.distance - b.distance)[0];
}
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
element("button", "cell", byId("of-camera")).onclick = KEYS.c;
element("button", "part", byId("of-camera")).onclick = KEYS.f;
for (const name of Object.keys(STANDARD)) element("button", name, byId("of-camera")).onclick = () => standardView(name);
byId("fold").onclick = foldPanel;

// ---- free side of the part, and fading of what stands before it ------------------------------------------------------
const partCentre = new THREE.Vector3(...data.camera.part), partRadius = data.camera.part_distance / 4.4;
const obstacles = () => [...shown].filter(([name]) => !surfaces.some((surface) => surface.name === name) && !["floor", "views", "points", "path"].includes(name));
function blockers(from) {
  // Names of what the lines from a place to the part pass: to its centre and to four points around it.
  const toward = partCentre.clone().sub(from), ray = new THREE.Raycaster(), found = new Set();
  const side = new THREE.Vector3(0, 0, 1).cross(toward).normalize(), up = toward.clone().cross(side).normalize();
  for (const [a, b] of [[0, 0], [0.6, 0], [-0.6, 0], [0, 0.6], [0, -0.6]]) {
    const aim = partCentre.clone().addScaledVector(side, a * partRadius).addScaledVector(up, b * partRadius).sub(from);
    ray.set(from, aim.clone().normalize());
    ray.far = Math.max(aim.length() - 0.7 * partRadius, 0);
    for (const [name, entry] of obstacles()) {
      if (entry.visible && entry.opacity > 0 && entry.objects.some((object) => ray.intersectObject(object, true).some((hit) => hit.object.isMesh))) found.add(name);
    }
  }
  return found;
}
const eyeAt = (azimuth, elevation, distance) => new THREE.Vector3(Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)).multiplyScalar(distance);
function chooseFreeSide() {
  scene.updateMatrixWorld(true);
  const turns = [0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6].map((k) => (k * Math.PI) / 6), start = orbit.azimuth;
  const counts = turns.map((turn) => blockers(eyeAt(start + turn, orbit.elevation, data.camera.part_distance).add(partCentre)).size);
  orbit.azimuth = start + turns[counts.indexOf(Math.min(...counts))];
}
let fadeTimer = 0;
function fadeBlockers() {
  const near = orbit.distance < 2 * data.camera.part_distance && orbit.target.distanceTo(partCentre) < 2 * partRadius;
  const found = near && surfaces.length ? blockers(camera.position) : new Set();
  for (const [name, entry] of obstacles()) {
    const fade = found.has(name) ? 0.15 : 1;
    if ((entry.fade ?? 1) !== fade) { entry.fade = fade; apply(name); }
  }
}
function resize() {
  renderer?.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer?.setSize(innerWidth, innerHeight, false);
  const folded = document.body.classList.contains("folded"), wide = innerWidth > 760;
  const [right, below] = wide ? [folded ? 0 : 330, 0] : [0, folded ? 70 : 0.42 * innerHeight + 70];  // of panel and player
  camera.fov = 2 * Math.atan(0.315 * innerHeight / Math.min(innerWidth - right, innerHeight - below)) * 180 / Math.PI;
  camera.aspect = innerWidth / innerHeight;
  camera.setViewOffset(innerWidth, innerHeight, right / 2, below / 2, innerWidth, innerHeight);
  redraw();
}
function draw() {
  if (!renderer) return;
  const { target, distance, azimuth, elevation } = orbit;
  camera.position.copy(eyeAt(azimuth, elevation, distance)).add(target);
  camera.lookAt(target);
  camera.near = distance / 100; camera.updateProjectionMatrix(); camera.updateMatrixWorld();
  lamp.position.copy(camera.position).add(new THREE.Vector3(0, 0, 0.4 * distance));
  lamp.target.position.copy(target); lamp.target.updateMatrixWorld();
  placeSigns();
  clearTimeout(fadeTimer);
  fadeTimer = setTimeout(fadeBlockers, 150);
  globalThis.placeFlags?.();
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
if (data.is_alone) {
  for (const [name, entry] of obstacles()) { entry.visible = false; apply(name); ticks.get(name)?.(); }
  for (const name of ["floor", "views", "path"]) if (shown.has(name)) { shown.get(name).visible = false; apply(name); ticks.get(name)?.(); }
}
if (choice) { byId("colour").value = choices.indexOf(choice); paint(); }
if (motion) moment(0);
if (data.camera.starts_at_part && data.camera.is_free) chooseFreeSide();
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
