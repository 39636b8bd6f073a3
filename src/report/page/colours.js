const viridis = ["#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"];
const blueWhiteOrange = ["#0b3c8c", "#2f74c0", "#7fb2e0", "#cfe1f2", "#f7f7f7", "#fbd9b5", "#f39c4d", "#d35f0b", "#8c2d04"];
const folded = "#ff00c8";

const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** Red, green, blue (0 to 255) of a colour map at t in [0, 1]. */
function mapped(stops, t) {
  const place = Math.min(Math.max(t, 0), 1) * (stops.length - 1), at = Math.min(Math.floor(place), stops.length - 2);
  const [a, b] = [channels(stops[at]), channels(stops[at + 1])];
  return a.map((c, i) => Math.round(c + (place - at) * (b[i] - c)));
}

/** A pixel as ImageData holds it, seen as one little-endian number. */
const packed = (r, g, b, a = 255) => ((a << 24) | (b << 16) | (g << 8) | r) >>> 0;

/** Grey pixels of the 256 bytes of a volume, in a window of values. */
function greyTable(volume, window) {
  return Uint32Array.from({ length: 256 }, (_, byte) => {
    const grey = Math.round(255 * Math.min(Math.max((volume.value(byte) - window.low) / Math.max(window.high - window.low, 1e-9), 0), 1));
    return packed(grey, grey, grey);
  });
}

/** Where the colours of a scalar volume begin and end [its unit]; diverging maps reach equally far from the middle, and what is folded has its own colour. */
function colourRange(data) {
  if (data.map !== "diverging") return { low: data.low, high: data.high, stops: viridis };
  const middle = data.middle ?? 0, half = Math.max(data.high - middle, middle - (data.id === "jacobian" ? Math.max(data.low, 0) : data.low));
  return { low: middle - half, high: middle + half, stops: blueWhiteOrange };
}

/** Pixels of the 256 bytes of a scalar volume: transparent where nothing is known. */
function scalarTable(volume, opacity, { low, high, stops } = colourRange(volume.data)) {
  return Uint32Array.from({ length: 256 }, (_, byte) => (byte === 0 ? 0 : packed(...mapped(stops, (volume.value(byte) - low) / (high - low)), Math.round(255 * opacity))));
}

const edgePalettes = {
  papers: { fixed: "#2fe02f", before: "#ff3030", rigid: "#ffb000", registered: "#ff7fd0", coincide: "#3f7bff" },
  safe: { fixed: "#56b4e9", before: "#d55e00", rigid: "#cc79a7", registered: "#e69f00", coincide: "#f0e442" },
};

/** The name of an edge set in the palettes: fixed, before and rigid are their own, every other is a registered image. */
const edgeRole = (id) => (["fixed", "before", "rigid"].includes(id) ? id : "registered");

/** Pixels of the 256 combinations of edge bits, of the sets shown. A registered edge on a fixed one has the colour of coincidence. */
function edgeTable(bits, shown, palette) {
  return Uint32Array.from({ length: 256 }, (_, byte) => {
    const here = new Set(Object.entries(bits).filter(([bit, id]) => byte & Number(bit) && shown.has(id)).map(([, id]) => edgeRole(id)));
    const met = here.has("fixed") && (here.has("registered") || here.has("rigid"));
    const role = met ? "coincide" : ["registered", "rigid", "fixed", "before"].find((name) => here.has(name));
    return role ? packed(...channels(palette[role])) : 0;
  });
}

/** Round numbers between two ends, about `wanted` of them. */
function ticksBetween(low, high, wanted = 5) {
  const raw = (high - low) / wanted || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((m) => m * power).find((s) => s >= raw * 0.999);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; ++i) ticks.push(i === 0 ? 0 : Number((i * step).toPrecision(12)));
  return ticks;
}

/** A colour bar with its ticks, name and unit. `openStart`, `openEnd`: values beyond share the last colour; `extra`: swatches [colour, name] beside it. */
function colourBar({ name, unit, low, high, stops, openStart = false, openEnd = false, extra = [] }) {
  const canvas = element("canvas", { width: 256, height: 1, class: "ramp" }), pen = canvas.getContext("2d");
  for (let x = 0; x < 256; ++x) {
    pen.fillStyle = `rgb(${mapped(stops, x / 255).join(" ")})`;
    pen.fillRect(x, 0, 1, 1);
  }
  const near = (a, b) => Math.abs(a - b) < 1e-6 * (high - low), inner = ticksBetween(low, high, 4), ends = [low, high];
  const shown = [...inner.filter((t) => !ends.some((e) => Math.abs(e - t) < 0.18 * (high - low))), ...ends];
  const ticks = shown.map((value) => element("span", { style: `left:${(100 * (value - low)) / (high - low)}%` }, (openEnd && near(value, high) ? "≥ " : openStart && near(value, low) ? "≤ " : "") + brief(value)));
  const title = unit ? `${name} [${unit}]` : name;
  return element("figure", { class: "colourbar", "aria-label": `Colour bar: ${title}, ${brief(low)} to ${brief(high)}` },
    element("figcaption", {}, title), element("div", { class: "ramp-box" }, canvas, element("div", { class: "ticks" }, ticks)),
    extra.map(([colour, text]) => swatch(colour, text)));
}

const swatch = (colour, text) => element("span", { class: "swatch" }, svg("svg", { viewBox: "0 0 14 14", "aria-hidden": "true" }, svg("rect", { x: 1, y: 1, width: 12, height: 12, rx: 2, fill: colour })), text);
