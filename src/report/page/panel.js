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
