const withData = (report, part) => (report.candidates ?? []).filter((c) => report[part]?.[c.id]);

/** Percentile curves of the Hausdorff distance between edges, with their table. */
function edgesSection(report) {
  const candidates = withData(report, "edges");
  if (!candidates.length) return null;
  const first = report.edges[candidates[0].id], settings = report.edge_settings, both = candidates.every((c) => report.edges[c.id].hausdorff_1_to_100_all_edges_mm);
  const state = { all: both, log: false };
  const place = element("div", {});
  const draw = () => {
    const key = state.all ? "hausdorff_1_to_100_all_edges_mm" : "hausdorff_1_to_100_mm", at = state.all ? "hausdorff_all_edges_mm" : "hausdorff_mm";
    const series = candidates.map((c) => ({ name: c.name, style: seriesIndex(report.candidates, c.id), every: 10, direct: true, points: (report.edges[c.id][key] ?? []).map((mm, i) => [i + 1, mm]) }));
    const high = Math.max(1, ...series.flatMap((s) => s.points.map((p) => p[1])).filter(known)), y = state.log ? symlog(high * 1.1) : linear(0, high * 1.05);
    const percents = first.percent?.every(known) ? first.percent : [60, 75, 85, 95];
    discardCharts(place);
    place.replaceChildren(
      lineChart({ label: `Hausdorff distance over percentile, ${state.all ? "all" : "consistent"} edges`, height: 380, x: { ...linear(0, 100), title: "Percentile of edge voxels [%]", marks: [0, 20, 40, ...percents, 100] },
        y: { ...y, title: `Hausdorff distance [mm], ${state.all ? "all edges" : "consistent edges"}` }, series,
        guides: [...percents.map((x) => ({ x })), ...(known(first.two_voxels_mm) && first.two_voxels_mm <= y.high ? [{ y: first.two_voxels_mm, name: `two voxels, ${brief(first.two_voxels_mm)} mm` }] : [])],
        show: (mm) => `${decimals(mm)} mm`, stop: (p) => `${p} % of the edges` }),
      dataTable(`Percentile Hausdorff distance [mm] of ${state.all ? "all" : "consistent"} edges, and shares of edges`, [
        { name: "", text: true, show: (c) => [seriesKey(seriesIndex(report.candidates, c.id)), ` ${c.name}`] },
        ...percents.map((p, i) => ({ name: `${p} %`, group: "Hausdorff distance [mm] at percentile", show: (c) => decimals(report.edges[c.id][at]?.[i]) })),
        { name: "Modified Hausdorff", unit: "mm", group: "All edges", title: "Mean distance of all edges to those of the other image, where more than 10 mm count as 10 mm; the larger of the two directions", show: (c) => decimals(report.edges[c.id].modified_hausdorff_mm) },
        { name: "Within two voxels", group: "All edges", show: (c) => percent(report.edges[c.id].within_two_voxels_all_edges) },
        { name: "Within two voxels", group: "Consistent edges", show: (c) => percent(report.edges[c.id].within_two_voxels) },
        { name: "Fixed", group: "Share that is consistent", show: (c) => percent(report.edges[c.id].consistent_fraction?.[0]) },
        { name: "Other", group: "Share that is consistent", show: (c) => percent(report.edges[c.id].consistent_fraction?.[1]) },
      ], candidates));
    if (place.isConnected) drawWaiting();
  };
  draw();
  const change = (part) => {
    Object.assign(state, part);
    draw();
  };
  return section("edges", "Distance between edges",
    element("div", { class: "controls" }, both ? segmented("Edges counted", [["all", "All edges"], ["consistent", "Consistent edges"]], "all", (v) => change({ all: v === "all" }), true) : null,
      segmented("Distance axis", [["linear", "Linear"], ["log", "Logarithmic"]], "linear", (v) => change({ log: v === "log" }), true)),
    place,
    note(`A point (p, d) of a curve: p % of the edges of either image lie within d mm of an edge of the other. Consistent edges are those whose nearest neighbour points back at them within a voxel; leaving out the others hides large errors, so read both. `,
      settings ? `Canny edges, ${settings.edges ?? "3-D"}: Gaussian of ${brief(settings.canny_sigma_mm)} mm, thresholds ${brief(settings.canny_lower_per_mm)} and ${brief(settings.canny_upper_per_mm)} per mm.` : ""));
}

/** Landmark distances: a table, and their cumulative shares where every distance is known. */
function landmarksSection(report) {
  const candidates = withData(report, "landmarks");
  if (!candidates.length) return null;
  const series = candidates.filter((c) => report.landmarks[c.id].distances_mm?.some(known)).map((c) => {
    const sorted = report.landmarks[c.id].distances_mm.filter(known).sort((a, b) => a - b);
    return { name: c.name, style: seriesIndex(report.candidates, c.id), every: Math.max(1, Math.round(sorted.length / 8)), direct: false, points: [[0, 0], ...sorted.map((mm, i) => [mm, (100 * (i + 1)) / sorted.length])] };
  });
  const columns = [["Mean", "mean_mm"], ["Median", "median_mm"], ["95 %", "percentile_95_mm"], ["Largest", "max_mm"]];
  const chart = series.length ? lineChart({ label: "Share of landmarks within a distance", height: 280, series, x: { ...symlog(Math.max(1, ...series.map((s) => s.points.at(-1)[0])) * 1.05, 0.2), title: "Distance [mm], logarithmic above 0.2" }, y: { ...linear(0, 100), title: "Landmarks within the distance [%]" },
    show: (share) => (known(share) ? `${decimals(share, 0)} %` : "–"), stop: (mm) => `${decimals(mm)} mm`, valueAt: (points, mm) => points.findLast((p) => p[0] <= mm)?.[1] }) : null;
  return section("landmarks", "Landmarks", element("div", { class: chart ? "halves" : "" }, dataTable("Distances between corresponding landmarks [mm]", [
    { name: "", text: true, show: (c) => [seriesKey(seriesIndex(report.candidates, c.id)), ` ${c.name}`] },
    { name: "Points", show: (c) => count(report.landmarks[c.id].points) },
    ...columns.map(([name, key]) => ({ name, unit: "mm", show: (c) => decimals(report.landmarks[c.id][key]) })),
  ], candidates), chart));
}

/** Overlap and surface distances of labels, and how rigid each of them stays. */
function labelsSection(report) {
  const candidates = withData(report, "labels"), labels = [...new Set(candidates.flatMap((c) => report.labels[c.id].map((entry) => entry.label)))];
  const entry = (c, label) => report.labels[c.id].find((one) => one.label === label);
  const measures = [["Dice", "dice", 3], ["95 % Hausdorff [mm]", "hausdorff_95_mm", 2], ["Mean surface distance [mm]", "average_surface_distance_mm", 2]];
  const value = (row, c, key) => (row === "Mean" ? mean(labels.map((label) => entry(c, label)?.[key])) : entry(c, row)?.[key]);
  const overlap = labels.length ? dataTable("Overlap of the labels of the registered and the fixed image", [
    { name: "Label", text: true, show: (row) => String(row) },
    ...measures.flatMap(([group, key, places]) => candidates.map((c) => ({ name: c.name, group, show: (row) => decimals(value(row, c, key), places) }))),
  ], labels, { foot: "Mean" }) : null;
  const rigidity = report.rigidity?.length ? dataTable("How far the transform moves each label from its best rigid motion", [
    { name: "Label", text: true, show: (r) => String(r.label) },
    { name: "Voxels", show: (r) => count(r.voxels) },
    { name: "rms", unit: "mm", title: "Root of the mean square", show: (r) => decimals(r.rms_mm) },
    { name: "Largest", unit: "mm", show: (r) => decimals(r.largest_mm) },
    { name: "", text: true, show: (r) => deviationMark(r.rms_mm) },
  ], report.rigidity) : null;
  return section("labels", overlap && rigidity ? "Labels and rigidity" : overlap ? "Labels" : "Rigidity", overlap || rigidity ? element("div", { class: "tables" }, [overlap, rigidity].filter(Boolean)) : null);
}

const largestGoodDeviation = 0.5; // mm rms: more is warned of by the program, too

/** Whether a label follows its rigid motion. */
const deviationMark = (rms) => (!known(rms) ? null : rms > largestGoodDeviation ? mark("check", "Look at this one") : mark("good", "Rigid"));

/** Distances between the outlines of organs, the larger of both directions, and what has no distance. */
function contoursSection(report) {
  const names = Object.keys(report.contours ?? {}), candidates = (report.candidates ?? []).filter((c) => names.some((name) => report.contours[name][c.id]));
  if (!candidates.length) return null;
  const larger = (name, c, key) => {
    const both = Object.values(report.contours[name][c.id] ?? {}).map((direction) => direction[key]);
    return both.length && both.every(known) ? Math.max(...both) : null;
  };
  return section("contours", "Outlines of organs", dataTable("Distances between outlines in the slices [mm], the larger of both directions", [
    { name: "", text: true, show: (row) => row.name },
    { name: "", text: true, show: (row) => [seriesKey(seriesIndex(report.candidates, row.candidate.id)), ` ${row.candidate.name}`] },
    ...[["Mean", "mean_mm"], ["Median", "median_mm"], ["95 %", "percentile_95_mm"], ["Largest", "max_mm"]].map(([name, key]) => ({ name, unit: "mm", show: (row) => decimals(larger(row.name, row.candidate, key)) })),
    ...[["Fixed", "from_fixed"], ["Other", "to_fixed"]].map(([name, direction]) => ({ name, group: "Voxels without a counterpart", title: "Contour voxels in slices where the other image shows nothing of the organ: distances leave them out", show: (row) => count(report.contours[row.name][row.candidate.id]?.[direction]?.unmatched_voxels) })),
  ], names.flatMap((name) => candidates.map((candidate) => ({ name, candidate })))));
}

/** How far the displacement is from one that is known otherwise. */
function referenceSection(report) {
  const d = report.field_difference;
  if (!d) return null;
  const mm = (value) => (known(value) ? `${decimals(value, 3)} mm` : "–");
  return section("reference", "Difference from the reference", facts([["Points", count(d.points)], ["Mean", mm(d.mean_mm)], ["Median", mm(d.median_mm)], ["95 %", mm(d.percentile_95_mm)], ["99.5 %", mm(d.percentile_99_5_mm)], ["Largest", mm(d.max_mm)], ["Within 0.5 mm", percent(d.within_half_mm)]]));
}

/** What is known of the fields of the registrations that are compared. */
function fieldsBeside(report) {
  const fields = { ...Object.fromEntries(Object.entries(report.beside ?? {})), ...(report.beside ? { [report.candidates?.at(-1)?.id]: report } : {}) };
  const candidates = (report.candidates ?? []).filter((c) => fields[c.id]?.jacobian);
  const worst = (c) => Math.max(...(fields[c.id].rigidity ?? []).map((r) => r.rms_mm ?? 0));
  return candidates.length > 1 ? dataTable("Fields of the registrations that are compared", [
    { name: "", text: true, show: (c) => [seriesKey(seriesIndex(report.candidates, c.id)), ` ${c.name}`] },
    { name: "Folded voxels", show: (c) => count(fields[c.id].jacobian.folded_voxels) },
    { name: "Smallest", group: "Volume ratio", show: (c) => decimals(fields[c.id].jacobian.min, 3) },
    { name: "Largest", group: "Volume ratio", show: (c) => decimals(fields[c.id].jacobian.max, 3) },
    { name: "SD of log det J", show: (c) => decimals(fields[c.id].jacobian.sd_log, 3) },
    { name: "Worst label off rigid motion", unit: "mm", title: "Root of the mean square", show: (c) => (fields[c.id].rigidity?.length ? decimals(worst(c)) : "–") },
  ], candidates) : null;
}

/** Volume ratio and inverse consistency of the transform. */
function fieldSection(report) {
  const { jacobian: j, inverse_consistency: inverse } = report;
  const ratio = j ? [element("h3", {}, "Volume ratio det J"), facts([
    ["Folded voxels", known(j.folded_voxels) ? mark(j.folded_voxels > 0 ? "bad" : "good", count(j.folded_voxels)) : "–", "Voxels where det J is not positive"],
    ["Voxels judged", known(j.voxels) ? count(j.voxels) : null],
    ["Smallest", decimals(j.min, 3)], ["1 %", decimals(j.percentile_1, 3)], ["Median", decimals(j.median, 3)], ["99 %", decimals(j.percentile_99, 3)], ["Largest", decimals(j.max, 3)],
    ["SD of log det J", decimals(j.sd_log, 3), "Standard deviation of the logarithm where det J is positive"],
  ])] : null;
  const back = inverse ? [element("h3", {}, "Inverse consistency"), facts([["Mean", `${decimals(inverse.mean_mm, 3)} mm`], ["95 %", `${decimals(inverse.percentile_95_mm, 3)} mm`], ["Largest", `${decimals(inverse.max_mm, 3)} mm`], ["Voxels judged", known(inverse.voxels) ? count(inverse.voxels) : null]])] : null;
  return section("field", "Displacement field", ratio, back, fieldsBeside(report));
}

/** The rigid motion found for every label. */
function motionsSection(report) {
  if (!report.motions?.length) return null;
  return section("motions", "Motion of every label", dataTable("Rigid motion found, how well the images match under it, and how far the field is from it", [
    { name: "Label", text: true, show: (m) => String(m.label) },
    { name: "Rotation", unit: "°", show: (m) => decimals(m.angle_deg, 1) },
    { name: "Shift", unit: "mm", show: (m) => decimals(m.shift_mm, 1) },
    { name: "before", group: "Similarity", show: (m) => decimals(m.similarity_before) },
    { name: "after", group: "Similarity", show: (m) => decimals(m.similarity_after) },
    { name: "There and back", unit: "mm", title: "Inverse consistency of the motion", show: (m) => decimals(m.inverse_consistency_mm) },
    { name: "rms", unit: "mm", group: "Field off the rigid motion", show: (m) => decimals(m.rms_deviation_mm) },
    { name: "largest", unit: "mm", group: "Field off the rigid motion", show: (m) => decimals(m.largest_deviation_mm) },
    { name: "Voxels", show: (m) => count(m.voxels) },
    { name: "", text: true, show: (m) => deviationMark(m.rms_deviation_mm) },
  ], report.motions, { rowClass: (m) => (m.rms_deviation_mm > largestGoodDeviation ? "look" : "") }),
  note(`A label is marked when the field moves it more than ${largestGoodDeviation} mm (rms) off its rigid motion. A similarity that hardly rises, or a neighbour that moves quite differently, deserves a look in the viewer, too.`));
}
