const inputOf = (report, ...roles) => (report.inputs ?? []).find((input) => roles.includes(input.role.toLowerCase()));

const named = (input, parts) => element("span", { class: "file", title: input.path }, shortPath(input.path, parts));

/** What was registered with what, or evaluated against what. */
function titleSection(report) {
  const fixed = inputOf(report, "fixed image", "fixed"), moving = inputOf(report, "moving image", "moving"), judged = inputOf(report, "warped image", "warped", "result", "transform");
  const first = moving ?? judged;
  const parts = first && fixed && shortPath(first.path) === shortPath(fixed.path) ? 2 : 1;
  const heading = first && fixed
    ? [named(first, parts), element("span", { class: "joining" }, first === moving ? " brought onto " : " judged against "), named(fixed, parts)]
    : [report.kind === "register" ? "Registration" : "Evaluation of a registration"];
  const images = (report.inputs ?? []).filter((input) => /image|transform|^(fixed|moving|warped)$/i.test(input.role));
  document.title = `${first && fixed ? `${shortPath(first.path, parts)} – ${shortPath(fixed.path, parts)}` : heading[0]} · mtled`;
  return element("header", { class: "title" },
    element("p", { class: "kind" }, report.kind === "register" ? "Registration report" : "Evaluation report"),
    element("h1", {}, heading),
    facts([...images.map((input) => [capital(input.role), element("span", {}, named(input, parts), element("small", {}, sizeOf(input)))]),
      ["Program", report.program], ["Written", report.created]]));
}

const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** Columns for `count` cards where two to five fit side by side: as many rows as needed, filled evenly. */
const evenRows = (count) => [2, 3, 4, 5].map((fit) => `--of-${fit}:${Math.ceil(count / Math.ceil(count / fit))}`).join(";");

/** The verdict: one sentence, what it rests on, and warnings. */
function verdictSection(report) {
  const { level, headline, items = [] } = report.verdict;
  const cards = (items ?? []).map((item) => element("li", { class: `card ${item.level}` },
    element("div", { class: "card-head" }, element("span", { class: "card-label" }, item.label), mark(item.level)),
    element("p", { class: "card-value" }, item.value), item.compared ? element("p", { class: "card-compared" }, item.compared) : null, item.detail ? element("p", { class: "card-detail" }, item.detail) : null));
  const warnings = report.warnings ?? [];
  return section("verdict", "Verdict", element("div", { class: `headline ${level}` }, mark(level), element("p", {}, headline)),
    cards.length ? element("ul", { class: "cards", style: evenRows(cards.length) }, cards) : null,
    warnings.length ? element("div", { class: "notice check" }, element("h3", {}, mark("check", warnings.length > 1 ? `${warnings.length} warnings` : "Warning")), element("ul", {}, warnings.map((text) => element("li", {}, text)))) : null);
}
