// Page of a surface with items, such as CAD faces: a click or a number selects one. Runs after page.js.
"use strict";
const cad = JSON.parse(byId("faces").textContent), faceOf = numbers(cad.face_of_vertex);
const section = element("section");
element("h2", cad.what, section);
const input = element("input", undefined, section);
const list = element("dl", undefined, section);
input.type = "number"; input.min = cad.faces[0].number;
input.setAttribute("aria-label", "number of a " + cad.what.toLowerCase());
document.querySelector("aside").insertBefore(section, byId("of-colour"));
function showFace(index) {
  list.replaceChildren();
  paint();
  if (index < 0) return;
  input.value = cad.faces[index].number;
  for (const [name, value] of cad.faces[index].rows) { element("dt", name, list); element("dd", value, list); }
  const { colours } = surfaces[0];
  surfaces[0].corners.forEach((vertex, i) => { if (faceOf[vertex] === index) colours.array.set(rgb(data.palette.chosen[0]), 3 * i); });
  colours.needsUpdate = true;
  redraw();
}
input.onchange = () => showFace(cad.faces.findIndex((face) => face.number === Number(input.value)));
canvas.addEventListener("pointerup", (event) => {
  if (moved >= 4) return;
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2(2 * event.offsetX / canvas.clientWidth - 1, 1 - 2 * event.offsetY / canvas.clientHeight), camera);
  const hit = ray.intersectObject(shown.get("part").objects[0], true)[0];
  showFace(hit ? faceOf[surfaces[0].corners[hit.face.a]] : -1);
});
