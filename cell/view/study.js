// Page of a study: the table is sorted by a click on a heading; a click on a mark of the map selects its row. Rows are in #study-data.
"use strict";
const { rows, columns, accuracy, commands, best } = JSON.parse(document.getElementById("study-data").textContent);
const byId = (id) => document.getElementById(id);
const lines = [...document.querySelectorAll("tbody tr")], heads = [...document.querySelectorAll("th")];
const isNumber = (column) => rows.some((row) => typeof row[column] === "number") && rows.every((row) => row[column] === null || row[column] === undefined || typeof row[column] === "number");
const values = (column) => rows.map((row) => row[column]).filter((value) => typeof value === "number");
const numeric = columns.filter(isNumber), varying = numeric.filter((column) => new Set(values(column)).size > 1);
const isWhole = (column) => values(column).every(Number.isInteger);
const text = (value) => (value === null || value === undefined ? "none" : typeof value === "number" ? Number(value.toPrecision(4)).toString() : String(value));
const RAMP = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"].map((hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
function ramp(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1), low = Math.min(Math.floor(at), RAMP.length - 2);
  return `rgb(${RAMP[low].map((part, k) => Math.round(part + (at - low) * (RAMP[low + 1][k] - part))).join(",")})`;
}
/** Limits of a colour scale: the values, but at least their accuracy apart. */
function limits(column) {
  const all = values(column), low = Math.min(...all), high = Math.max(...all), more = Math.max((accuracy[column] ?? 0) - (high - low), 0) / 2;
  return [low - more, high + more];
}

// ---- table ----------------------------------------------------------------------------------------------------------
let sorted = null, upward = true;
heads.slice(0, columns.length).forEach((head, k) => {
  head.tabIndex = 0;
  head.onclick = () => {
    upward = sorted === k ? !upward : true;
    sorted = k;
    const key = (line) => rows[Number(line.dataset.row)][columns[k]];
    const order = (a, b) => {
      const [u, v] = [key(a), key(b)];
      if (u === null || u === undefined || v === null || v === undefined) return Number(u === null || u === undefined) - Number(v === null || v === undefined);
      return (typeof u === "number" && typeof v === "number" ? u - v : String(u).localeCompare(String(v))) * (upward ? 1 : -1);
    };
    document.querySelector("tbody").append(...[...lines].sort(order));
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", upward ? "ascending" : "descending");
  };
  head.onkeydown = (event) => { if (event.key === "Enter") head.click(); };
});
let selected = best ?? -1;
function select(number) {
  selected = number;
  for (const line of lines) line.classList.toggle("on", Number(line.dataset.row) === number);
  for (const mark of byId("map").querySelectorAll("[data-row]")) mark.classList.toggle("on", Number(mark.dataset.row) === number);
  byId("command").textContent = commands[number] ?? "";
  byId("values").textContent = number < 0 ? "click a mark or a row" : columns.map((column) => `${column}: ${text(rows[number][column])}`).join(", ");
}
for (const line of lines) line.addEventListener("click", () => select(Number(line.dataset.row)));

// ---- map ------------------------------------------------------------------------------------------------------------
const chosen = { x: varying.includes("x mm") ? "x mm" : varying[0], y: varying.includes("y mm") ? "y mm" : varying[1] ?? varying[0] };
chosen.colour = ["planned %", "coverable %", "visible %"].find((column) => numeric.includes(column) && 2 * values(column).length > rows.length && !Object.values(chosen).includes(column)) ?? varying.find((column) => !Object.values(chosen).includes(column)) ?? varying[0];
const SVG = "http://www.w3.org/2000/svg";
function draw(tag, parent, attributes, content) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (content !== undefined) made.textContent = content;
  parent.append(made);
  return made;
}
function ticks(low, high, whole) {
  const step = 10 ** Math.floor(Math.log10(Math.max(high - low, 1e-9) / 2)), steps = [step, 2 * step, 5 * step, 10 * step];
  const width = Math.max(steps.find((each) => (high - low) / each <= 7) ?? steps[3], whole ? 1 : 0), found = [];
  for (let k = Math.ceil(low / width - 1e-9); k * width <= high + 1e-9 * width; k++) found.push(Number((k * width).toPrecision(10)));
  return found;
}
function drawMap() {
  const map = byId("map"), { x, y, colour } = chosen, width = 640, height = 360, left = 70, bottom = 44, right = 130, top = 14;
  map.replaceChildren();
  map.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const range = (column) => { const [low, high] = limits(column), more = 0.07 * (high - low || 1); return [low - more, high + more]; };
  const [xs, ys] = [range(x), range(y)], [low, high] = limits(colour);
  const at = (u, v) => [left + (u - xs[0]) / (xs[1] - xs[0]) * (width - left - right), height - bottom - (v - ys[0]) / (ys[1] - ys[0]) * (height - bottom - top)];
  for (const tick of ticks(...xs, isWhole(x))) { const [u] = at(tick, ys[0]); draw("line", map, { x1: u, x2: u, y1: top, y2: height - bottom, class: "grid" }); draw("text", map, { x: u, y: height - bottom + 16, "text-anchor": "middle" }, text(tick)); }
  for (const tick of ticks(...ys, isWhole(y))) { const [, v] = at(xs[0], tick); draw("line", map, { x1: left, x2: width - right, y1: v, y2: v, class: "grid" }); draw("text", map, { x: left - 6, y: v + 4, "text-anchor": "end" }, text(tick)); }
  draw("text", map, { x: (left + width - right) / 2, y: height - 8, "text-anchor": "middle" }, x);
  draw("text", map, { x: 14, y: (top + height - bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 14 ${(top + height - bottom) / 2})` }, y);
  const count = (column) => new Set(values(column)).size;
  const size = [Math.max(Math.min((width - left - right) / (1.3 * count(x)), 46), 9), Math.max(Math.min((height - bottom - top) / (1.3 * count(y)), 46), 9)];
  rows.forEach((row, number) => {
    if (typeof row[x] !== "number" || typeof row[y] !== "number") return;
    const [u, v] = at(row[x], row[y]), known = typeof row[colour] === "number";
    const mark = draw("rect", map, { x: u - size[0] / 2, y: v - size[1] / 2, width: size[0], height: size[1], rx: 2, fill: known ? ramp((row[colour] - low) / (high - low || 1)) : "none", "data-row": number, tabindex: 0 });
    draw("title", mark, {}, `${x} ${text(row[x])}, ${y} ${text(row[y])}: ${colour} ${text(row[colour])}`);
    mark.onclick = () => { select(number); lines.find((line) => Number(line.dataset.row) === number).scrollIntoView({ block: "nearest" }); };
    mark.onkeydown = (event) => { if (event.key === "Enter") mark.onclick(); };
    if (number === best) draw("text", map, { x: u, y: v + 6, "text-anchor": "middle", class: "star" }, "\u2605");
  });
  // Whole numbers have one step of colour each.
  const whole = isWhole(colour), from = Math.ceil(low), to = Math.floor(high), steps = whole && to - from < 30 ? to - from + 1 : 60;
  for (let k = 0; k < steps; k++) {
    const part = (height - bottom - top) / steps, value = whole && steps < 60 ? from + k : low + (k + 0.5) / steps * (high - low);
    draw("rect", map, { x: width - right + 24, y: height - bottom - (k + 1) * part, width: 16, height: part + 0.5, fill: ramp((value - low) / (high - low || 1)), class: "bar" });
    if (whole && steps < 60 && (steps < 12 || k % Math.ceil(steps / 10) === 0)) draw("text", map, { x: width - right + 46, y: height - bottom - (k + 0.5) * part + 4 }, String(value));
  }
  if (!(whole && steps < 60)) for (const tick of ticks(low, high, whole)) draw("text", map, { x: width - right + 46, y: height - bottom - (tick - low) / (high - low || 1) * (height - bottom - top) + 4 }, text(tick));
  draw("text", map, { x: width - 8, y: (top + height - bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 ${width - 8} ${(top + height - bottom) / 2})` }, colour);
  select(selected);
}
byId("chart").hidden = varying.length < 2;
if (varying.length >= 2) {
  for (const [axis, options] of [["x", varying], ["y", varying], ["colour", numeric]]) {
    const box = byId(axis);
    for (const column of options) { const option = document.createElement("option"); option.textContent = column; option.selected = column === chosen[axis]; box.append(option); }
    box.onchange = () => { chosen[axis] = box.value; drawMap(); };
  }
  drawMap();
}
