/** Seconds and peak memory of every stage. */
function stagesSection(report) {
  const stages = report.stages ?? [];
  if (!stages.length) return null;
  const longest = Math.max(...stages.map((s) => s.seconds ?? 0)) || 1, total = stages.reduce((sum, s) => sum + (s.seconds ?? 0), 0), memory = stages.some((s) => known(s.peak_memory_MB));
  return section("time", "Time and memory", dataTable("Seconds of each stage, and the peak memory up to its end", [
    { name: "Stage", text: true, show: (s) => s.name },
    { name: "", text: true, show: (s) => (known(s.seconds) && s.name !== "Total" ? svg("svg", { class: "time-bar", viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" }, svg("rect", { width: Math.max(0.4, (100 * s.seconds) / longest), height: 10, rx: 0 })) : "") },
    { name: "Time", unit: "s", show: (s) => decimals(s.seconds, 1) },
    ...(memory ? [{ name: "Peak memory", unit: "MB", show: (s) => count(s.peak_memory_MB) }] : []),
  ], stages, { foot: { name: "Total", seconds: total, peak_memory_MB: memory ? Math.max(...stages.map((s) => s.peak_memory_MB ?? 0)) : null } }));
}

/** Settings, and the files that were read. */
function inputsSection(report) {
  const inputs = report.inputs ?? [], settings = report.settings ?? [], summed = inputs.some((i) => i.md5);
  return section("inputs", "Inputs and settings",
    inputs.length ? dataTable("Files that were read", [
      { name: "What", text: true, show: (i) => capital(i.role) },
      { name: "File", text: true, show: (i) => element("span", { title: i.path, class: "path" }, i.path) },
      { name: "Size", text: true, show: (i) => sizeOf(i) || "–" },
      ...(summed ? [{ name: "MD5", text: true, show: (i) => (i.md5 ? element("code", {}, i.md5) : "–") }] : []),
    ], inputs) : null,
    settings.length ? [element("h3", {}, "Settings"), facts(settings.map((s) => [s.name, s.value]))] : null);
}

function figuresSection(report) {
  const figures = report.figures ?? [];
  return figures.length ? section("figures", "Figures", element("div", { class: "figures" }, figures.map((f) => element("figure", {}, element("h3", {}, f.title), element("img", { src: f.picture, alt: f.title }), f.caption ? element("figcaption", {}, f.caption) : null)))) : null;
}

/** Plain explanations of what this report shows; each entry: whether it applies, term, text. */
function readingSection(report) {
  const has = (id) => report.view?.volumes?.some((volume) => volume.id === id), grey = report.view?.volumes?.find((volume) => volume.kind === "grey");
  const entries = [
    [true, "Fixed and moving", "The moving image is deformed so that it lies on the fixed one, which stays as it is. All positions are LPS: x to the patient's left, y to the back, z to the head, in mm. Axial and coronal planes show the patient's left on the right, sagittal ones the front on the left."],
    [grey, "Pictures in the viewer", `The viewer holds reduced copies of the images, ${report.view ? `${brief(Object.values(report.view.spaces)[0].spacing_mm)} mm` : ""} to a voxel and ${grey ? brief((grey.high - grey.low) / 255) : ""} ${grey?.unit ?? ""} to a grey step, and grey pictures are compressed. They are for looking; measure in the image files.`],
    [has("edges"), "Edge overlays", "Edges are found in each image by itself, and drawn over the fixed one. Where a registered edge and a fixed edge are the same voxel, the colour of coincidence is shown. Near misses by a single voxel therefore look unmatched: the distances below count them rightly."],
    [report.edges, "Distance between edges", "For every edge voxel, the distance to the nearest edge of the other image; the curve shows its percentiles, the larger of the two directions. The 100 % value is the Hausdorff distance, and one stray edge decides it; 60 to 95 % tell more. Edges within two voxels are commonly counted as successfully registered. Edges that only one image has, such as bowel gas or contrast medium, end the curve high in any registration."],
    [report.landmarks, "Landmarks", "Distances between points that were marked in both images. They are independent of the images' edges, but only as good as the marking."],
    [report.labels, "Labels", "Dice is twice the common volume over the sum of both: 1 is perfect, and small structures reach less. Surface distances are between the surfaces of the label in both images."],
    [report.jacobian || has("jacobian"), "Volume ratio", "det J, the determinant of the gradient of the transform: the volume a bit of tissue has in the moving image over its volume in the fixed one. Soft tissue is nearly incompressible, so values far from 1 want an explanation (lungs have one). Values of 0 and below mean the transform folds: it is not possible there."],
    [report.inverse_consistency, "Inverse consistency", "How far a point lands from where it started when it goes through the transform and back through its inverse."],
    [report.motions?.length, "Motion of every label", "Bones do not bend. The deviation is how far the field moves the voxels of a label from the rigid motion that was found or given for it."],
    [report.rigidity?.length, "Rigidity", "Bones do not bend. The deviation is how far the transform moves the voxels of a label from the rigid motion that fits best: one that is rigid but wrong has none."],
    [has("displacement"), "Displacement", "How far the tissue has come, in mm. Large displacement is no fault: it is what the posture asks for."],
    [report.nodes || report.solver, "Mechanics", "The body is a cloud of nodes that carries the stiffness of its tissue. The rigid labels are moved as found, all else follows by equilibrium. The estimated error is the distance to that equilibrium, not to the truth: it says the equations are solved, not that the anatomy is right."],
  ].filter(([applies]) => applies);
  const papers = [
    "M. Li, K. Miller, G. R. Joldes, R. Kikinis, A. Wittek: Biomechanical model for computing deformations for whole-body image registration: A meshless approach. International Journal for Numerical Methods in Biomedical Engineering, 2016.",
    "R. R. Garlapati, A. Mostayed, G. R. Joldes, A. Wittek, B. Doyle, K. Miller: Towards measuring neuroimage misalignment. Computers in Biology and Medicine, 2015; A. Mostayed et al.: Biomechanical model as a registration tool for image-guided neurosurgery: evaluation against BSpline registration. Annals of Biomedical Engineering, 2013 (percentile Hausdorff distance between edges).",
    "J. Canny: A computational approach to edge detection. IEEE Transactions on Pattern Analysis and Machine Intelligence, 1986.",
  ];
  return section("reading", "How to read this report", element("dl", { class: "reading" }, entries.map(([, term, text]) => element("div", {}, element("dt", {}, term), element("dd", {}, text)))),
    element("h3", {}, "Sources"), element("ul", { class: "papers" }, papers.map((paper) => element("li", {}, paper))), note("mtled is research software, not a medical device."));
}
