/** The button that changes between light and dark; the system decides until it is used. */
function themeButton() {
  const root = document.documentElement, dark = () => (root.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const label = () => (dark() ? "Light theme" : "Dark theme");
  const made = button(label(), () => {
    root.dataset.theme = dark() ? "light" : "dark";
    made.textContent = label();
  }, { class: "small", id: "theme" });
  return made;
}

/** The viewer's section, or null when no mode has its data. */
function viewerSection(report) {
  if (!report.view?.volumes?.length) return [null, null];
  const viewer = new Viewer(report);
  return viewer.modes.length ? [section("viewer", "Images", viewer.root), viewer] : [null, null];
}

async function main() {
  const report = JSON.parse(document.getElementById("report-data").textContent);
  if (report.version !== 1) throw new Error(`the data have version ${report.version}, this page reads version 1. Write the report again`);
  const content = document.getElementById("content"), add = (made) => made && content.append(made);
  add(attempt("Title", () => titleSection(report)));
  add(attempt("Verdict", () => verdictSection(report)));
  const [images, viewer] = attempt("The viewer", () => viewerSection(report)) ?? [null, null];
  add(images);
  const sections = { "Distance between edges": edgesSection, Landmarks: landmarksSection, Labels: labelsSection, "Outlines of organs": contoursSection, "Displacement field": fieldSection, Reference: referenceSection, "Motion of every label": motionsSection,
    Mechanics: mechanicsSection, Time: stagesSection, Inputs: inputsSection, Figures: figuresSection, Reading: readingSection };
  for (const [name, make] of Object.entries(sections)) add(attempt(name, () => make(report)));
  const short = { edges: "Edges", contours: "Outlines", reference: "Reference", field: "Field", motions: "Motions", time: "Time", inputs: "Inputs", reading: "How to read" };
  document.getElementById("contents").append(...[...content.querySelectorAll("section")].map((s) => element("a", { href: `#${s.id}` }, short[s.id] ?? s.querySelector("h2").textContent)));
  document.getElementById("tools").append(themeButton(), button("Print", () => print(), { class: "small print" }));
  document.getElementById("foot").textContent = [report.program, report.created].filter(Boolean).join(" · ");
  drawWaiting();
  if (viewer) await viewer.set({}, true);
  await Promise.all([...content.querySelectorAll("img")].map((picture) => picture.decode().catch(() => showProblem("Figures", new Error(`“${picture.alt}” cannot be decoded`)))));
  await new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)));
}

main().catch((error) => showProblem("Report", error)).finally(() => (document.documentElement.dataset.state = "ready"));
