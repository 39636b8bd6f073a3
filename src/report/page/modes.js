// What the viewer can show. Each mode: name; ready(v), whether its data are there; base(v), the volume whose grid is seen; volumes(v), the ids it needs;
// pair(v), the candidates of the two rows when they are side by side; title(v, panel); layers(v, panel, slice), [pixels, smooth] from back to front; controls(v); legend(v); aside(v), what stands beside the planes.

const greyLayer = (v, plane, id, slice) => [slicePixels(plane, v.volumes[id], slice, greyTable(v.volumes[id], v.window)), true];

/** A layer whose pixels come from two grey volumes, voxel by voxel. */
function mixedLayer(v, plane, first, second, slice, mix) {
  const a = v.volumes[first], b = v.volumes[second], { size } = a.space, pixels = new Uint32Array(size[plane.across] * size[plane.down]);
  walkSlice(plane, size, slice, (from, pixel, column, row) => (pixels[pixel] = mix(a.voxels[from], b.voxels[from], column, row)));
  return [pixels, true];
}

/** Magenta where det J is not positive: the transform folds. Null when it does not, as its data say by beginning above 0. */
function foldedLayer(v, plane, slice) {
  const volume = v.volumes.jacobian;
  if (volume.data.low >= 0) return null;
  const table = Uint32Array.from({ length: 256 }, (_, byte) => (byte && volume.value(byte) <= 0 ? packed(...channels(folded)) : 0));
  return [slicePixels(plane, volume, slice, table), false];
}

const scalarLegend = (volume, extra, range = colourRange(volume.data), openBoth = false) =>
  colourBar({ ...range, name: volume.name, unit: volume.data.unit, openEnd: volume.data.open_end || openBoth, openStart: (volume.data.open_start && range.low > 0) || openBoth, extra });
const ratioRange = (v) => ({ low: 1 - v.ratio, high: 1 + v.ratio, stops: blueWhiteOrange });
const opacityControl = (v) => slider("Opacity", { min: 0, max: 1, step: 0.05, value: v.opacity, show: (o) => `${Math.round(100 * o)} %` }, (o) => v.set({ opacity: o }));
const candidateControl = (v) => (v.candidates.length > 1 ? segmented("Compare with", v.candidates.map((c) => [c.id, c.name]), v.candidate, (id) => v.set({ candidate: id }), true) : null);
const pairControl = (v) => (v.mode.pair?.(v) ? toggle("Before and after", v.sideBySide, (on) => v.set({ sideBySide: on }, true)) : null);
const comparesFixed = (v) => v.volumes.fixed?.data.kind === "grey" && v.candidates.length > 0;
const beforeAndChosen = (v) => (v.candidates.some((c) => c.id === "before") && v.candidate !== "before" ? ["before", v.candidate] : null);
const shownCandidate = (v, panel) => panel.candidate ?? v.candidate;

const modes = {
  images: {
    name: "Images",
    ready: (v) => v.grey.length > 0,
    base: (v) => v.image,
    volumes: (v) => [v.image],
    title: (v) => v.nameOf(v.image),
    layers: (v, panel, slice) => [greyLayer(v, panel.plane, v.image, slice)],
    controls: (v) => [segmented("Image", v.grey.map((volume) => [volume.id, volume.name]), v.image, (id) => v.set({ image: id }), true)],
  },
  edges: {
    name: "Edges",
    ready: (v) => v.volumes.edges && v.volumes.fixed,
    base: () => "fixed",
    volumes: () => ["fixed", "edges"],
    pair: (v) => (v.edgeSets.includes("before") && v.edgeSets.some((id) => !["fixed", "before"].includes(id)) ? ["before", "after"] : null),
    title: (v, panel) => ({ before: "Before", after: "After" })[panel.candidate] ?? "",
    layers(v, panel, slice) {
      const shown = new Set([...v.edgesShown].filter((id) => id === "fixed" || !panel.candidate || (id === "before") === (panel.candidate === "before")));
      const table = edgeTable(v.volumes.edges.data.bits, shown, edgePalettes[v.colourSafe ? "safe" : "papers"]);
      return [greyLayer(v, panel.plane, "fixed", slice), [slicePixels(panel.plane, v.volumes.edges, slice, table), false]];
    },
    controls: (v) => [
      element("fieldset", { class: "field" }, element("legend", {}, "Edges of"), v.edgeSets.map((id) => toggle(v.nameOf(id), v.edgesShown.has(id), (on) => {
        v.edgesShown[on ? "add" : "delete"](id);
        v.set({});
      }))),
      pairControl(v),
      toggle("Colour-blind safe", v.colourSafe, (on) => v.set({ colourSafe: on })),
    ],
    legend(v) {
      const palette = edgePalettes[v.colourSafe ? "safe" : "papers"], registered = v.edgeSets.filter((id) => edgeRole(id) === "registered" && v.edgesShown.has(id));
      const names = { fixed: "Fixed image (target)", before: "Moving image before (source)", rigid: "Rigidly registered", registered: registered.map((id) => v.nameOf(id)).join(", ").replace(/^(?!Registered$).*/, "$& (registered)") };
      const roles = ["before", "fixed", "rigid", "registered"].filter((role) => v.edgeSets.some((id) => edgeRole(id) === role && v.edgesShown.has(id)));
      const met = roles.includes("fixed") && roles.some((role) => ["rigid", "registered"].includes(role));
      return element("div", { class: "legend" }, roles.map((role) => swatch(palette[role], names[role])), met ? swatch(palette.coincide, "Registered and fixed coincide") : null);
    },
  },
  flicker: {
    name: "Flicker",
    ready: comparesFixed,
    base: () => "fixed",
    volumes: (v) => ["fixed", v.candidate],
    title: (v) => v.nameOf(v.flickered ? v.candidate : "fixed"),
    layers: (v, panel, slice) => [greyLayer(v, panel.plane, v.flickered ? v.candidate : "fixed", slice)],
    controls: (v) => [
      candidateControl(v),
      element("span", { class: "field" },
        button(v.playing ? "Pause" : "Play", () => v.set({ playing: !v.playing }, true)),
        button("Switch image", () => v.set({ playing: false, flickered: !v.flickered }, true))),
      choice("Changes per second", [[0.5, "0.5"], [1, "1"], [2, "2"]], v.rate, (rate) => v.set({ rate: Number(rate) })),
    ],
  },
  checkerboard: {
    name: "Checkerboard",
    ready: comparesFixed,
    base: () => "fixed",
    volumes: (v) => ["fixed", ...v.rows().map((id) => id ?? v.candidate)],
    pair: beforeAndChosen,
    title: (v, panel) => `Fixed / ${v.nameOf(shownCandidate(v, panel))}`,
    layers(v, panel, slice) {
      const id = shownCandidate(v, panel), tile = v.tile / v.volumes.fixed.space.spacing_mm, [a, b] = ["fixed", id].map((name) => greyTable(v.volumes[name], v.window));
      return [mixedLayer(v, panel.plane, "fixed", id, slice, (one, two, column, row) => ((Math.floor(column / tile) + Math.floor(row / tile)) % 2 ? b[two] : a[one]))];
    },
    controls: (v) => [candidateControl(v), pairControl(v), slider("Tile", { min: 5, max: 80, step: 5, value: v.tile, show: (mm) => `${mm} mm` }, (mm) => v.set({ tile: mm }))],
    legend: () => note("The tile in the top left corner is the fixed image, its neighbours are the other one. Where the images agree, structures run on across the tiles."),
  },
  difference: {
    name: "Difference",
    ready: comparesFixed,
    base: () => "fixed",
    volumes: (v) => ["fixed", ...v.rows().map((id) => id ?? v.candidate)],
    pair: beforeAndChosen,
    title: (v, panel) => `Fixed − ${v.nameOf(shownCandidate(v, panel))}`,
    layers(v, panel, slice) {
      const [a, b] = [v.volumes.fixed, v.volumes[shownCandidate(v, panel)]];
      const colours = Uint32Array.from({ length: 512 }, (_, t) => packed(...mapped(blueWhiteOrange, t / 510)));
      const [of, to] = [a, b].map((volume) => Float32Array.from({ length: 256 }, (_, byte) => volume.value(byte)));
      return [mixedLayer(v, panel.plane, a.id, b.id, slice, (one, two) => colours[Math.round(255 + 255 * Math.min(Math.max((of[one] - to[two]) / v.reach, -1), 1))])];
    },
    controls: (v) => [candidateControl(v), pairControl(v), choice("Range", v.reaches.map((r) => [r, `± ${brief(r)} ${v.volumes.fixed.data.unit ?? ""}`]), v.reach, (reach) => v.set({ reach: Number(reach) }))],
    legend: (v) => colourBar({ name: "Fixed − candidate", unit: v.volumes.fixed.data.unit, low: -v.reach, high: v.reach, stops: blueWhiteOrange }),
  },
  displacement: {
    name: "Displacement",
    ready: (v) => v.volumes.displacement,
    base: () => "displacement",
    volumes: (v) => ["fixed", "displacement"].filter((id) => v.volumes[id]),
    title: () => "",
    layers: (v, panel, slice) => [v.volumes.fixed ? greyLayer(v, panel.plane, "fixed", slice) : null, [slicePixels(panel.plane, v.volumes.displacement, slice, scalarTable(v.volumes.displacement, v.opacity)), true]],
    controls: (v) => [opacityControl(v), v.arrows ? toggle("Arrows", v.arrowsShown, (on) => v.set({ arrowsShown: on })) : null],
    legend: (v) => element("div", { class: "legends" }, scalarLegend(v.volumes.displacement),
      v.arrows && v.arrowsShown ? note(`Arrows begin where the tissue was in the moving image and end where it is in the fixed one, projected onto the plane, in true length; a dot where it hardly moved in the plane. They are ${brief(v.arrows.spacing)} mm apart, or a multiple of that where planes are small: zoom in or enlarge a plane to see all.`) : null),
    arrows: (v) => (v.arrowsShown ? v.arrows : null),
  },
  jacobian: {
    name: "Volume ratio",
    ready: (v) => v.volumes.jacobian,
    base: () => "jacobian",
    volumes: (v) => ["fixed", "jacobian"].filter((id) => v.volumes[id]),
    title: () => "",
    layers: (v, panel, slice) => [v.volumes.fixed ? greyLayer(v, panel.plane, "fixed", slice) : null, [slicePixels(panel.plane, v.volumes.jacobian, slice, scalarTable(v.volumes.jacobian, v.opacity, ratioRange(v))), true], foldedLayer(v, panel.plane, slice)],
    controls: (v) => [opacityControl(v), choice("Range", v.ratios.all.map((half) => [half, `1 ± ${brief(half)}`]), v.ratio, (half) => v.set({ ratio: Number(half) }))],
    legend: (v) => element("div", { class: "legends" }, scalarLegend(v.volumes.jacobian, [[folded, "folded (det J ≤ 0)"]], ratioRange(v), v.ratio < v.ratios.all.at(-1)), note("Determinant of the gradient of the map from fixed to moving: above 1 the tissue is smaller in the fixed image than in the moving one, below 1 larger.")),
  },
  shear: {
    name: "Shear modulus",
    ready: (v) => v.volumes.shear_modulus,
    base: () => "shear_modulus",
    volumes: (v) => ["moving", "shear_modulus"].filter((id) => v.volumes[id]),
    title: () => "Moving image",
    layers: (v, panel, slice) => [v.volumes.moving ? greyLayer(v, panel.plane, "moving", slice) : null, [slicePixels(panel.plane, v.volumes.shear_modulus, slice, scalarTable(v.volumes.shear_modulus, v.opacity)), true]],
    controls: (v) => [opacityControl(v)],
    legend: (v) => scalarLegend(v.volumes.shear_modulus),
    aside: (v) => (v.report.tissue?.classes?.length ? tissueTable(v.report.tissue) : null),
  },
};
