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
    const value = volume.value(volume.byteAt(voxel)), { kind, unit, low, high, open_start: below, open_end: above } = volume.data;
    const beyond = above && value >= high ? "≥ " : below && value <= low ? "≤ " : "";
    entries.push([volume.name, value === null ? "–" : `${beyond}${decimals(value, kind === "grey" ? 0 : 2)} ${volume.id === "jacobian" ? "" : unit ?? ""}`.trim()]);
  }
  const vector = v.space.id === "fixed" ? v.arrows?.between(point) : null;
  if (vector) entries.push(["v (to the moving image)", `${vector.map((c) => decimals(c, 1)).join(", ")} mm`]);
  return entries.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value)));
}
