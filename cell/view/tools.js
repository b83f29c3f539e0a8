// Measuring on the page: probe and flags, distance, angle, diameter, section, region; files of what is shown. Runs after page.js.
const digits3 = (value) => value.toFixed(3);
const mm = (place) => place.toArray().map((each) => (1000 * each + 0).toFixed(2).replace(/^-(0\.0+)$/, "$1")).join(", ");
/** Place in the part's frame [m] of a place in the scene. */
const inObject = (place) => place.clone().applyMatrix4(onPart.matrixWorld.clone().multiply(T_base_object).invert());
const inScene = (place) => place.clone().applyMatrix4(T_base_object).applyMatrix4(onPart.matrixWorld);

/** Values under a hit: place [m, part's frame], normal, the value of the shown layer, and the views that measure it. */
function probe(hit) {
  const { surface } = hit, corner = ["a", "b", "c"].map((name) => hit.face[name]);
  const place = inObject(hit.point), weights = new THREE.Vector3();
  const at = corner.map((k) => new THREE.Vector3().fromBufferAttribute(surface.geometry.attributes.position, k));
  THREE.Triangle.getBarycoord(place, ...at, weights);
  const vertices = corner.map((k) => surface.corners[k]), nearest = vertices[[weights.x, weights.y, weights.z].indexOf(Math.max(weights.x, weights.y, weights.z))];
  const layer = choice?.surface === surface ? choice.layer : null, lines = [];
  let value = "";
  if (isField(layer)) {
    const values = vertices.map((vertex) => fieldValue(layer, vertex));
    const mixed = values[0] * weights.x + values[1] * weights.y + values[2] * weights.z;
    value = Number.isNaN(mixed) ? "no value" : `${digits3(mixed)} mm`;
    lines.push(`${layer.title.toLowerCase()}: ${value}`);
  } else if (layer?.kind === "named") lines.push(value = layer.named[layer.values[nearest]][0]);
  const bitsLayer = surface.layers.find((each) => each.kind === "views");
  let views = [];
  if (bitsLayer) {
    views = data.views.map((view, k) => [view.number, k]).filter(([, k]) => k < 8 * bitsLayer.width && seenBy(bitsLayer, nearest, k)).map(([number]) => number);
    lines.push(views.length ? `measured by view${views.length > 1 ? "s" : ""} ${views.join(", ")}` : "not measured");
  }
  lines.push(`${mm(place)} mm`, `normal ${hit.face.normal.toArray().map((each) => each.toFixed(3)).join(", ")}`);
  return { place, normal: hit.face.normal.clone(), value, views, lines, text: lines[0] };
}

// ---- hover and flags -----------------------------------------------------------------------------------------------
const flags = [], flagMarks = [];
let hoverTimer = 0;
canvas.addEventListener("pointermove", (event) => {
  byId("hover").hidden = true;
  clearTimeout(hoverTimer);
  if (event.buttons) return;
  const [x, y] = [event.offsetX, event.offsetY];
  hoverTimer = setTimeout(() => {
    const hit = surfaceAt(x, y);
    if (!hit) return;
    byId("hover").textContent = probe(hit).lines.join("\n");
    Object.assign(byId("hover").style, { left: `${x + 14}px`, top: `${y + 14}px` });
    byId("hover").hidden = false;
  }, 120);
});
function addFlag(found) {
  flags.push(found);
  flagMarks.push(element("div", found.text, byId("flags")));
  listFlags();
}
function removeFlag(index) {
  flags.splice(index, 1);
  flagMarks.splice(index, 1)[0].remove();
  listFlags();
}
function listFlags() {
  byId("flag-list").replaceChildren();
  flags.forEach((flag, k) => {
    const row = element("div", undefined, byId("flag-list"), "row");
    element("span", `${k + 1}: ${flag.text}; ${mm(flag.place)} mm`, row);
    element("button", "\u00d7", row).onclick = () => removeFlag(k);
  });
  flagMarks.forEach((mark, k) => { mark.textContent = `${k + 1}: ${flags[k].text}`; });
  const link = flags.map((flag) => flag.place.toArray().map((each) => (1000 * each).toFixed(3)).join(",")).join(";");
  try { history.replaceState(null, "", link ? `#flags=${link}` : location.pathname + location.search); } catch { location.hash = link ? `flags=${link}` : ""; }
  byId("csv").disabled = !flags.length;
  redraw();
}
globalThis.placeFlags = () => {
  flagMarks.forEach((mark, k) => {
    const [x, y, depth] = onScreen(inScene(flags[k].place));
    mark.hidden = depth >= 1;
    Object.assign(mark.style, { left: `${x}px`, top: `${y}px` });
  });
};
/** Flag at a place of the part's frame [m]: on the nearest face of the shown surface. */
function flagAt(place) {
  const surface = choice?.surface ?? surfaces[0];
  if (!surface) return;
  const position = surface.geometry.attributes.position, triangle = new THREE.Triangle(), near = new THREE.Vector3();
  let best = null, least = Infinity;
  for (let i = 0; i < position.count; i += 3) {
    triangle.a.fromBufferAttribute(position, i); triangle.b.fromBufferAttribute(position, i + 1); triangle.c.fromBufferAttribute(position, i + 2);
    triangle.closestPointToPoint(place, near);
    const off = near.distanceToSquared(place);
    if (off < least) { least = off; best = { point: near.clone(), face: { a: i, b: i + 1, c: i + 2, normal: triangle.getNormal(new THREE.Vector3()) } }; }
  }
  if (best) addFlag(probe({ ...best, surface, point: inScene(best.point) }));
}

// ---- tools: each takes clicked places ------------------------------------------------------------------------------
const sketch = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: data.palette.chosen[0], depthTest: false }));
sketch.renderOrder = 5;
scene.add(sketch);
const between = (a, b) => 1000 * a.distanceTo(b);
function circle(a, b, c) {
  // Centre and radius of the circle through three places.
  const u = b.clone().sub(a), v = c.clone().sub(a), w = u.clone().cross(v), square = w.lengthSq();
  if (square < 1e-20) return null;
  const to = v.clone().cross(w).multiplyScalar(u.lengthSq()).add(w.clone().cross(u).multiplyScalar(v.lengthSq())).multiplyScalar(0.5 / square);
  return { centre: a.clone().add(to), radius: to.length(), normal: w.normalize() };
}
const TOOLS = {
  flag: { count: 1, say: () => "", done: (places, hits) => addFlag(probe(hits[0])), prompt: "Click a place of the surface." },
  distance: {
    count: 2, prompt: "Click two places.",
    say: ([a, b]) => `distance ${digits3(between(a, b))} mm (x ${digits3(1000 * (b.x - a.x))}, y ${digits3(1000 * (b.y - a.y))}, z ${digits3(1000 * (b.z - a.z))})`,
  },
  angle: {
    count: 3, prompt: "Click three places; the second is the vertex.",
    say: ([a, b, c]) => `angle ${digits3(a.clone().sub(b).angleTo(c.clone().sub(b)) * 180 / Math.PI)} deg`,
  },
  diameter: {
    count: 3, prompt: "Click three places on the edge of a circle.",
    say: (places) => { const found = circle(...places); return found ? `diameter ${digits3(2000 * found.radius)} mm, centre ${mm(found.centre)} mm` : "the three places are on a line"; },
  },
  region: {
    count: Infinity, prompt: "Click corners of a box; the text is a region of the scene file.",
    say: (places) => {
      const box = new THREE.Box3().setFromPoints(places);
      const corner = (place) => place.toArray().map((each) => (1000 * each).toFixed(2)).join(", ");
      return `[[region]]\nname = "marked"\nbox_mm = [${corner(box.min)},\n          ${corner(box.max)}]\ncoverage = 0.99`;
    },
  },
};
let tool = null, toolHits = [];
function startTool(name) {
  endTool();
  if (name === "section") { openSection(); return; }
  tool = name;
  byId("tools").querySelectorAll("button").forEach((button) => button.classList.toggle("on", button.textContent === name));
  element("div", TOOLS[name].prompt, byId("tool"), "note");
}
globalThis.endTool = () => {
  tool = null; toolHits = [];
  sketch.geometry.setFromPoints([]);
  byId("tool").replaceChildren();
  byId("tools").querySelectorAll("button").forEach((button) => button.classList.remove("on"));
  closeSection();
  redraw();
};
for (const name of [...Object.keys(TOOLS), "section"]) element("button", name, byId("tools")).onclick = () => (tool === name ? endTool() : startTool(name));
canvas.addEventListener("pointerup", (event) => {
  if (moved >= 4 || event.button !== 0) return;
  const hit = surfaceAt(event.offsetX, event.offsetY);
  if (!hit || !TOOLS[tool]) return;
  const { count, say, done } = TOOLS[tool];
  if (toolHits.length >= count) toolHits = [];
  toolHits.push(hit);
  const places = toolHits.map((each) => inObject(each.point)), scenePlaces = toolHits.map((each) => each.point);
  sketch.geometry.setFromPoints(scenePlaces.slice(1).flatMap((place, k) => [scenePlaces[k], place]));
  byId("tool").replaceChildren();
  if (tool === "region" ? places.length >= 2 : places.length === count) {
    if (done) done(places, toolHits);
    else if (tool === "region") { const text = element("textarea", undefined, byId("tool")); text.readOnly = true; text.value = say(places); }
    else element("code", say(places), byId("tool"));
  } else element("div", `${TOOLS[tool].prompt} ${places.length} so far.`, byId("tool"), "note");
  redraw();
});

// ---- section -------------------------------------------------------------------------------------------------------
const cut = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true, depthTest: false }));
cut.renderOrder = 4;
cut.visible = false;
scene.add(cut);
function openSection() {
  const surface = choice?.surface ?? surfaces[0];
  if (!surface) return;
  byId("tools").querySelectorAll("button").forEach((button) => button.classList.toggle("on", button.textContent === "section"));
  tool = "section";
  surface.geometry.computeBoundingBox();
  const box = surface.geometry.boundingBox, row = element("div", undefined, byId("tool"), "row"), axis = element("select", undefined, row);
  for (const name of ["x", "y", "z"]) element("option", name, axis);
  axis.setAttribute("aria-label", "normal of the section");
  const slider = element("input", undefined, row), place = element("span", undefined, row), flip = element("button", "flip", row);
  slider.type = "range"; slider.min = 0; slider.max = 1; slider.step = 0.002; slider.value = 0.5;
  slider.setAttribute("aria-label", "place of the section");
  const magnifyRow = element("div", undefined, byId("tool"), "row"), magnify = element("input", undefined, magnifyRow);
  magnify.type = "number"; magnify.value = 1; magnify.min = 0; magnify.setAttribute("aria-label", "factor of the deviation in the profile");
  element("span", "times the deviation", magnifyRow);
  const profile = element("canvas", undefined, byId("tool"));
  profile.id = "profile"; profile.width = 560; profile.height = 300;
  let side = 1;
  const update = () => {
    const k = axis.selectedIndex, low = box.min.getComponent(k), at = low + Number(slider.value) * (box.max.getComponent(k) - low);
    place.textContent = `${(1000 * at).toFixed(2)} mm`;
    showSection(choice?.surface ?? surface, k, at, side, profile, Number(magnify.value));
  };
  axis.onchange = slider.oninput = magnify.onchange = update;
  flip.onclick = () => { side = -side; update(); };
  update();
}
function closeSection() {
  cut.visible = false;
  for (const { material } of surfaces) material.clippingPlanes = null;
}
/** Clip the surfaces at a plane of the part's frame, and draw its lines in the scene and in the profile. */
function showSection(surface, k, at, side, profile, factor) {
  const normal = new THREE.Vector3().setComponent(k, -side), plane = new THREE.Plane(normal, side * at);
  const world = onPart.matrixWorld.clone().multiply(T_base_object);
  for (const { material } of surfaces) material.clippingPlanes = [plane.clone().applyMatrix4(world)];
  const position = surface.geometry.attributes.position, layer = isField(choice?.layer) ? choice.layer : null;
  const points = [], values = [], normals = [], p = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (let i = 0; i < position.count; i += 3) {
    const off = p.map((place, c) => place.fromBufferAttribute(position, i + c).getComponent(k) - at);
    if ((off[0] > 0) === (off[1] > 0) && (off[1] > 0) === (off[2] > 0)) continue;
    const faceNormal = p[1].clone().sub(p[0]).cross(p[2].clone().sub(p[0])).setComponent(k, 0).normalize();
    for (const [a, b] of [[0, 1], [1, 2], [2, 0]]) {
      if ((off[a] > 0) === (off[b] > 0)) continue;
      const share = off[a] / (off[a] - off[b]);
      points.push(p[a].clone().lerp(p[b], share));
      normals.push(faceNormal);
      const [u, v] = [a, b].map((c) => layer ? fieldValue(layer, surface.corners[i + c]) : NaN);
      values.push(u + share * (v - u));
    }
  }
  const colour = (value) => layer ? fieldColour(layer, value) : rgb(data.palette.chosen[0]);
  cut.geometry.dispose();
  cut.geometry = new THREE.BufferGeometry().setFromPoints(points.map((place) => place.clone().applyMatrix4(world)));
  cut.geometry.setAttribute("color", new THREE.Float32BufferAttribute(values.flatMap(colour), 3));
  cut.visible = true;
  drawProfile(profile, points, values, normals, colour, [[1, 2], [0, 2], [0, 1]][k], factor);
  redraw();
}
function drawProfile(profile, points, values, normals, colour, [u, v], factor) {
  const pen = profile.getContext("2d"), { width, height } = profile;
  pen.clearRect(0, 0, width, height);
  if (!points.length) return;
  const across = points.map((place) => place.getComponent(u)), up = points.map((place) => place.getComponent(v));
  const [left, right, bottom, top] = [Math.min(...across), Math.max(...across), Math.min(...up), Math.max(...up)];
  const scale = Math.min((width - 60) / Math.max(right - left, 1e-9), (height - 70) / Math.max(top - bottom, 1e-9));
  const at = (x, y) => [30 + (x - left) * scale, height - 40 - (y - bottom) * scale];
  pen.lineWidth = 2;
  for (let i = 0; i < points.length; i += 2) {
    const ends = [i, i + 1].map((k) => {
      const move = Number.isNaN(values[k]) ? 0 : factor * values[k] / 1000;
      return at(across[k] + move * normals[k].getComponent(u), up[k] + move * normals[k].getComponent(v));
    });
    if (factor && !Number.isNaN(values[i])) {
      pen.strokeStyle = "#8886"; pen.beginPath(); pen.moveTo(...at(across[i], up[i])); pen.lineTo(...at(across[i + 1], up[i + 1])); pen.stroke();
    }
    pen.strokeStyle = `rgb(${colour(values[i]).map((part) => Math.round(255 * part)).join(",")})`;
    pen.beginPath(); pen.moveTo(...ends[0]); pen.lineTo(...ends[1]); pen.stroke();
  }
  const length = 10 ** Math.floor(Math.log10(Math.max(right - left, 1e-6)));
  pen.strokeStyle = pen.fillStyle = getComputedStyle(document.body).color;
  pen.font = "20px system-ui, sans-serif";
  pen.beginPath(); pen.moveTo(30, height - 14); pen.lineTo(30 + length * scale, height - 14); pen.stroke();
  pen.fillText(`${Number((1000 * length).toPrecision(3))} mm`, 40 + length * scale, height - 8);
}

// ---- files of what is shown ----------------------------------------------------------------------------------------
function save(name, blob) {
  const link = element("a", undefined, document.body);
  link.href = URL.createObjectURL(blob); link.download = name;
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
element("button", "image", byId("save")).onclick = () => { draw(); canvas.toBlob((blob) => save("view.png", blob)); };
const csvButton = element("button", "flags (CSV)", byId("save"));
csvButton.id = "csv"; csvButton.disabled = true;
csvButton.onclick = () => save("flags.csv", new Blob([flagTable()], { type: "text/csv" }));
function flagTable() {
  const rows = flags.map((flag, k) => [k + 1, ...flag.place.toArray().map((each) => (1000 * each).toFixed(4)), ...flag.normal.toArray().map((each) => each.toFixed(5)), flag.value, flag.views.join(" ")]);
  return [["flag", "x_mm", "y_mm", "z_mm", "normal_x", "normal_y", "normal_z", "value", "views"], ...rows].map((row) => row.map((cell) => `"${String(cell).replace(/"/g, '""')}"`).join(",")).join("\r\n") + "\r\n";
}
element("button", "shown meshes (GLB)", byId("save")).onclick = () => save("shown.glb", new Blob([glb()], { type: "model/gltf-binary" }));
/** The visible meshes in base [m] as one binary glTF, colours of the surface included. */
function glb() {
  const pieces = [], views = [], accessors = [], meshes = [], nodes = [], materials = [];
  let length = 0;
  const add = (array, type, bounds) => {
    views.push({ buffer: 0, byteOffset: length, byteLength: array.byteLength });
    accessors.push({ bufferView: views.length - 1, componentType: 5126, count: array.length / 3, type, ...bounds });
    pieces.push(array); length += array.byteLength;
    return accessors.length - 1;
  };
  scene.updateMatrixWorld(true);
  for (const [name, entry] of shown) {
    if (!entry.visible || !entry.opacity) continue;
    for (const object of entry.objects) object.traverse((mesh) => {
      if (!mesh.isMesh) return;
      const flat = mesh.geometry.index ? mesh.geometry.toNonIndexed() : mesh.geometry, placed = flat.attributes.position.clone().applyMatrix4(mesh.matrixWorld);
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      placed.array.forEach((value, k) => { low[k % 3] = Math.min(low[k % 3], value); high[k % 3] = Math.max(high[k % 3], value); });
      const attributes = { POSITION: add(new Float32Array(placed.array), "VEC3", { min: low, max: high }) };
      const own = flat.attributes.colour, tint = mesh.material.color;
      if (own) attributes.COLOR_0 = add(new Float32Array(own.array), "VEC3", {});
      materials.push({ pbrMetallicRoughness: { baseColorFactor: own ? [1, 1, 1, 1] : [tint.r, tint.g, tint.b, 1], metallicFactor: 0 }, doubleSided: true });
      meshes.push({ name, primitives: [{ attributes, material: materials.length - 1 }] });
      nodes.push({ name, mesh: meshes.length - 1 });
    });
  }
  const root = { name: "base, z up", children: nodes.map((_, k) => k), rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2] };  // glTF has y up
  const json = { asset: { version: "2.0", generator: "scan-cell" }, scene: 0, scenes: [{ nodes: [nodes.length] }], nodes: [...nodes, root], meshes, materials, accessors, bufferViews: views, buffers: [{ byteLength: length }] };
  let text = new TextEncoder().encode(JSON.stringify(json));
  const padded = new Uint8Array(Math.ceil(text.length / 4) * 4).fill(32);
  padded.set(text);
  const head = (...words) => new Uint32Array(words);
  return new Blob([head(0x46546c67, 2, 28 + padded.length + length, padded.length, 0x4e4f534a), padded, head(length, 0x004e4942), ...pieces]);
}

for (const text of decodeURIComponent(location.hash).replace(/^#flags=/, "").split(";")) {
  const place = text.split(",").map(Number);
  if (place.length === 3 && place.every(Number.isFinite)) flagAt(new THREE.Vector3(...place).multiplyScalar(0.001));
}
