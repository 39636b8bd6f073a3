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
    this.edgesShown = new Set(["fixed", "before", this.edgeSets.findLast((id) => !["fixed", "before"].includes(id))].filter((id) => this.edgeSets.includes(id)));
    const window = lead?.data.windows?.[0] ?? lead?.data, range = lead ? lead.data.high - lead.data.low : 1;
    this.reaches = [0.05, 0.1, 0.2, 0.5, 1].map((part) => Number((part * range).toPrecision(1)));
    Object.assign(this, {
      image: lead?.id, candidate: last, sideBySide: true, colourSafe: false, flickered: false, rate: 1, tile: 30, reach: this.reaches[2],
      playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, opacity: 0.6, ratio: this.ratios.fitting, arrowsShown: true, crosshair: true, zoom: 1, enlarged: null,
      window: { low: window?.low, high: window?.high }, positions: {}, wait: null,
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
    if (waits) {
      this.root.dataset.state = "decoding";
      this.readout.replaceChildren(element("div", {}, element("dt", {}, "Decoding the pictures …")));
    }
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
