/** How a candidate is drawn in every chart and table: its own colour (of the style sheet), dash and marker, so that no two need colours to be told apart. */
const seriesStyles = [
  { dash: "7 4", marker: "square" },
  { dash: "2 3", marker: "triangle" },
  { dash: "", marker: "circle" },
  { dash: "10 3 2 3", marker: "diamond" },
  { dash: "4 2", marker: "cross" },
  { dash: "12 4", marker: "turned" },
  { dash: "2 6", marker: "plus" },
  { dash: "7 3 2 3 2 3", marker: "bar" },
];

/** Styles by position: the image before, rigid registration and the one that is judged, the last, have their own; all others share the rest. */
function seriesIndex(candidates, id) {
  const own = (c, i) => (c.id === "before" ? 0 : c.id === "rigid" ? 1 : i === candidates.length - 1 ? 2 : null);
  const others = candidates.filter((c, i) => own(c, i) === null), at = candidates.findIndex((c) => c.id === id);
  return own(candidates[at], at) ?? 3 + (others.indexOf(candidates[at]) % (seriesStyles.length - 3));
}

const markerPaths = {
  circle: "M-3.5 0a3.5 3.5 0 1 1 7 0a3.5 3.5 0 1 1-7 0z",
  square: "M-3.2-3.2h6.4v6.4h-6.4z",
  triangle: "M0-4.2 4 3H-4z",
  turned: "M0 4.2 4-3H-4z",
  diamond: "M0-4.6 4.6 0 0 4.6-4.6 0z",
  plus: "M-1.4-4.4h2.8v3h3v2.8h-3v3h-2.8v-3h-3v-2.8h3z",
  cross: "M-4.1-2.1-2.1-4.1 0-2 2.1-4.1 4.1-2.1 2 0 4.1 2.1 2.1 4.1 0 2-2.1 4.1-4.1 2.1-2 0z",
  bar: "M-1.5-4.8h3v9.6h-3z",
};

const symbol = (index, x = 0, y = 0) => svg("path", { d: markerPaths[seriesStyles[index].marker], class: `series-${index} symbol`, transform: `translate(${x} ${y})` });

/** Line, dash and marker of a series, for legends and table headings. */
function seriesKey(index) {
  return svg("svg", { class: "key", viewBox: "0 0 34 12", "aria-hidden": "true" },
    svg("path", { d: "M1 6H33", class: `series-${index} line`, "stroke-dasharray": seriesStyles[index].dash }), symbol(index, 17, 6));
}

const waiting = [], printWidth = 680; // px, about what a page holds
const charts = new Map(); // of the page: box to {draw, width it was drawn at}
let printing = false;

function redrawChart(box, width = box.clientWidth) {
  const chart = charts.get(box);
  if (!chart || !width || width === chart.width) return;
  chart.width = width;
  attempt("A chart", () => box.replaceChildren(...chart.draw(width)));
}

const widths = new ResizeObserver((entries) => requestAnimationFrame(() => !printing && entries.forEach(({ target }) => redrawChart(target))));
for (const [event, before] of [["beforeprint", true], ["afterprint", false]])
  addEventListener(event, () => {
    printing = before;
    for (const box of charts.keys()) redrawChart(box, before ? printWidth : undefined);
  });

/** A box that is drawn at its width: once it is in the page (see drawWaiting), when that changes, and for print; until it is discarded. */
function responsive(draw) {
  const box = element("div", { class: "chart" });
  charts.set(box, { draw, width: 0 });
  widths.observe(box);
  waiting.push(() => redrawChart(box));
  return box;
}

/** Lets go of the charts in a part of the page that is about to be replaced. */
function discardCharts(part) {
  for (const box of part.querySelectorAll(".chart")) {
    widths.unobserve(box);
    charts.delete(box);
  }
}

/** Draws what was waiting for its place in the page. */
function drawWaiting() {
  for (const draw of waiting.splice(0)) attempt("A part of the page", draw);
}

const linear = (low, high) => ({ low, high, to: (v) => (v - low) / (high - low || 1), ticks: (wanted) => ticksBetween(low, high, wanted) });

/** Logarithmic above, linear around `knee`, so that zeros have a place. */
function symlog(high, knee = 1) {
  const bend = (v) => Math.log1p(v / knee);
  return { low: 0, high, to: (v) => bend(v) / bend(high), ticks: () => [0, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].filter((t) => t <= high && (t === 0 || t >= knee)) };
}

function logarithmic(low, high) {
  const from = Math.floor(Math.log10(low)), to = Math.max(Math.ceil(Math.log10(high)), from + 1), step = Math.ceil((to - from) / 6);
  return { low: 10 ** from, high: 10 ** to, to: (v) => (Math.log10(v) - from) / (to - from), ticks: () => Array.from({ length: Math.floor((to - from) / step) + 1 }, (_, i) => 10 ** (from + i * step)) };
}

/** Moves labels apart, keeping their order, so that none covers another. */
function spread(labels, gap, low, high) {
  labels.sort((a, b) => a.y - b.y);
  labels.forEach((label, i) => (label.y = Math.max(label.y, i ? labels[i - 1].y + gap : low)));
  for (let i = labels.length - 1; i >= 0; --i) labels[i].y = Math.min(labels[i].y, i + 1 < labels.length ? labels[i + 1].y - gap : high);
  return labels;
}

/**
 * A line chart. x, y: axes as made by linear, symlog or logarithmic, with `title`; series: {name, style, points: [[x, y]], every (markers), direct (label)};
 * guides: {x or y, name}; show: value of y as text; stop: x as text; valueAt: the value of a series, given by its points, at a place along x.
 */
function lineChart({ label, height, x, y, series, guides = [], show, stop, valueAt = (points, here) => points.find((p) => p[0] === here)?.[1] }) {
  const readout = element("div", { class: "tip", hidden: true, role: "status" });
  const stops = [...new Set(series.flatMap((s) => s.points.map((p) => p[0])))].sort((a, b) => a - b);
  return responsive((width) => {
    const direct = width > 620 && series.some((s) => s.direct);
    const box = { left: 56, right: width - (direct ? 12 + Math.max(...series.map((s) => 7.2 * s.name.length)) : 14), top: 22, bottom: height - 44 };
    const px = (v) => box.left + x.to(v) * (box.right - box.left), py = (v) => box.bottom - y.to(v) * (box.bottom - box.top);
    const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", tabindex: 0, "aria-label": `${label}. Left and right arrow keys read the values.` });
    for (const t of y.ticks(Math.max(3, Math.round(height / 60)))) {
      root.append(svg("path", { d: `M${box.left} ${py(t)}H${box.right}`, class: "grid" }), svg("text", { x: box.left - 8, y: py(t) + 4, "text-anchor": "end" }, brief(t)));
    }
    let free = -Infinity;
    for (const t of x.marks ?? x.ticks(Math.max(3, Math.round(width / 90)))) {
      if (px(t) < free) continue;
      free = px(t) + 26;
      root.append(svg("path", { d: `M${px(t)} ${box.bottom}v5`, class: "axis" }), svg("text", { x: px(t), y: box.bottom + 19, "text-anchor": "middle" }, brief(t, 6)));
    }
    root.append(svg("path", { d: `M${box.left} ${box.top}V${box.bottom}H${box.right}`, class: "axis" }),
      svg("text", { x: (box.left + box.right) / 2, y: height - 6, "text-anchor": "middle", class: "axis-title" }, x.title),
      svg("text", { x: 4, y: 12, class: "axis-title" }, y.title));
    for (const guide of guides) {
      const upright = guide.x !== undefined;
      root.append(svg("path", { d: upright ? `M${px(guide.x)} ${box.top}V${box.bottom}` : `M${box.left} ${py(guide.y)}H${box.right}`, class: "guide" }));
      if (guide.name) root.append(svg("text", upright ? { x: px(guide.x), y: box.top - 4, "text-anchor": "middle", class: "guide-name" } : { x: box.left + 6, y: py(guide.y) - 5, class: "guide-name" }, guide.name));
    }
    const ends = [];
    for (const s of series) {
      const inside = s.points.map(([a, b]) => (known(b) && Number.isFinite(y.to(b)) ? [px(a), py(b)] : null));
      root.append(svg("path", { d: inside.map((p, i) => (p ? `${i && inside[i - 1] ? "L" : "M"}${p[0].toFixed(1)} ${p[1].toFixed(1)}` : "")).join(""), class: `series-${s.style} line curve`, "stroke-dasharray": seriesStyles[s.style].dash }));
      if (s.every) inside.forEach((p, i) => p && (i + 1) % s.every === 0 && root.append(symbol(s.style, p[0], p[1])));
      const last = inside.findLast(Boolean);
      if (direct && last) ends.push({ name: s.name, style: s.style, x: last[0] + 8, y: last[1] + 4 });
    }
    for (const end of spread(ends, 15, box.top + 6, box.bottom)) root.append(svg("text", { x: end.x, y: end.y, class: `series-${end.style} name` }, end.name));
    const line = svg("path", { class: "reader", visibility: "hidden" });
    root.append(line);
    let at = -1;
    const read = (next) => {
      at = Math.min(Math.max(next, 0), stops.length - 1);
      const here = stops[at], where = px(here);
      line.setAttribute("d", `M${where} ${box.top}V${box.bottom}`);
      line.setAttribute("visibility", "visible");
      readout.replaceChildren(element("b", {}, stop(here)), ...series.map((s) => element("span", {}, seriesKey(s.style), `${s.name} `, element("b", {}, show(valueAt(s.points, here))))));
      readout.hidden = false;
      readout.style.left = `${Math.min(Math.max(where + 12, 0), width - readout.offsetWidth - 4)}px`;
      if (where + 12 + readout.offsetWidth > width) readout.style.left = `${Math.max(where - 12 - readout.offsetWidth, 0)}px`;
    };
    const leave = () => {
      readout.hidden = true;
      line.setAttribute("visibility", "hidden");
    };
    const point = (event) => {
      const bounds = root.getBoundingClientRect(), where = ((event.clientX - bounds.left) * width) / bounds.width;
      read(stops.reduce((best, v, i) => (Math.abs(px(v) - where) < Math.abs(px(stops[best]) - where) ? i : best), 0));
    };
    root.addEventListener("pointermove", point);
    root.addEventListener("pointerdown", point);
    root.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && leave());
    root.addEventListener("blur", leave);
    root.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      read(at + step);
    });
    readout.hidden = true;
    return [direct || series.length < 2 ? null : legend(series), element("div", { class: "plot" }, root, readout)].filter(Boolean);
  });
}

const legend = (series) => element("div", { class: "legend" }, series.map((s) => element("span", {}, seriesKey(s.style), s.name)));
