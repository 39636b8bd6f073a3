/** An element with attributes (functions become listeners, null and false are left out) and children. */
function element(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function filled(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value !== null && value !== undefined && value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return made;
}

const known = (value) => typeof value === "number" && Number.isFinite(value);

/** A number with this many decimals, or a dash for what has no value. */
function decimals(value, places = 2) {
  if (!known(value)) return "–";
  const text = Math.abs(value).toLocaleString("en", { minimumFractionDigits: places, maximumFractionDigits: places }).replaceAll(",", "\u202f");
  return value < 0 && Number(value.toFixed(places)) !== 0 ? `−${text}` : text;
}

/** A number with about this many significant digits, for axes and colour bars. */
function brief(value, digits = 3) {
  if (!known(value)) return "–";
  if (value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e6)) return value.toExponential(1).replace("-", "−").replace("e+", "e");
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}

const count = (value) => decimals(value, 0);
const percent = (fraction) => (known(fraction) ? `${decimals(100 * fraction, 1)} %` : "–");

/** The last parts of a path; the whole path is for the title attribute. */
const shortPath = (path, parts = 1) => path.split(/[\\/]/).filter(Boolean).slice(-parts).join("/") || path;

const sizeOf = (item) => [item.size && `${item.size.join(" × ")} voxels`, item.spacing_mm && `${item.spacing_mm.map((s) => brief(s)).join(" × ")} mm`].filter(Boolean).join(" of ");

/** A section of the page with its heading; null when it has no content. */
function section(id, title, ...content) {
  const inside = content.flat().filter(Boolean);
  return inside.length ? element("section", { id, "aria-labelledby": `${id}-title` }, element("h2", { id: `${id}-title` }, title), inside) : null;
}

/** A switch that is on or off. */
function toggle(label, on, change) {
  return element("label", { class: "toggle" }, element("input", { type: "checkbox", checked: on, change: (e) => change(e.target.checked) }), element("span", {}, label));
}

/** A list to choose from; options are [value, name]. */
function choice(label, options, value, change) {
  const list = element("select", { change: (e) => change(e.target.value) }, options.map(([v, name]) => element("option", { value: v, selected: String(v) === String(value) }, name)));
  return element("label", { class: "field" }, element("span", {}, label), list);
}

let groups = 0;

/** Buttons of which one is pressed: radio buttons, so that the arrow keys work. Options are [value, name]. */
function segmented(label, options, value, change, visible = false) {
  const name = `group-${++groups}`;
  const radios = options.map(([v, text]) =>
    element("label", {}, element("input", { type: "radio", name, value: v, checked: v === value, change: () => change(v) }), element("span", {}, text)));
  return element("fieldset", { class: "segmented" }, element("legend", { class: visible ? "" : "unseen" }, label), element("div", {}, radios));
}

/** A slider with its value beside it. */
function slider(label, { min, max, step, value, show }, change) {
  const output = element("output", {}, show(value));
  const input = element("input", { type: "range", min, max, step, value, "aria-label": label, "aria-valuetext": show(value), input: (e) => {
    const moved = Number(e.target.value);
    output.textContent = show(moved);
    e.target.setAttribute("aria-valuetext", show(moved));
    change(moved);
  } });
  return element("label", { class: "field" }, element("span", {}, label), input, output);
}

const button = (label, click, attributes = {}) => element("button", { type: "button", click, ...attributes }, label);

const marks = {
  good: ["Good", "M5.8 10.4 8.8 13.4 14.4 7", "circle"],
  check: ["Check", "M10 7v4.5M10 14.2v.3", "triangle"],
  bad: ["Problem", "M7 7l6 6M13 7l-6 6", "octagon"],
  info: ["Info", "M10 9v5M10 6v.3", "circle"],
};
const outlines = {
  circle: "M10 1.2a8.8 8.8 0 1 1 0 17.6a8.8 8.8 0 0 1 0-17.6z",
  triangle: "M10 1.8 19 18H1z",
  octagon: "M6.3 1.2h7.4l5.1 5.1v7.4l-5.1 5.1H6.3l-5.1-5.1V6.3z",
};

/** Icon and word of a level (good, check, bad, info): never colour alone. */
function mark(level, word = marks[level][0]) {
  const [, stroke, outline] = marks[level];
  return element("span", { class: `mark ${level}` }, svg("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, svg("path", { d: outlines[outline] }), svg("path", { d: stroke })), word);
}

function fromBase64(text) {
  const characters = atob(text), bytes = new Uint8Array(characters.length);
  for (let i = 0; i < bytes.length; ++i) bytes[i] = characters.charCodeAt(i);
  return bytes;
}

/** Little-endian int16, whatever the machine's own order. */
function int16FromBase64(text) {
  const view = new DataView(fromBase64(text).buffer), numbers = new Int16Array(view.byteLength >> 1);
  for (let i = 0; i < numbers.length; ++i) numbers[i] = view.getInt16(2 * i, true);
  return numbers;
}
