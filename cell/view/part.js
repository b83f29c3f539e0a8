// The page of a part that is a CAD model: a click, or a number, shows which face it is. Runs behind page.js.
"use strict";
const cad = JSON.parse(byId("faces").textContent), faceOf = numbers(cad.face_of_vertex);
const section = element("section");
element("h2", "Face", section);
const asked = element("input", undefined, section);
const told = element("dl", undefined, section);
asked.type = "number"; asked.min = cad.faces[0].number;
asked.setAttribute("aria-label", "number of a face");
document.querySelector("aside").insertBefore(section, byId("of-colour"));
function showFace(index) {
  told.replaceChildren();
  paint();
  if (index < 0) return;
  asked.value = cad.faces[index].number;
  for (const [name, value] of cad.faces[index].rows) { element("dt", name, told); element("dd", value, told); }
  const { colours } = surfaces[0];
  for (let i = 0; i < colours.count; i++) if (faceOf[i] === index) colours.array.set(rgb(data.palette.chosen[0]), 3 * i);
  colours.needsUpdate = true;
  redraw();
}
asked.onchange = () => showFace(cad.faces.findIndex((face) => face.number === Number(asked.value)));
canvas.addEventListener("pointerup", (event) => {
  if (moved >= 4) return;
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2(2 * event.offsetX / canvas.clientWidth - 1, 1 - 2 * event.offsetY / canvas.clientHeight), camera);
  const hit = ray.intersectObject(shown.get("part").objects[0], true)[0];
  showFace(hit ? faceOf[hit.face.a] : -1);
});
