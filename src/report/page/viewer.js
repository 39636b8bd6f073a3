/** The three linked planes. Positions are in mm, one per space; whatever changes goes through set(). */
class Viewer {
  constructor(report) {
    const { spaces, volumes, arrows } = report.view;
    this.report = report;
    this.volumes = Object.fromEntries(volumes.map((data) => [data.id, new Volume(data, { id: data.space, ...spaces[data.space] })]));
    this.grey = Object.values(this.volumes).filter((volume) => volume.data.kind === "grey");
    this.arrows = arrows ? new Arrows(arrows) : null;
    this.candidates = (report.candidates ?? []).filter((c) => this.volumes[c.id]?.data.kind === "grey" && this.volumes[c.id].data.space === "fixed");
    this.edgeSets = this.volumes.edges ? Object.values(this.volumes.edges.data.bits) : [];
    this.ratios = ratioRanges(this.volumes.jacobian?.data, report.jacobian);
    const last = this.candidates.at(-1)?.id ?? null, lead = this.volumes.fixed ?? this.grey[0];
    this.edgesShown = new Set(this.edgeSets.filter((id) => id !== "rigid" || !this.edgeSets.some((other) => edgeRole(other) === "registered")));
    const range = lead ? lead.data.high - lead.data.low : 1;
    this.reaches = [0.05, 0.1, 0.2, 0.5, 1].map((part) => Number((part * range).toPrecision(1)));
    Object.assign(this, {
      image: lead?.id, candidate: last, sideBySide: true, colourSafe: false, flickered: false, rate: 1, tile: 30, reach: this.reaches[2],
      playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, opacity: 0.6, ratio: this.ratios.fitting, arrowsShown: true, crosshair: true, zoom: 1, enlarged: null,
      window: lead ? this.windowOf(lead, 0) : { low: 0, high: 1 }, positions: {}, wait: null,
    });
    for (const [id, { size, spacing_mm: s, origin_mm: o }] of Object.entries(spaces)) this.positions[id] = size.map((n, a) => o[a] + s * Math.floor(n / 2));
    this.modes = Object.entries(modes).filter(([, mode]) => mode.ready(this));
    this.modeName = (this.modes.find(([id]) => id === "edges") ?? this.modes[0])?.[0];
    this.build();
  }

  get mode() {
    return modes[this.modeName];
  }

  get space() {
    return this.volumes[this.mode.base(this)].space;
  }

  nameOf(id) {
    return (this.report.candidates ?? []).find((c) => c.id === id)?.name ?? this.volumes[id]?.name ?? { fixed: "Fixed", before: "Before", rigid: "Rigid" }[id] ?? id;
  }

  windowOf(volume, index) {
    const { low, high } = volume.data.windows?.[index] ?? volume.data;
    return { low, high };
  }

  /** The candidates of the rows of planes; [null] when there is one row. */
  rows() {
    const pair = this.sideBySide ? this.mode.pair?.(this) : null;
    return pair ?? [null];
  }

  build() {
    this.controls = element("div", { class: "controls" });
    this.grid = element("div", { class: "planes" });
    this.readout = element("dl", { class: "readout", "aria-live": "off" });
    this.legend = element("div", { class: "viewer-legend" });
    this.aside = element("div", { class: "aside" });
    this.message = element("p", { class: "notice bad", role: "alert", hidden: true });
    this.root = element("div", { class: "viewer" },
      segmented("What the viewer shows", this.modes.map(([id, mode]) => [id, mode.name]), this.modeName, (id) => this.change(id)),
      this.controls, this.message, this.legend, this.readout, element("div", { class: "beside" }, element("div", { class: "planes-box" }, this.grid), this.aside),
      note("Click or drag in a plane to move all three. Then the wheel or the arrow keys step through its slices; Page Up and Page Down step by ten."));
    this.root.addEventListener("keydown", (event) => event.key === "Escape" && this.enlarged && this.set({ enlarged: null }, true));
    new ResizeObserver(() => this.redraw()).observe(this.grid);
    document.addEventListener("visibilitychange", () => this.schedule());
  }

  /** Another mode. When that is in the other space, the position goes along with the tissue where v is known. */
  change(id) {
    const from = this.space;
    this.modeName = id;
    if (from.id === "fixed" && this.space.id === "moving") {
      const here = this.positions.fixed, v = this.arrows?.between(here);
      if (v) this.moveTo(here.map((p, a) => p + v[a]), false);
    }
    return this.set({}, true);
  }

  /** Changes the state and draws; `rebuild` when planes or controls change, too. Resolves when all is drawn. */
  async set(changes, rebuild = false) {
    const { image, candidate } = this;
    Object.assign(this, changes);
    if (rebuild || image !== this.image || candidate !== this.candidate) this.arrange();
    const wanted = this.mode.volumes(this).map((id) => this.volumes[id]);
    const waits = wanted.some((volume) => !volume.voxels);
    if (waits) this.root.dataset.state = "decoding";
    try {
      await Promise.all(wanted.map((volume) => volume.load()));
      this.message.hidden = true;
    } catch (error) {
      this.message.hidden = false;
      this.message.textContent = `This view cannot be shown: ${error.message}.`;
      showProblem("Viewer", error);
    }
    this.legend.replaceChildren(...[this.mode.legend?.(this)].filter(Boolean));
    this.draw();
    this.root.dataset.mode = this.modeName;
    this.root.dataset.state = "drawn";
    this.schedule();
  }

  /** Builds controls and planes for the mode; what had the focus keeps it. */
  arrange() {
    const usable = () => [...this.controls.querySelectorAll("input, select, button"), ...this.grid.querySelectorAll("button")];
    const focused = document.activeElement, place = usable().indexOf(focused), plane = focused?.closest?.(".plane")?.querySelector("canvas").dataset.plane;
    const usesWindow = this.modeName !== "difference", lead = this.volumes[this.mode.base(this)].data.kind === "grey" ? this.volumes[this.mode.base(this)] : this.volumes.fixed ?? this.grey[0];
    this.controls.replaceChildren(...[...this.mode.controls(this), usesWindow && lead ? windowControls(this, lead) : null,
      slider("Zoom", { min: 1, max: 8, step: 0.5, value: this.zoom, show: (z) => `${z} ×` }, (zoom) => this.set({ zoom })),
      toggle("Crosshair", this.crosshair, (on) => this.set({ crosshair: on }))].filter(Boolean));
    const rows = this.rows(), { size, spacing_mm: s } = this.space;
    const names = Object.keys(planes).filter((name) => !this.enlarged || name === this.enlarged);
    this.panels = rows.flatMap((candidate, row) => names.map((name) => new Panel(this, name, candidate, { first: row === 0, last: row === rows.length - 1 })));
    this.grid.replaceChildren(...this.panels.map((panel) => panel.root));
    this.aside.replaceChildren(...[this.mode.aside?.(this)].filter(Boolean));
    this.grid.classList.toggle("pair", rows.length > 1);
    this.grid.classList.toggle("enlarged", Boolean(this.enlarged));
    const widths = names.map((name) => Math.max(size[planes[name].across], 0.55 * Math.max(...size)));
    this.grid.style.setProperty("--columns", this.enlarged ? `repeat(${rows.length}, minmax(0, 1fr))` : widths.map((w) => `minmax(0, ${w * s}fr)`).join(" "));
    const slopes = names.map((name, i) => size[planes[name].down] / widths[i]), tallest = Math.max(...slopes);
    const share = this.enlarged ? rows.length : widths.reduce((a, b) => a + b) / widths[slopes.indexOf(tallest)];
    if (plane) this.grid.querySelector(`canvas[data-plane=${plane}]`)?.closest(".plane").querySelector("button").focus({ preventScroll: true });
    else if (place >= 0) usable()[place]?.focus({ preventScroll: true });
    this.grid.style.setProperty("--shown", names.length);
    this.grid.style.setProperty("--tallest", tallest.toFixed(3));
    this.grid.style.setProperty("--share", share.toFixed(3));
  }

  /** The position in voxels of the space seen, rounded. */
  voxel() {
    const { size, spacing_mm: s, origin_mm: o } = this.space;
    return this.positions[this.space.id].map((p, a) => Math.min(Math.max(Math.round((p - o[a]) / s), 0), size[a] - 1));
  }

  moveTo(point, draw = true) {
    const { id, size, spacing_mm: s, origin_mm: o } = this.space;
    this.positions[id] = point.map((p, a) => Math.min(Math.max(p, o[a]), o[a] + s * (size[a] - 1)));
    if (!draw) return;
    this.redraw();
    this.lookUp();
  }

  /** Steps along an axis by whole voxels. */
  step(axis, by) {
    const { spacing_mm: s, origin_mm: o } = this.space;
    this.moveTo(this.voxel().map((n, a) => o[a] + s * (n + (a === axis ? by : 0))));
  }

  /** Decodes in the background what the readout needs, once the reader asks for places. */
  async lookUp() {
    if (this.asked) return;
    this.asked = true;
    for (const volume of Object.values(this.volumes))
      if (volume.data.kind !== "bits") await volume.load().catch((error) => showProblem("Viewer", error));
    this.redraw();
  }

  redraw() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      attempt("The viewer", () => this.draw());
    });
  }

  draw() {
    if (!this.panels || this.mode.volumes(this).some((id) => !this.volumes[id].voxels)) return;
    for (const panel of this.panels) panel.draw();
    this.readout.replaceChildren(...readings(this));
  }

  /** Starts or stops the flicker, which runs at most twice a second and not while the page is hidden. */
  schedule() {
    clearTimeout(this.wait);
    if (this.modeName !== "flicker" || !this.playing || document.hidden) return;
    this.wait = setTimeout(() => {
      this.flickered = !this.flickered;
      this.redraw();
      this.schedule();
    }, 1000 / this.rate);
  }
}

/** Half widths around 1 that the colours of the volume ratio may span; the fitting one holds 98 % of the body where its percentiles are known. */
function ratioRanges(data, jacobian) {
  if (!data) return { all: [], fitting: 0 };
  const { low, high } = colourRange(data), whole = (high - low) / 2, all = [...[0.05, 0.1, 0.2, 0.5].filter((half) => half < whole), whole];
  const needed = jacobian ? Math.max(Math.abs(jacobian.percentile_1 - 1), Math.abs(jacobian.percentile_99 - 1)) : whole;
  return { all, fitting: all.find((half) => half >= needed) ?? whole };
}

/** Presets and ends of the grey window. */
function windowControls(v, volume) {
  const { windows = [], unit = "" } = volume.data, full = { name: "Full range", low: volume.data.low, high: volume.data.high };
  const presets = [...windows, full], same = presets.findIndex((w) => w.low === v.window.low && w.high === v.window.high);
  const end = (name, key) => element("input", { type: "number", value: v.window[key], step: "any", "aria-label": `${name} end of the grey window${unit ? `, ${unit}` : ""}`, change: (e) => {
    if (e.target.value !== "") v.set({ window: { ...v.window, [key]: Number(e.target.value) } }, true);
  } });
  return element("span", { class: "field" },
    choice("Window", [...presets.map((w, i) => [i, w.name]), ...(same < 0 ? [["own", "Own"]] : [])], same < 0 ? "own" : same, (i) => presets[i] && v.set({ window: { low: presets[i].low, high: presets[i].high } }, true)),
    element("span", { class: "ends" }, end("Lower", "low"), " to ", end("Upper", "high"), ` ${unit}`));
}

/** What is known at the position, as entries of a list. */
function readings(v) {
  const point = v.positions[v.space.id], voxel = v.voxel(), entries = [["Position (LPS)", `${point.map((p) => decimals(p, 1)).join(", ")} mm`]];
  for (const volume of Object.values(v.volumes)) {
    if (!volume.voxels || volume.data.kind === "bits" || volume.data.space !== v.space.id) continue;
    const value = volume.value(volume.byteAt(voxel)), { kind, unit, high, open_end: open } = volume.data;
    entries.push([volume.name, value === null ? "–" : `${open && value >= high ? "≥ " : ""}${decimals(value, kind === "grey" ? 0 : 2)} ${volume.id === "jacobian" ? "" : unit ?? ""}`.trim()]);
  }
  const vector = v.space.id === "fixed" ? v.arrows?.between(point) : null;
  if (vector) entries.push(["v (to the moving image)", `${vector.map((c) => decimals(c, 1)).join(", ")} mm`]);
  return entries.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value)));
}

/** One plane: its canvas, slider and button to enlarge it. */
class Panel {
  constructor(viewer, name, candidate, { first, last }) {
    Object.assign(this, { viewer, name, candidate, plane: planes[name] });
    const { normal } = this.plane, { size } = viewer.space;
    this.canvas = element("canvas", { tabindex: 0, role: "img", "data-plane": name, "data-row": candidate ?? "" });
    this.slider = element("input", { type: "range", min: 0, max: size[normal] - 1, step: 1, "aria-label": `${this.plane.name} slice`, input: (e) => viewer.step(normal, Number(e.target.value) - viewer.voxel()[normal]) });
    this.place = element("output", {});
    const larger = viewer.enlarged === name;
    this.root = element("figure", { class: first ? "plane" : "plane later", style: `--own:${(size[this.plane.down] / size[this.plane.across]).toFixed(3)}` },
      element("figcaption", {}, element("b", {}, this.plane.name), this.place,
        button(svg("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, svg("path", { d: larger ? "M6.5 2v4.5H2M9.5 14V9.5H14M6.5 6.5 2 2M9.5 9.5 14 14" : "M9.5 2H14v4.5M6.5 14H2V9.5M14 2 9.5 6.5M2 14l4.5-4.5" })), () => viewer.set({ enlarged: larger ? null : name }, true),
          { class: "icon", title: larger ? "Show all planes (Escape)" : "Enlarge this plane", "aria-label": larger ? "Show all planes" : `Enlarge the ${name} plane` })),
      element("div", { class: "canvas-box" }, this.canvas), last || viewer.enlarged ? this.slider : null);
    this.listen();
  }

  listen() {
    const { canvas, viewer, plane } = this, { normal } = plane;
    let dragging = false;
    const go = (event) => {
      const bounds = canvas.getBoundingClientRect(), factor = canvas.width / bounds.width;
      const [across, down] = underCanvas(this.view, (event.clientX - bounds.left) * factor, (event.clientY - bounds.top) * factor);
      const { origin_mm: o, spacing_mm: s } = viewer.space, point = [...viewer.positions[viewer.space.id]];
      point[plane.across] = o[plane.across] + s * across;
      point[plane.down] = o[plane.down] + s * down;
      viewer.moveTo(point);
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.view) return;
      dragging = true;
      viewer.held = viewer.voxel();
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      go(event);
    });
    canvas.addEventListener("pointermove", (event) => dragging && go(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => {
      dragging = false;
      viewer.held = null;
      viewer.redraw();
    });
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas || event.ctrlKey) return;
      event.preventDefault();
      viewer.step(normal, event.deltaY < 0 ? 1 : -1);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -1e6, End: 1e6 }[event.key];
      if (!by) return;
      event.preventDefault();
      viewer.step(normal, by);
    });
  }

  draw() {
    const { canvas, viewer, plane } = this, dpr = devicePixelRatio || 1, { size, spacing_mm: s, origin_mm: o } = viewer.space;
    const [width, height] = [canvas.parentElement.clientWidth, canvas.parentElement.clientHeight].map((n) => Math.max(1, Math.round(n * dpr)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const pen = canvas.getContext("2d"), voxel = viewer.voxel(), slice = voxel[plane.normal], place = viewer.positions[viewer.space.id].map((p, a) => (p - o[a]) / s);
    this.view = layOut(plane, size, width, height, viewer.zoom, viewer.held ?? voxel);
    pen.fillStyle = "#000";
    pen.fillRect(0, 0, width, height);
    for (const layer of viewer.mode.layers(viewer, this, slice)) if (layer) drawLayer(pen, this.view, size, ...layer);
    const arrows = viewer.mode.arrows?.(viewer);
    if (arrows) drawArrows(pen, this.view, viewer.space, arrows, slice, dpr);
    if (viewer.crosshair) drawCrosshair(pen, onCanvas(this.view, place), dpr);
    const title = viewer.mode.title(viewer, this);
    drawFrame(pen, plane, this.view, s, dpr, title);
    this.slider.value = slice;
    const mm = viewer.positions[viewer.space.id][plane.normal], side = mm < 0 ? plane.sides[0] : plane.sides[1];
    this.place.textContent = `${"xyz"[plane.normal]} ${decimals(mm, 1)} mm · ${slice + 1} / ${size[plane.normal]}`;
    this.slider.setAttribute("aria-valuetext", `slice ${slice + 1} of ${size[plane.normal]}, ${decimals(Math.abs(mm), 1)} mm ${side}`);
    canvas.setAttribute("aria-label", `${plane.name} plane${title ? `, ${title}` : ""}, slice ${slice + 1} of ${size[plane.normal]}. Arrow keys step through the slices.`);
  }
}
