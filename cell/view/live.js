// Page of `cell live`: objects are moved by a gizmo or by numbers; the server evaluates and plans. Runs after page.js and tools.js.
const live = JSON.parse(byId("page-live").textContent);
let state = live.state, reach = live.reach, target = state.targets[0].name, viewMove = -1;
let poseNow = null, waiting = null, queued = null, updates = 0;

// ---- poses: KUKA's A, B, C are rotations about z, y, x ---------------------------------------------------------------
const toMatrix = ({ position_mm: p, abc_deg: [a, b, c] }) => new THREE.Matrix4()
  .makeRotationFromEuler(new THREE.Euler(...[c, b, a].map((angle) => (angle * Math.PI) / 180), "ZYX"))
  .setPosition(...p.map((each) => each / 1000));
const rounded = (value, digits) => Number(value.toFixed(digits)) + 0;
function toPose(name, T) {
  const angles = new THREE.Euler().setFromRotationMatrix(T, "ZYX"), place = new THREE.Vector3().setFromMatrixPosition(T);
  const degrees = [angles.z, angles.y, angles.x].map((angle) => rounded((angle * 180) / Math.PI, 2));
  return { name, position_mm: place.toArray().map((each) => rounded(1000 * each, 1)), abc_deg: degrees };
}
const drawn = Object.fromEntries(state.targets.map((each) => [each.name, toMatrix(each)]));  // poses in the page's geometry
const attached = () => state.targets.filter((each) => each.attached).map((each) => each.name);
const T_link_base = matrix(data.T_part_link_base);
function place(objects, T) {
  for (const object of objects) { object.matrixAutoUpdate = false; object.matrix.copy(T); object.matrixWorldNeedsUpdate = true; }
}
const objectsOf = (name) => shown.get(name)?.objects ?? [];
const baseJoint = links[1].parent, baseJointMatrix = baseJoint.matrix.clone();
/** Show an object at a pose: its geometry is displaced from where the page has it. */
function show(pose) {
  const D = toMatrix(pose).multiply(drawn[pose.name].clone().invert());
  if (pose.name === "part") {
    const inLink = T_link_base.clone().multiply(D);
    onPart.matrix.copy(inLink);
    data.camera.part = pose.position_mm.map((each) => each / 1000);
    partCentre.set(...data.camera.part);
    const shift = new THREE.Matrix4().setPosition(...pose.position_mm.map((each, k) => each / 1000 - drawn.part.elements[12 + k]));
    const turned = (T) => T_link_base.clone().multiply(T).multiply(T_link_base.clone().invert());
    place(objectsOf("post"), turned(shift));
    for (const name of [...attached(), "part, not required"]) place(objectsOf(name), turned(D));
  } else if (pose.name === "robot") {
    baseJoint.matrix.copy(D).multiply(baseJointMatrix);
    place(objectsOf("robot").filter((each) => each.parent === links[0]), D);
  } else place(objectsOf(pose.name), D);
  scene.updateMatrixWorld(true);
  redraw();
}

// ---- socket: the latest pose is sent when the answer to the one before is there --------------------------------------
const socket = new WebSocket(`ws://${location.host}${location.pathname}socket`);
const send = (name, content = null) => { if (socket.readyState === 1) socket.send(JSON.stringify({ [name]: content })); };
function sendDrag(pose) {
  if (waiting) { queued = pose; return; }
  waiting = pose; queued = null;
  send("drag", pose);
}
socket.onmessage = (event) => {
  const message = JSON.parse(event.data);
  if (message.reach) {
    reach = message.reach; updates += 1; document.body.dataset.updates = updates;
    waiting = null;
    if (queued) sendDrag(queued);
    showReach();
  }
  if (message.state) { state = message.state; showState(); }
  if (message.job) showJob(message.job);
  if (message.command) byId("live-command").textContent = message.command;
  if (message.contacts) showContacts(message.contacts.map(([name, distance]) => `${name} ${distance} mm`), message.contacts.map(([name]) => name));
  if (message.error) { waiting = queued = null; byId("live-error").textContent = message.error; }
  if (message.follow) follow(message.follow);
  if (message.reload && !grip) reloadPage();
};
socket.onclose = () => { byId("live-error").textContent = "the server has ended; start cell live again"; };
function reloadPage() {
  const kept = { orbit, target, colour: choice?.title, error: byId("live-error").textContent };
  sessionStorage.setItem("live", JSON.stringify(kept));
  location.reload();
}

// ---- panel ----------------------------------------------------------------------------------------------------------
const panel = element("section", undefined, undefined, "");
panel.id = "live";
byId("messages").after(panel);
element("h2", "Move", panel);
const choose = element("select", undefined, element("div", undefined, panel, "row"));
choose.setAttribute("aria-label", "object to move");
choose.onchange = () => selectTarget(choose.value);
const inputs = {};
const grid = element("div", undefined, panel, "pose");
for (const [key, unit] of [["x", "mm"], ["y", "mm"], ["z", "mm"], ["A", "deg"], ["B", "deg"], ["C", "deg"]]) {
  const label = element("label", key, grid), input = element("input", undefined, label);
  input.type = "number"; input.step = "any"; input.title = unit; input.setAttribute("aria-label", `${key} in ${unit}`);
  input.onchange = () => { poseNow = typedPose(); showAndSend(); release(); };
  inputs[key] = input;
}
const sizeRow = element("div", undefined, panel, "pose"), reachBox = element("div", undefined, panel);
reachBox.id = "live-reach";
const problems = element("div", undefined, panel), errorLine = element("p", "", panel, "problem");
errorLine.id = "live-error";
const job = element("div", undefined, panel, "row"), jobText = element("span", "", job), bar = element("progress", undefined, job);
job.id = "live-job"; job.hidden = true;
element("button", "cancel", job).onclick = () => send("cancel");
const buttons = element("div", undefined, panel, "row");
const button = (text, act, title) => { const made = element("button", text, buttons); made.onclick = act; made.title = title; return made; };
button("plan", () => send("plan"), "plan this state");
const undoButton = button("undo", () => send("undo"), "return to the state before");
button("draw box", startBox, "draw the footprint of a keep-out box on the floor");
const removeButton = button("remove", () => send("remove", target), "remove this fixture");
const runButton = button("run on sim://", () => send("scan"), "execute the plan on the simulated controller");
const row = element("div", undefined, panel, "row");
function check(text, act, checked) {
  const label = element("label", undefined, row), box = element("input", undefined, label);
  box.type = "checkbox"; box.checked = checked; label.append(` ${text}`);
  box.onchange = () => act(box.checked);
  return box;
}
const automatic = check("plan each state", (on) => send("automatic", on), state.automatic);
check("candidates", (on) => { dots.visible = on; redraw(); }, true);
const boxHeight = element("input", undefined, element("label", "box height mm ", element("div", undefined, panel, "row")));
boxHeight.type = "number"; boxHeight.value = 400; boxHeight.min = 1; boxHeight.setAttribute("aria-label", "height of a new box in mm");
element("code", "", panel).id = "live-command";
element("div", "", panel, "note").id = "live-file";
const jogBox = element("details", undefined, panel);
element("summary", "Jog the axes", jogBox);
const jogged = [...data.arm.home], jogContacts = element("div", "", jogBox, "note");
data.arm.home.forEach((angle, k) => {
  const line = element("div", undefined, jogBox, "row"), slider = element("input", undefined, line), value = element("span", "", line);
  line.prepend(k < 6 ? `A${k + 1}` : `E${k - 5}`);
  const [low, high] = data.arm.limits[k].map((limit) => (limit * 180) / Math.PI), label = () => { value.textContent = `${Number(slider.value).toFixed(1)}\u00b0`; };
  Object.assign(slider, { type: "range", min: low, max: high, step: 0.1, value: (angle * 180) / Math.PI });
  slider.setAttribute("aria-label", `axis ${k + 1} in deg`);
  label();
  slider.oninput = () => {
    label();
    jogged[k] = (Number(slider.value) * Math.PI) / 180;
    if (motion) play(false);
    pose(jogged); if (motion) showAxes(jogged);
    send("jog", { axes_deg: jogged.map((each) => (each * 180) / Math.PI) });
  };
});
function typedPose() {
  const value = (key) => Number(inputs[key].value) || 0;
  return { name: target, position_mm: ["x", "y", "z"].map(value), abc_deg: ["A", "B", "C"].map(value) };
}
function showPose() {
  const values = [...poseNow.position_mm, ...poseNow.abc_deg];
  Object.values(inputs).forEach((input, k) => { input.value = values[k]; });
  placeGizmo();
}
function targetPose(name) {
  const { position_mm, abc_deg } = state.targets.find((each) => each.name === name) ?? state.targets[0];
  return { name, position_mm: [...position_mm], abc_deg: [...abc_deg] };
}
function selectTarget(name) {
  viewMove = -1;
  target = state.targets.some((each) => each.name === name) ? name : state.targets[0].name;
  choose.value = target;
  poseNow = targetPose(target);
  const size = state.targets.find((each) => each.name === target).size_mm;
  removeButton.disabled = ["part", "robot", "table"].includes(target);
  sizeRow.replaceChildren();
  (size ?? []).forEach((each, k) => {
    const input = element("input", undefined, element("label", "size", sizeRow));
    input.type = "number"; input.value = each; input.min = 0.1; input.setAttribute("aria-label", `size ${k + 1} in mm`);
    input.onchange = () => send("size", { name: target, size_mm: [...sizeRow.querySelectorAll("input")].map((other) => Number(other.value)) });
  });
  showPose();
}
function showState() {
  choose.replaceChildren();
  for (const each of state.targets) element("option", each.name, choose);
  if (!grip) {
    for (const each of state.targets) if (drawn[each.name]) show(each);
    if (viewMove < 0) selectTarget(target);
  }
  automatic.checked = state.automatic;
  undoButton.disabled = !state.can_undo;
  runButton.disabled = !state.run;
  byId("live-command").textContent = state.command;
  byId("live-file").textContent = state.run ? `saved; plan in ${state.run}` : "saved; not planned yet";
}
function showJob(message) {
  job.hidden = "folder" in message || "failed" in message;
  if (message.stage) {
    jobText.textContent = `${message.command}: ${message.stage}`;
    if (message.total) { bar.max = message.total; bar.value = message.done; } else bar.removeAttribute("value");
  }
  if (message.note) byId("live-file").textContent = message.note;
  if (message.failed) byId("live-error").textContent = message.failed;
}

// ---- reach: candidates, surface, contacts ----------------------------------------------------------------------------
const COLLISION = "#5d3a9b", VERDICT = [data.palette.cloud[0], "#999999", "#e69f00", COLLISION].map(rgb);
const dotGeometry = new THREE.BufferGeometry();
dotGeometry.setAttribute("position", new THREE.BufferAttribute(places(live.candidates), 3));
dotGeometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * dotGeometry.attributes.position.count), 3));
const dots = new THREE.Points(dotGeometry, new THREE.PointsMaterial({ vertexColors: true, size: 3, sizeAttenuation: false }));
const dotGroup = fixed(T_base_object);
dotGroup.add(dots); onPart.add(dotGroup);
const liveLayer = surfaces[0].layers.find((each) => each.title === live.layer), rowOfVertex = numbers(live.vertex_samples);
const NAMES = { housing: "scanner", bracket: "scanner", base: "robot" };
const materialsOf = (name) => (name === "part" ? [] : shown.get(NAMES[name] ?? (/^link_/.test(name) ? "robot" : name))?.materials.filter((each) => each.color && each.isMeshPhongMaterial) ?? []);
let marked = [];
function markPieces(pairs) {
  for (const [material, colour] of marked) material.color.copy(colour);
  marked = [];
  for (const name of pairs.flatMap((pair) => pair.split(" with "))) {
    for (const material of materialsOf(name)) if (!marked.some(([other]) => other === material)) marked.push([material, material.color.clone()]);
  }
  for (const [material] of marked) material.color.set(COLLISION);
  redraw();
}
function showContacts(lines, pairs) {
  jogContacts.textContent = lines.length ? `nearer than the clearance: ${lines.join(", ")}` : "free";
  markPieces(pairs);
}
function showReach() {
  const verdict = numbers(reach.verdict), coverable = numbers(reach.coverable), colours = dotGeometry.attributes.color;
  verdict.forEach((each, k) => colours.array.set(VERDICT[each], 3 * k));
  colours.needsUpdate = true;
  for (let k = 0; k < rowOfVertex.length; k++) liveLayer.values[k] = coverable[rowOfVertex[k]];
  if (choice?.layer === liveLayer) paint();
  reachBox.replaceChildren();
  const line = element("div", undefined, reachBox);
  element("b", `${reach.reachable}`, line); line.append(` of ${reach.candidates} candidates reached, `);
  element("b", `${(100 * reach.share).toFixed(2)} %`, line); line.append(" of the surface coverable");
  const legend = element("div", undefined, reachBox, "row");
  ["reached", "out of reach", "joint limit", "collision"].forEach((text, k) => {
    const entry = element("span", undefined, legend, "note");
    element("span", undefined, entry, "dot").style.background = `#${new THREE.Color(...VERDICT[k]).getHexString()}`;
    entry.append(text);
  });
  if (reach.blockers.length) element("div", `collisions: ${reach.blockers.map(([name, count]) => `${name} ${count}`).join(", ")}`, reachBox, "note");
  problems.replaceChildren();
  for (const text of reach.contacts) element("p", `contact: ${text}`, problems, "problem");
  for (const text of reach.problems) element("p", text, problems, "problem");
  markPieces(reach.contacts);
}

// ---- gizmo: three axes, a ring about z, and the middle for the horizontal plane ---------------------------------------
const gizmo = new THREE.Group(), COLOURS = ["#d55e00", "#009e73", "#0072b2"], RING = 0.75;
const handle = (points, colour) => {
  const line = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: colour, depthTest: false, linewidth: 2 }));
  line.renderOrder = 10; gizmo.add(line);
};
const unit = (k) => new THREE.Vector3().setComponent(k, 1), around = (angle) => new THREE.Vector3(RING * Math.cos(angle), RING * Math.sin(angle), 0);
for (let k = 0; k < 3; k++) {
  const side = unit((k + 1) % 3).multiplyScalar(0.06), back = unit(k).multiplyScalar(0.85);
  handle([new THREE.Vector3(), unit(k), back.clone().add(side), unit(k), back.clone().sub(side)], COLOURS[k]);
}
const ringAngles = [...Array(49).keys()].map((k) => (k * Math.PI) / 24);
handle(ringAngles.map(around), "#e69f00");
handle([0, 1, 2, 3, 0].map((k) => new THREE.Vector3([-1, 1, 1, -1][k], [-1, -1, 1, 1][k], 0).multiplyScalar(0.09)), "#e69f00");
scene.add(gizmo);
let grip = null;
const gizmoScale = () => 0.13 * orbit.distance;
function placeGizmo() { gizmo.position.set(...poseNow.position_mm.map((each) => each / 1000)); gizmo.scale.setScalar(gizmoScale()); redraw(); }
const placeFlagsBefore = globalThis.placeFlags;
globalThis.placeFlags = () => { placeFlagsBefore?.(); if (poseNow) gizmo.scale.setScalar(gizmoScale()); };
const gizmoPoint = (place) => onScreen(place.clone().multiplyScalar(gizmoScale()).add(gizmo.position));
/** Part of the gizmo under a point of the canvas: 0 to 2 an axis, "plane", "ring", or null. */
function gripAt(x, y) {
  const [cx, cy] = gizmoPoint(new THREE.Vector3());
  if (Math.hypot(x - cx, y - cy) < 11) return "plane";
  for (let k = 0; k < 3; k++) {
    const [tx, ty] = gizmoPoint(unit(k)), length = Math.hypot(tx - cx, ty - cy);
    const along = ((x - cx) * (tx - cx) + (y - cy) * (ty - cy)) / length, off = Math.abs((x - cx) * (ty - cy) - (y - cy) * (tx - cx)) / length;
    if (length > 14 && along > 10 && along < length + 8 && off < 8) return k;
  }
  return ringAngles.some((angle) => { const [u, v] = gizmoPoint(around(angle)); return Math.hypot(x - u, y - v) < 8; }) ? "ring" : null;
}
function rayAt(x, y) {
  const caster = new THREE.Raycaster();
  caster.setFromCamera(new THREE.Vector2(2 * x / canvas.clientWidth - 1, 1 - 2 * y / canvas.clientHeight), camera);
  return caster.ray;
}
const onPlane = (x, y, height) => rayAt(x, y).intersectPlane(new THREE.Plane(unit(2), -height), new THREE.Vector3());
/** Place [m] on an axis through the start of the drag that is nearest to the ray of the pointer. */
function alongAxis(x, y, origin, axis) {
  const ray = rayAt(x, y), between = origin.clone().sub(ray.origin), c = axis.dot(ray.direction);
  return 1 - c * c < 1e-6 ? 0 : (c * between.dot(ray.direction) - between.dot(axis)) / (1 - c * c);
}
function grab(x, y) {
  const kind = gripAt(x, y);
  if (kind === null) return false;
  const origin = gizmo.position.clone(), start = { ...poseNow };
  grip = { kind, origin, start, from: kind === "plane" || kind === "ring" ? onPlane(x, y, origin.z) : alongAxis(x, y, origin, unit(kind)) };
  return true;
}
function drag(x, y) {
  const { kind, origin, start, from } = grip, moved3 = new THREE.Vector3();
  if (kind === "ring") {
    const at = onPlane(x, y, origin.z);
    if (!at || !from) return;
    const turn = Math.atan2(at.y - origin.y, at.x - origin.x) - Math.atan2(from.y - origin.y, from.x - origin.x);
    const T = new THREE.Matrix4().makeRotationZ(turn).multiply(toMatrix({ ...start, position_mm: [0, 0, 0] }));
    poseNow = { ...toPose(start.name, T), position_mm: start.position_mm };
  } else {
    if (kind === "plane") { const at = onPlane(x, y, origin.z); if (!at || !from) return; moved3.copy(at).sub(from); }
    else moved3.copy(unit(kind)).multiplyScalar(alongAxis(x, y, origin, unit(kind)) - from);
    poseNow = { ...start, position_mm: start.position_mm.map((each, k) => rounded(each + 1000 * moved3.getComponent(k), 1)) };
  }
  showAndSend();
}
function showAndSend() {
  showPose();
  if (viewMove >= 0) { beam.geometry.setFromPoints(pyramid(toMatrix(poseNow), 1)); redraw(); return; }
  show(poseNow);
  sendDrag(poseNow);
}
function release() {
  grip = null; queued = null;
  byId("live-error").textContent = "";
  if (viewMove < 0) { send("set", poseNow); return; }
  const { position_mm, abc_deg } = poseNow;
  send("edit", { move: `${viewMove + 1}:${[...position_mm, ...abc_deg].join(",")}` });
}
const onGizmo = (name, act) => canvas.addEventListener(name, (event) => { if (act(event)) { event.stopImmediatePropagation(); event.preventDefault(); } }, true);
onGizmo("pointerdown", (event) => {
  if (event.button !== 0 || event.shiftKey) return false;
  if (boxFrom !== null) { boxFrom = onPlane(event.offsetX, event.offsetY, data.floor) ?? undefined; return true; }
  if (!grab(event.offsetX, event.offsetY)) return false;
  canvas.setPointerCapture(event.pointerId);
  return true;
});
onGizmo("pointermove", (event) => {
  if (boxFrom) { previewBox(event); return true; }
  if (!grip) { canvas.style.cursor = gripAt(event.offsetX, event.offsetY) === null ? "" : "grab"; return false; }
  drag(event.offsetX, event.offsetY);
  return true;
});
onGizmo("pointerup", (event) => {
  if (boxFrom) { endBox(event); return true; }
  if (!grip) return false;
  release();
  return true;
});

// ---- keep-out boxes ---------------------------------------------------------------------------------------------------
let boxFrom = null;  // null: no box is drawn; undefined: its first corner is not known
const boxPreview = new THREE.Mesh(new THREE.BoxGeometry(1, 1, 1), new THREE.MeshBasicMaterial({ color: "#d55e00", transparent: true, opacity: 0.35, depthWrite: false }));
boxPreview.visible = false;
scene.add(boxPreview);
function startBox() { boxFrom = undefined; canvas.style.cursor = "crosshair"; byId("live-error").textContent = "drag the footprint on the floor"; }
function boxOf(event) {
  const to = onPlane(event.offsetX, event.offsetY, data.floor), height = Number(boxHeight.value) / 1000;
  if (!to || !boxFrom) return null;
  const size = new THREE.Vector3(Math.abs(to.x - boxFrom.x), Math.abs(to.y - boxFrom.y), height);
  const middle = new THREE.Vector3((to.x + boxFrom.x) / 2, (to.y + boxFrom.y) / 2, data.floor + height / 2);
  return size.x > 0.005 && size.y > 0.005 && height > 0 ? { size, middle } : null;
}
function previewBox(event) {
  const box = boxOf(event);
  boxPreview.visible = Boolean(box);
  if (box) { boxPreview.scale.copy(box.size); boxPreview.position.copy(box.middle); }
  redraw();
}
function endBox(event) {
  const box = boxOf(event), inMm = (place) => place.toArray().map((each) => rounded(1000 * each, 1));
  boxFrom = null; boxPreview.visible = false; canvas.style.cursor = ""; byId("live-error").textContent = "";
  if (box) send("box", { position_mm: inMm(box.middle), size_mm: inMm(box.size) });
  redraw();
}

// ---- views: drop, pin or move the selected one -------------------------------------------------------------------------
const viewRow = element("div", undefined, undefined, "row");
byId("commands").before(viewRow);
const withView = (act) => () => { if (chosen >= 0) act(chosen); };
element("button", "drop and repair", viewRow).onclick = withView((k) => send("edit", { drop: String(k + 1) }));
element("button", "pin", viewRow).onclick = withView((k) => send("pin", live.candidate_of_view[k]));
element("button", "move", viewRow).onclick = withView((k) => { viewMove = k; poseNow = toPose(`view ${k + 1}`, poses[k]); showPose(); });

// ---- an execution on the simulated controller is followed: moves are the planned motion, arrivals are reported ---------
function follow(event) {
  if (!motion) return;
  const view = data.views[event.number - 1];
  if (event.event === "move") { byId("speed").value = "1"; play(true); }
  if (event.event === "arrival") { play(false); moment(event.number && view ? view.time : motion.t[motion.t.length - 1], false); if (event.number) select(event.number - 1, false); }
  byId("live-file").textContent = `sim://: ${event.event}${event.number ? ` view ${event.number}` : ""}`;
}

// ---- start ------------------------------------------------------------------------------------------------------------
const kept = JSON.parse(sessionStorage.getItem("live") ?? "{}");
sessionStorage.removeItem("live");
if (kept.orbit) Object.assign(orbit, kept.orbit, { target: new THREE.Vector3(kept.orbit.target.x, kept.orbit.target.y, kept.orbit.target.z) });
const again = choices.findIndex((each) => each.title === (kept.colour ?? live.layer));
if (again >= 0) { byId("colour").value = again; byId("colour").onchange(); }
if (kept.target) target = kept.target;
showState();
showReach();
byId("live-error").textContent = kept.error ?? "";
