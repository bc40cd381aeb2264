// Runs a page of slices in Node, with as much of a browser as its program uses, and prints what it shows as JSON.
// node run_page.js PAGE PROGRAM STEPS, where STEPS is a JSON list: ["choose", 3], ["energy", 10], ["preset", 0],
// ["key", "ArrowUp"], ["click", panel, x, y] with parts of its width and height, ["wheel", panel, sign]
const fs = require("fs"), vm = require("vm");
const [, , page, program, steps] = process.argv;
const html = fs.readFileSync(page, "utf8");

class Element {
  constructor(tag = "DIV") { Object.assign(this, { tagName: tag.toUpperCase(), listeners: {}, children: [], dataset: {}, value: "", textContent: "", hidden: false, images: [], texts: [] }); }
  addEventListener(name, run) { this.listeners[name] = run; }
  fire(name, event = {}) { this.listeners[name]({ target: this, preventDefault() {}, ...event }); }
  append(...all) { this.children.push(...all); }
  add(option) { this.children.push(option); }
  remove() { this.removed = true; }
  setPointerCapture() {}
  getBoundingClientRect() { return { left: 0, top: 0, width: this.width, height: this.height }; }
  getContext() {
    const element = this, nothing = () => {};
    return new Proxy({}, {
      get: (_, name) => ({
        putImageData: (image) => { element.image = image; },
        drawImage: (other) => { element.image = other.image; },
        fillText: (text) => { element.texts.push(text); },
      }[name] || nothing),
      set: () => true,
    });
  }
}

const known = {};
for (const [, id] of html.matchAll(/ id="([^"]+)"/g)) known[id] = new Element();
known.data.textContent = html.match(/<script id="data"[^>]*>([\s\S]*?)<\/script>/)[1];
const buttons = [...html.matchAll(/data-window="(\d+)" data-level="(\d+)"/g)].map(([, window, level]) => Object.assign(new Element("button"), { dataset: { window, level } }));
const listeners = {};
const document = {
  getElementById: (id) => known[id],
  createElement: (tag) => new Element(tag),
  querySelectorAll: () => buttons,
  addEventListener: (name, run) => { listeners[name] = run; },
};
class ImageData { constructor(width, height) { Object.assign(this, { width, height, data: new Uint8ClampedArray(4 * width * height) }); } }
class Option { constructor(text, value) { Object.assign(this, { text, value }); } }

(async () => {
  vm.runInNewContext(fs.readFileSync(program, "utf8"), { document, ImageData, Option, Blob, Response, DecompressionStream, Uint8Array, Float32Array, DataView, atob, JSON, Math, Number, Object, Promise, Array, Infinity });
  await listeners.DOMContentLoaded();
  const canvases = known.panels.children.map((figure) => figure.children[1]);
  const point = (panel, x, y) => ({ button: 0, pointerId: 1, clientX: x * canvases[panel].width, clientY: y * canvases[panel].height });
  const run = {
    choose: (number) => { known.quantity.value = number; known.quantity.fire("change"); },
    energy: (index) => { known["energy-slider"].value = index; known["energy-slider"].fire("input"); },
    unit: (name) => { known.unit.value = name; known.unit.fire("change"); },
    preset: (number) => buttons[number].fire("click"),
    key: (key) => listeners.keydown({ key, target: new Element(), preventDefault() {} }),
    click: (panel, x, y) => canvases[panel].fire("pointerdown", point(panel, x, y)),
    wheel: (panel, sign) => canvases[panel].fire("wheel", { deltaY: sign }),
  };
  for (const [name, ...values] of JSON.parse(steps)) run[name](...values);
  const panels = known.panels.children.map((figure, i) => ({ caption: figure.children[0].textContent, width: canvases[i].image.width, height: canvases[i].image.height, data: [...canvases[i].image.data], texts: canvases[i].texts.slice(-5) }));
  console.log(JSON.stringify({ panels, values: known.values.textContent, window: known.window.value, level: known.level.value, energy: known["energy-text"].textContent, energyHidden: known.energy.hidden, choices: known.quantity.children.map((option) => option.text), unpacked: known.wait.removed === true }));
})();
