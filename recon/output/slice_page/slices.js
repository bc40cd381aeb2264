"use strict";
// Slices of basis volumes. The upper part are functions of arrays, which Node can test; the lower part draws.
// A volume is {shape: [z, y, x], values: Float32Array}; voxel (z, y, x) is values[(z * ny + y) * nx + x].

// Base64 text of gzip-compressed 16-bit numbers, to values offset + step * number.
async function decoded(stored) {
  const bytes = Uint8Array.from(atob(stored.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const view = new DataView(await new Response(stream).arrayBuffer());
  const values = new Float32Array(view.byteLength / 2);
  for (let i = 0; i < values.length; i++) values[i] = stored.offset + stored.step * view.getUint16(2 * i, true);
  return values;
}

// Sum of volumes, each times a weight.
function weighted(volumes, weights) {
  const sum = new Float32Array(volumes[0].length);
  volumes.forEach((volume, basis) => {
    const weight = weights[basis];
    if (weight !== 0) for (let i = 0; i < sum.length; i++) sum[i] += weight * volume[i];
  });
  return sum;
}

// Weights and constant that turn basis coefficients into attenuation [1/mm] or CT numbers [HU] at a tabulated energy.
function atEnergy(curves, water, index, hounsfield) {
  const weights = curves.map((curve) => curve[index]);
  if (!hounsfield) return { weights, constant: 0 };
  return { weights: weights.map((weight) => (1000 * weight) / water[index]), constant: -1000 };
}

// Axes of the three planes: which voxel index runs to the right, which up, and which through (0 z, 1 y, 2 x).
const PLANES = [
  { name: "axial", right: 2, up: 1, through: 0 },
  { name: "coronal", right: 2, up: 0, through: 1 },
  { name: "sagittal", right: 1, up: 0, through: 2 },
];
const LETTERS = ["z", "y", "x"];

// Slice of a volume through voxel `at` [z, y, x]; rows from top to bottom.
function sliced(values, shape, plane, at) {
  const strides = [shape[1] * shape[2], shape[2], 1];
  const width = shape[plane.right], height = shape[plane.up];
  const out = new Float32Array(width * height);
  const first = at[plane.through] * strides[plane.through];
  for (let row = 0; row < height; row++) {
    const start = first + (height - 1 - row) * strides[plane.up];
    for (let column = 0; column < width; column++) out[row * width + column] = values[start + column * strides[plane.right]];
  }
  return out;
}

// Values along an axis through a voxel.
function profile(values, shape, axis, at) {
  const strides = [shape[1] * shape[2], shape[2], 1];
  let start = 0;
  for (let other = 0; other < 3; other++) if (other !== axis) start += at[other] * strides[other];
  return Float32Array.from({ length: shape[axis] }, (_, i) => values[start + i * strides[axis]]);
}

// Gray level of a value, 0 to 255.
function gray(value, level, window) {
  return Math.max(0, Math.min(255, Math.round(255 * ((value - level) / window + 0.5))));
}

// Blue below zero, white at zero, red above, for differences; full colour at plus or minus the limit.
function diverging(value, limit) {
  const part = Math.max(-1, Math.min(1, value / limit)), rest = Math.round(255 * (1 - Math.abs(part)));
  return part < 0 ? [rest, rest, 255] : [255, rest, rest];
}

// Length of a scale bar: 1, 2 or 5 times a power of ten, at most a third of the extent.
function barLength(extent) {
  const power = 10 ** Math.floor(Math.log10(extent / 3));
  return [5, 2, 1].map((factor) => factor * power).find((length) => length <= extent / 3) || power;
}

// A number with three or four significant digits.
function short(value) {
  if (value === 0) return "0";
  return Math.abs(value) >= 1000 || Math.abs(value) < 0.001 ? value.toExponential(2) : value.toPrecision(3);
}

if (typeof module !== "undefined") {
  module.exports = { decoded, weighted, atEnergy, PLANES, sliced, profile, gray, diverging, barLength, short };
}

if (typeof document !== "undefined") document.addEventListener("DOMContentLoaded", start);

async function start() {
  const scan = JSON.parse(document.getElementById("data").textContent);
  const kinds = Object.keys(scan.volumes); // result, and truth where it is known
  const volumes = {};
  for (const kind of kinds) volumes[kind] = await Promise.all(scan.volumes[kind].map(decoded));
  const rows = kinds.includes("truth") ? ["result", "truth", "difference"] : ["result"];
  const state = { at: scan.shape.map((n) => Math.floor(n / 2)), quantity: 0, energy: scan.start, hounsfield: true, axis: 2, window: 1, level: 0.5, limit: 1 };
  const find = (id) => document.getElementById(id);
  const monoenergetic = () => state.quantity === scan.bases.length;
  const unit = () => (monoenergetic() && state.hounsfield ? "HU" : "1/mm");
  let shown = {};

  const canvases = {};
  const panels = find("panels");
  for (const row of rows) {
    for (const plane of PLANES) {
      const figure = document.createElement("figure"), canvas = document.createElement("canvas");
      const caption = document.createElement("figcaption");
      caption.textContent = `${row}, ${plane.name}`;
      figure.append(caption, canvas);
      panels.append(figure);
      canvases[`${row} ${plane.name}`] = canvas;
      listen(canvas, plane);
    }
  }

  function listen(canvas, plane) {
    let button = null, from = null;
    const voxel = (event) => {
      const box = canvas.getBoundingClientRect(), at = state.at.slice();
      const within = (part, count) => Math.max(0, Math.min(count - 1, Math.floor(part * count)));
      at[plane.right] = within((event.clientX - box.left) / box.width, scan.shape[plane.right]);
      at[plane.up] = within(1 - (event.clientY - box.top) / box.height, scan.shape[plane.up]);
      return at;
    };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      button = event.button === 2 || event.shiftKey ? "window" : "move";
      from = { x: event.clientX, y: event.clientY, window: state.window, level: state.level };
      canvas.setPointerCapture(event.pointerId);
      if (button === "move") { state.at = voxel(event); draw(); }
    });
    canvas.addEventListener("pointerup", () => { button = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (button === "move") { state.at = voxel(event); draw(); }
      if (button === "window") {
        state.window = Math.max(from.window * 2 ** ((event.clientX - from.x) / 150), 1e-9);
        state.level = from.level + ((from.y - event.clientY) / 300) * from.window;
        draw();
      }
      tell(voxel(event));
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      move(plane.through, event.deltaY > 0 ? -1 : 1);
    }, { passive: false });
  }

  function move(axis, step) {
    state.at[axis] = Math.max(0, Math.min(scan.shape[axis] - 1, state.at[axis] + step));
    draw();
  }

  // Compute the quantity that is shown, of all volumes.
  function compute() {
    const how = monoenergetic() ? atEnergy(scan.curves, scan.water, state.energy, state.hounsfield) : null;
    shown = {};
    for (const kind of kinds) {
      if (how === null) { shown[kind] = volumes[kind][state.quantity]; continue; }
      shown[kind] = weighted(volumes[kind], how.weights);
      if (how.constant) for (let i = 0; i < shown[kind].length; i++) shown[kind][i] += how.constant;
    }
    if (shown.truth) {
      shown.difference = shown.result.map((value, i) => value - shown.truth[i]);
    }
  }

  // Window and level from the values themselves; limits of the difference.
  function reset() {
    const values = shown.truth || shown.result;
    let low = Infinity, high = -Infinity;
    for (const value of values) { if (value < low) low = value; if (value > high) high = value; }
    const zero = unit() === "HU" ? -1000 : 0;
    state.window = Math.max(high - Math.max(low, zero), 1e-9);
    state.level = high - state.window / 2;
    state.limit = state.window / 5;
  }

  function draw() {
    find("window").value = short(state.window);
    find("level").value = short(state.level);
    find("energy").hidden = find("units").hidden = find("presets").hidden = !monoenergetic();
    find("energy-text").textContent = `${scan.energies[state.energy]} keV`;
    for (const row of rows) for (const plane of PLANES) paint(canvases[`${row} ${plane.name}`], row, plane);
    paintProfile();
    tell(state.at);
  }

  function paint(canvas, row, plane) {
    const width = scan.shape[plane.right], height = scan.shape[plane.up];
    const size = [width * scan.spacing[plane.right], height * scan.spacing[plane.up]]; // mm
    const zoom = 420 / Math.max(...scan.shape.map((n, axis) => n * scan.spacing[axis]));
    canvas.width = Math.round(size[0] * zoom);
    canvas.height = Math.round(size[1] * zoom);
    const slice = sliced(shown[row], scan.shape, plane, state.at);
    const image = new ImageData(width, height);
    for (let i = 0; i < slice.length; i++) {
      if (row === "difference") image.data.set(diverging(slice[i], state.limit), 4 * i);
      else image.data.fill(gray(slice[i], state.level, state.window), 4 * i, 4 * i + 3);
      image.data[4 * i + 3] = 255;
    }
    const own = document.createElement("canvas");
    own.width = width; own.height = height;
    own.getContext("2d").putImageData(image, 0, 0);
    const pen = canvas.getContext("2d");
    pen.imageSmoothingEnabled = false;
    pen.drawImage(own, 0, 0, canvas.width, canvas.height);
    const x = ((state.at[plane.right] + 0.5) / width) * canvas.width;
    const y = (1 - (state.at[plane.up] + 0.5) / height) * canvas.height;
    pen.strokeStyle = "rgba(230, 159, 0, 0.6)";
    pen.beginPath();
    pen.moveTo(x, 0); pen.lineTo(x, canvas.height); pen.moveTo(0, y); pen.lineTo(canvas.width, y);
    pen.stroke();
    const ink = row === "difference" ? "#333" : "#eee", bar = barLength(size[0]);
    pen.fillStyle = pen.strokeStyle = ink;
    pen.font = "12px sans-serif";
    pen.fillText(LETTERS[plane.right], canvas.width - 12, canvas.height - 6);
    pen.fillText(LETTERS[plane.up], 5, 13);
    pen.fillRect(8, canvas.height - 9, bar * zoom, 2);
    pen.fillText(`${bar} mm`, 8, canvas.height - 13);
    if (row === "difference") pen.fillText(`blue, red: -/+ ${short(state.limit)} ${unit()}`, 18, 13);
  }

  function paintProfile() {
    const canvas = find("profile"), pen = canvas.getContext("2d");
    canvas.width = canvas.clientWidth || 900;
    canvas.height = 190;
    const lines = kinds.map((kind) => [kind, profile(shown[kind], scan.shape, state.axis, state.at)]);
    const all = lines.flatMap(([, values]) => [...values]);
    const low = Math.min(...all), high = Math.max(...all, low + 1e-9);
    const x = (i) => 70 + ((canvas.width - 85) * i) / (scan.shape[state.axis] - 1 || 1);
    const y = (value) => 160 - (145 * (value - low)) / (high - low);
    pen.font = "12px sans-serif";
    pen.fillStyle = "#333";
    pen.textAlign = "right";
    for (const value of [low, (low + high) / 2, high]) pen.fillText(short(value), 62, y(value) + 4);
    pen.textAlign = "center";
    const n = scan.shape[state.axis], place = (i) => scan.origin[state.axis] + i * scan.spacing[state.axis];
    for (const i of [0, Math.floor(n / 4), Math.floor(n / 2), Math.floor((3 * n) / 4), n - 1]) pen.fillText(place(i).toFixed(1), x(i), 175);
    pen.textAlign = "left";
    pen.fillText(`${LETTERS[state.axis]} [mm]`, canvas.width - 50, 188);
    pen.fillText(unit(), 4, 12);
    const colours = { result: "#0072b2", truth: "#000000" };
    lines.forEach(([kind, values], number) => {
      pen.strokeStyle = pen.fillStyle = colours[kind];
      pen.setLineDash(kind === "truth" ? [5, 3] : []);
      pen.beginPath();
      values.forEach((value, i) => (i ? pen.lineTo(x(i), y(value)) : pen.moveTo(x(i), y(value))));
      pen.stroke();
      pen.fillText(kind, 80 + 60 * number, 12);
    });
    pen.setLineDash([]);
    pen.strokeStyle = "rgba(230, 159, 0, 0.8)";
    pen.beginPath();
    pen.moveTo(x(state.at[state.axis]), 15); pen.lineTo(x(state.at[state.axis]), 160);
    pen.stroke();
  }

  // Values at a voxel.
  function tell(at) {
    const index = (at[0] * scan.shape[1] + at[1]) * scan.shape[2] + at[2];
    const place = [2, 1, 0].map((axis) => `${LETTERS[axis]} ${(scan.origin[axis] + at[axis] * scan.spacing[axis]).toFixed(1)}`).join(", ");
    const parts = Object.entries(shown).map(([kind, values]) => `${kind} ${short(values[index])} ${unit()}`);
    for (const agent of scan.agents) {
      for (const kind of kinds) {
        const amount = agent.amounts.reduce((sum, one, basis) => sum + one * volumes[kind][basis][index], 0);
        parts.push(`${agent.element} in ${kind} ${short(amount)} mg/ml`);
      }
    }
    find("values").textContent = `${place} mm: ${parts.join("; ")}`;
  }

  const choice = find("quantity");
  [...scan.bases, "image at one energy"].forEach((name, number) => choice.add(new Option(name, number)));
  const choose = (number) => {
    state.quantity = number;
    choice.value = number;
    compute(); reset(); draw();
  };
  choice.addEventListener("change", () => choose(Number(choice.value)));
  const slider = find("energy-slider");
  slider.max = scan.energies.length - 1;
  slider.value = state.energy;
  slider.addEventListener("input", () => { state.energy = Number(slider.value); compute(); draw(); });
  find("unit").addEventListener("change", (event) => { state.hounsfield = event.target.value === "HU"; compute(); reset(); draw(); });
  find("axis").addEventListener("change", (event) => { state.axis = Number(event.target.value); draw(); });
  for (const name of ["window", "level"]) {
    find(name).addEventListener("change", (event) => {
      const value = Number(event.target.value);
      if (Number.isFinite(value) && (name === "level" || value > 0)) state[name] = value;
      draw();
    });
  }
  for (const button of document.querySelectorAll("[data-window]")) {
    button.addEventListener("click", () => {
      state.hounsfield = true;
      find("unit").value = "HU";
      compute();
      state.window = Number(button.dataset.window);
      state.level = Number(button.dataset.level);
      state.limit = state.window / 5;
      draw();
    });
  }
  find("reset").addEventListener("click", () => { reset(); draw(); });
  document.addEventListener("keydown", (event) => {
    if (event.target.tagName === "INPUT" || event.target.tagName === "SELECT") return;
    const moves = { ArrowRight: [2, 1], ArrowLeft: [2, -1], ArrowUp: [1, 1], ArrowDown: [1, -1], PageUp: [0, 1], PageDown: [0, -1] };
    if (moves[event.key]) { event.preventDefault(); move(...moves[event.key]); }
    const number = Number(event.key) - 1;
    if (event.key >= "1" && number <= scan.bases.length) choose(number);
    if (event.key === "r") { reset(); draw(); }
  });
  find("wait").remove();
  choose(0);
}
