/** The cloud of nodes at rest and deformed: drag to turn, nearer nodes cover farther ones. */
class Cloud {
  constructor(nodes) {
    const rest = int16FromBase64(nodes.rest), moved = int16FromBase64(nodes.displacement), n = Math.floor(rest.length / 3), scale = nodes.scale_mm;
    this.n = n;
    this.rest = Float32Array.from(rest, (v, i) => nodes.origin_mm[i % 3] + v * scale);
    this.u = Float32Array.from(moved, (v) => v * scale);
    const size = Float32Array.from({ length: n }, (_, i) => Math.hypot(...this.u.subarray(3 * i, 3 * i + 3))), largest = size.reduce((a, b) => Math.max(a, b), 0) || 1;
    this.label = nodes.label && nodes.labels ? fromBase64(nodes.label) : null; // 0, or 1 + index of the number
    this.numbers = [0, ...(nodes.labels ?? [])];
    this.fields = [{ name: "Displacement |u|", unit: "mm", low: 0, high: largest, at: (i) => size[i] / largest },
      ...(nodes.scalars ?? []).map((scalar) => ({ ...scalar, bytes: fromBase64(scalar.data) })).map((scalar) => ({ ...scalar, at: (i) => scalar.bytes[i] / 255 }))];
    const ends = [0, 1, 2].map((a) => {
      let low = Infinity, high = -Infinity;
      for (let i = a; i < 3 * n; i += 3) {
        low = Math.min(low, this.rest[i], this.rest[i] + this.u[i]);
        high = Math.max(high, this.rest[i], this.rest[i] + this.u[i]);
      }
      return [low, high];
    });
    this.centre = ends.map(([low, high]) => (low + high) / 2);
    this.radius = Math.hypot(...ends.map(([low, high]) => high - low)) / 2 || 1;
    Object.assign(this, { turn: 0.5, tilt: 0.12, deformed: 1, shown: "0", bonesOnly: false });
    this.build(nodes);
  }

  build(nodes) {
    this.canvas = element("canvas", { tabindex: 0, role: "img", "aria-label": "Nodes of the mechanical model in space. Arrow keys turn it." });
    this.legend = element("div", { class: "viewer-legend" });
    const colours = [...this.fields.map((field, i) => [String(i), field.name]), ...(this.label?.some(Boolean) ? [["label", "Rigid label"]] : [])];
    const look = (turn, tilt) => () => this.set({ turn, tilt });
    this.root = element("div", { class: "cloud" },
      element("div", { class: "controls" }, segmented("Colour", colours, "0", (shown) => this.set({ shown }), true),
        slider("Rest to deformed", { min: 0, max: 1, step: 0.02, value: 1, show: (t) => `${Math.round(100 * t)} %` }, (deformed) => this.set({ deformed })),
        this.label?.some(Boolean) ? toggle("Rigid labels only", false, (bonesOnly) => this.set({ bonesOnly })) : null,
        element("span", { class: "field" }, element("span", {}, "From"), button("Front", look(0, 0)), button("Left", look(-Math.PI / 2, 0)), button("Back", look(Math.PI, 0)), button("Head", look(0, -Math.PI / 2)))),
      element("div", { class: "cloud-box" }, this.canvas), this.legend,
      note(`${count(nodes.shown ?? this.n)} of ${count(nodes.count)} nodes are drawn. Drag, or use the arrow keys, to turn. L, P, H: the patient's left, back and head.`));
    let last = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      this.set({ turn: this.turn + (event.clientX - last[0]) / 120, tilt: this.tilt + (event.clientY - last[1]) / 120 });
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => (last = null));
    this.canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (!by) return;
      event.preventDefault();
      this.set({ turn: this.turn + by[0], tilt: this.tilt + by[1] });
    });
    new ResizeObserver(() => this.redraw()).observe(this.canvas.parentElement);
    waiting.push(() => this.set({}));
  }

  set(changes) {
    Object.assign(this, changes);
    this.tilt = Math.min(Math.max(this.tilt, -Math.PI / 2), Math.PI / 2);
    if ("shown" in changes || !this.legend.hasChildNodes()) this.legend.replaceChildren(this.key());
    this.redraw();
  }

  key() {
    if (this.shown === "label") return element("div", { class: "legend" }, this.numbers.map((number, i) => swatch(labelColour(i), number ? String(number) : "Soft tissue")));
    const field = this.fields[Number(this.shown)];
    return colourBar({ ...field, openEnd: field.open_end, stops: viridis });
  }

  redraw() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      attempt("The cloud of nodes", () => this.draw());
    });
  }

  /** Screen axes of the view in LPS: right, down and away from the reader. Turn 0, tilt 0 looks at the patient's front. */
  axes() {
    const [ct, st, cp, sp] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
    return [[ct, -st, 0], [st * sp, ct * sp, -cp], [st * cp, ct * cp, sp]];
  }

  draw() {
    const { canvas } = this, dpr = devicePixelRatio || 1, [width, height] = [canvas.parentElement.clientWidth, canvas.parentElement.clientHeight].map((n) => Math.max(1, Math.round(n * dpr)));
    Object.assign(canvas, { width, height });
    const pen = canvas.getContext("2d"), image = pen.createImageData(width, height), pixels = new Uint32Array(image.data.buffer), depth = new Float32Array(width * height).fill(Infinity);
    const scale = (0.59 * Math.min(1.35 * width, height)) / this.radius, [right, down, away] = this.axes(), full = Math.max(1, Math.round(1.4 * dpr));
    const field = this.fields[Number(this.shown)], table = field ? Array.from({ length: 256 }, (_, i) => mapped(viridis, i / 255)) : this.numbers.map((_, i) => channels(labelColour(i)));
    const { rest, u, label, deformed, centre: [cx, cy, cz] } = this;
    for (let i = 0; i < this.n; ++i) {
      if (this.bonesOnly && !label[i]) continue;
      const x = rest[3 * i] + deformed * u[3 * i] - cx, y = rest[3 * i + 1] + deformed * u[3 * i + 1] - cy, z = rest[3 * i + 2] + deformed * u[3 * i + 2] - cz;
      const far = away[0] * x + away[1] * y + away[2] * z, inside = !field && !label[i];
      const dot = inside ? full >> 1 : full, order = inside ? far + 3 * this.radius : far; // coloured by label, bones show through soft tissue
      const px = Math.round(width / 2 + scale * (right[0] * x + right[1] * y + right[2] * z)), py = Math.round(height / 2 + scale * (down[0] * x + down[1] * y + down[2] * z));
      const colour = table[field ? Math.round(255 * Math.min(field.at(i), 1)) : label[i]], light = 0.86 - 0.14 * (far / this.radius);
      const pixel = packed(Math.min(255, colour[0] * light), Math.min(255, colour[1] * light), Math.min(255, colour[2] * light));
      for (let v = Math.max(0, py - dot); v <= Math.min(height - 1, py + dot); ++v)
        for (let h = Math.max(0, px - dot); h <= Math.min(width - 1, px + dot); ++h)
          if (order < depth[v * width + h]) {
            depth[v * width + h] = order;
            pixels[v * width + h] = pixel;
          }
    }
    pen.putImageData(image, 0, 0);
    this.triad(pen, dpr, right, down);
  }

  /** The patient's axes in the corner. */
  triad(pen, dpr, right, down) {
    const [x, y, length] = [44 * dpr, pen.canvas.height - 44 * dpr, 24 * dpr];
    pen.strokeStyle = pen.fillStyle = "#76828e"; // readable on light and dark
    pen.lineWidth = 1.5 * dpr;
    pen.font = `600 ${12 * dpr}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    ["L", "P", "H"].forEach((letter, axis) => {
      const [dx, dy] = [right[axis], down[axis]];
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x + length * dx, y + length * dy);
      pen.stroke();
      if (Math.hypot(dx, dy) > 0.25) pen.fillText(letter, x + 1.5 * length * dx, y + 1.5 * length * dy);
    });
  }
}

/** A colour of its own for every rigid label, by its place among them from 1; grey for soft tissue, 0. */
function labelColour(place) {
  if (!place) return "#8a949e";
  const hue = (place * 137.508) % 360, part = (n) => {
    const k = (n + hue / 30) % 12;
    return Math.round(255 * (0.58 - 0.34 * Math.max(-1, Math.min(k - 3, 9 - k, 1)))).toString(16).padStart(2, "0");
  };
  return `#${part(0)}${part(8)}${part(4)}`;
}
