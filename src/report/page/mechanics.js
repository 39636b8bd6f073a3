/** Centres of the tissue classes and their stiffness. */
function tissueTable(tissue) {
  return dataTable("Tissue classes", [
    { name: "Tissue", text: true, show: (c) => c.tissue },
    { name: "Centre", unit: "HU", show: (c) => decimals(c.center, 0) },
    { name: "Shear modulus", unit: "kPa", show: (c) => brief(c.shear_modulus_kpa) },
  ], tissue.classes);
}

/** How the relaxation came to its end: estimated error, convergence rate and strain energy over the step. */
function convergenceCharts(solver) {
  const { history: h } = solver, steps = h?.step ?? [];
  if (steps.length < 2) return null;
  const x = { ...linear(Math.min(...steps), Math.max(...steps)), title: "Relaxation step" }, line = (name, values) => [{ name, style: 2, points: steps.map((step, i) => [step, values[i] ?? null]) }];
  const stop = (step) => `Step ${step}`, charts = [], errors = (h.error_mm ?? []).filter((v) => v > 0);
  if (errors.length) charts.push(lineChart({ label: "Estimated error over the relaxation step", height: 250, x, stop, series: line("Estimated error", h.error_mm.map((v) => (v > 0 ? v : null))), show: (mm) => `${brief(mm)} mm`,
    y: { ...logarithmic(Math.min(solver.tolerance_mm || Infinity, ...errors), Math.max(...errors)), title: "Estimated error [mm]" }, guides: known(solver.tolerance_mm) ? [{ y: solver.tolerance_mm, name: `tolerance, ${brief(solver.tolerance_mm)} mm` }] : [] }));
  for (const [name, unit, values, low, high] of [["Convergence rate", "", h.rate, 0, 1], ["Strain energy", "mN mm", h.energy_mN_mm]]) {
    const there = (values ?? []).filter(known);
    if (!there.length) continue;
    const [from, to] = [Math.min(low ?? 0, ...there), Math.max(high ?? -Infinity, ...there) * (high ? 1 : 1.05) || 1];
    charts.push(lineChart({ label: `${name} over the relaxation step`, height: 190, x, stop, series: line(name, values), show: (v) => `${brief(v, 4)} ${unit}`.trim(), y: { ...linear(from, to), title: unit ? `${name} [${unit}]` : name } }));
  }
  return [element("h3", {}, "Convergence"), charts];
}

/** Nodes, convergence, tissue and what the solver says. */
function mechanicsSection(report) {
  const { nodes, solver, tissue } = report;
  const cloud = nodes?.rest && nodes.displacement ? attempt("The cloud of nodes", () => element("div", {}, element("h3", {}, "Nodes of the mechanical model"), new Cloud(nodes).root)) : null;
  const about = solver ? facts([
    ["Converged", solver.converged === undefined || solver.converged === null ? null : mark(solver.converged ? "good" : "bad", solver.converged ? "Yes" : "No")],
    ["Estimated error", known(solver.error_estimate_mm) ? `${brief(solver.error_estimate_mm)} mm (tolerance ${brief(solver.tolerance_mm)} mm)` : null],
    ["Steps", known(solver.steps) ? count(solver.steps) : null], ["Nodes", known(solver.nodes) ? count(solver.nodes) : null], ["Integration points", known(solver.points) ? count(solver.points) : null],
    ["Device", solver.device], ["Body", known(tissue?.body_litres) ? `${decimals(tissue.body_litres, 1)} litres` : null],
  ]) : null;
  const right = [solver ? attempt("Convergence", () => convergenceCharts(solver)) : null, tissue?.classes?.length ? tissueTable(tissue) : null].flat(Infinity).filter(Boolean);
  const sides = [cloud, right.length ? element("div", {}, right) : null].filter(Boolean);
  return section("mechanics", "Mechanics", about, sides.length ? element("div", { class: sides.length > 1 ? "halves" : "" }, sides) : null);
}
