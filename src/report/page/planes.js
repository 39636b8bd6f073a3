/** The planes as radiologists see them: `across` and `down` are the LPS axes of the picture, `up` when the axis rises towards its top. */
const planes = {
  axial: { name: "Axial", normal: 2, across: 0, down: 1, up: false, letters: { left: "R", right: "L", top: "A", bottom: "P" }, sides: ["F", "H"] },
  coronal: { name: "Coronal", normal: 1, across: 0, down: 2, up: true, letters: { left: "R", right: "L", top: "H", bottom: "F" }, sides: ["A", "P"] },
  sagittal: { name: "Sagittal", normal: 0, across: 1, down: 2, up: true, letters: { left: "A", right: "P", top: "H", bottom: "F" }, sides: ["R", "L"] },
};

/** Calls visit(byte index, pixel index, column, row) for every voxel of slice `at` of a plane. */
function walkSlice(plane, size, at, visit) {
  const strides = [1, size[0], size[0] * size[1]], columns = size[plane.across], rows = size[plane.down];
  for (let row = 0, pixel = 0; row < rows; ++row) {
    let from = at * strides[plane.normal] + (plane.up ? rows - 1 - row : row) * strides[plane.down];
    for (let column = 0; column < columns; ++column, from += strides[plane.across]) visit(from, pixel++, column, row);
  }
}

/** The pixels of a slice by a table of 256 pixels. */
function slicePixels(plane, volume, at, table) {
  const { size } = volume.space, pixels = new Uint32Array(size[plane.across] * size[plane.down]), { voxels } = volume;
  walkSlice(plane, size, at, (from, pixel) => (pixels[pixel] = table[voxels[from]]));
  return pixels;
}

/** Where a plane lies in a canvas: pixels per voxel, and the canvas position of the outer corner of its first voxel. */
function layOut(plane, size, width, height, zoom, centre) {
  const scale = zoom * Math.min(width / size[plane.across], height / size[plane.down]);
  const start = (length, voxels, at) => (voxels * scale <= length ? (length - voxels * scale) / 2 : Math.min(0, Math.max(length - voxels * scale, length / 2 - (at + 0.5) * scale)));
  const row = plane.up ? size[plane.down] - 1 - centre[plane.down] : centre[plane.down];
  return { scale, left: start(width, size[plane.across], centre[plane.across]), top: start(height, size[plane.down], row), rows: size[plane.down], plane };
}

/** Canvas position of a place in voxels (0 = centre of the first one). */
function onCanvas(view, voxel) {
  const { plane, scale } = view, down = plane.up ? view.rows - 1 - voxel[plane.down] : voxel[plane.down];
  return [view.left + (voxel[plane.across] + 0.5) * scale, view.top + (down + 0.5) * scale];
}

/** The place in voxels under a canvas position: [across, down]. */
function underCanvas(view, x, y) {
  const down = (y - view.top) / view.scale - 0.5;
  return [(x - view.left) / view.scale - 0.5, view.plane.up ? view.rows - 1 - down : down];
}

const scratch = document.createElement("canvas");

/** Draws a layer of voxel pixels; smoothed, or as the squares they are. */
function drawLayer(pen, view, size, pixels, smooth) {
  scratch.width = size[view.plane.across];
  scratch.height = size[view.plane.down];
  scratch.getContext("2d", { willReadFrequently: true }).putImageData(new ImageData(new Uint8ClampedArray(pixels.buffer), scratch.width, scratch.height), 0, 0);
  pen.imageSmoothingEnabled = smooth;
  pen.imageSmoothingQuality = "high";
  pen.drawImage(scratch, view.left, view.top, scratch.width * view.scale, scratch.height * view.scale);
}

function prepareText(pen, align, baseline, size) {
  pen.font = `600 ${size}px system-ui, sans-serif`;
  pen.textAlign = align;
  pen.textBaseline = baseline;
}

function whiteText(pen, text, x, y, align, baseline, size) {
  prepareText(pen, align, baseline, size);
  pen.fillStyle = "#fff";
  pen.fillText(text, x, y);
}

/** White text on a dark plate, readable on any picture. */
function platedText(pen, text, x, y, align, baseline, size) {
  prepareText(pen, align, baseline, size);
  const box = pen.measureText(text), edge = size * 0.3;
  pen.fillStyle = "rgb(0 0 0 / 0.6)";
  pen.fillRect(x - box.actualBoundingBoxLeft - edge, y - box.actualBoundingBoxAscent - edge, box.actualBoundingBoxLeft + box.actualBoundingBoxRight + 2 * edge, box.actualBoundingBoxAscent + box.actualBoundingBoxDescent + 2 * edge);
  whiteText(pen, text, x, y, align, baseline, size);
}

/** Orientation letters, scale bar and, top left, the name of what is seen. */
function drawFrame(pen, plane, view, spacing, dpr, title) {
  const { width, height } = pen.canvas, small = width < 240 * dpr, pad = (small ? 5 : 8) * dpr, letter = (small ? 10 : 13) * dpr, words = (small ? 10 : 12) * dpr;
  platedText(pen, plane.letters.left, pad, height / 2, "left", "middle", letter);
  platedText(pen, plane.letters.right, width - pad, height / 2, "right", "middle", letter);
  platedText(pen, plane.letters.top, width / 2, pad, "center", "top", letter);
  platedText(pen, plane.letters.bottom, width / 2, height - pad, "center", "bottom", letter);
  if (title) {
    prepareText(pen, "left", "top", words);
    const narrow = pen.measureText(title).width > width / 2 - 4 * pad;
    platedText(pen, title, pad, narrow ? 3.2 * pad : pad, "left", "top", words);
  }
  const perMm = view.scale / spacing, length = [500, 200, 100, 50, 20, 10, 5, 2, 1].find((mm) => mm * perMm <= width / 3) ?? 1;
  const [x, y] = [width - pad - length * perMm, height - pad - 2 * dpr];
  pen.fillStyle = "rgb(0 0 0 / 0.6)";
  pen.fillRect(x - 4 * dpr, y - 20 * dpr, length * perMm + 8 * dpr, 25 * dpr);
  pen.strokeStyle = "#fff";
  pen.lineWidth = 2 * dpr;
  pen.beginPath();
  pen.moveTo(x, y - 4 * dpr);
  pen.lineTo(x, y);
  pen.lineTo(x + length * perMm, y);
  pen.lineTo(x + length * perMm, y - 4 * dpr);
  pen.stroke();
  whiteText(pen, `${length} mm`, x + (length * perMm) / 2, y - 5 * dpr, "center", "bottom", Math.min(words, 11 * dpr));
}

/** Lines through the position, open around it. */
function drawCrosshair(pen, [x, y], dpr) {
  const { width, height } = pen.canvas, gap = 8 * dpr;
  for (const [colour, line] of [["rgb(0 0 0 / 0.5)", 3], ["rgb(255 214 64 / 0.95)", 1]]) {
    pen.strokeStyle = colour;
    pen.lineWidth = line * dpr;
    pen.beginPath();
    for (const [x0, y0, x1, y1] of [[0, y, x - gap, y], [x + gap, y, width, y], [x, 0, x, y - gap], [x, y + gap, x, height]]) {
      pen.moveTo(x0, y0);
      pen.lineTo(x1, y1);
    }
    pen.stroke();
  }
}

/** Arrows of the layer of nodes nearest to slice `at`, from where the tissue came to where it is; dots where it moved within a pixel. Not closer than 13 px. */
function drawArrows(pen, view, space, arrows, at, dpr) {
  const { plane } = view, slice = space.origin_mm[plane.normal] + at * space.spacing_mm;
  const layer = Math.round((slice - arrows.origin[plane.normal]) / arrows.spacing);
  if (layer < 0 || layer >= arrows.size[plane.normal]) return;
  const lines = new Path2D(), heads = new Path2D(), toVoxel = (p) => p.map((c, a) => (c - space.origin_mm[a]) / space.spacing_mm);
  const stride = Math.max(1, Math.ceil((13 * dpr * space.spacing_mm) / (arrows.spacing * view.scale)));
  for (let b = 0; b < arrows.size[plane.down]; b += stride)
    for (let a = 0; a < arrows.size[plane.across]; a += stride) {
      const node = [0, 0, 0];
      node[plane.normal] = layer;
      node[plane.across] = a;
      node[plane.down] = b;
      const v = arrows.at(...node);
      if (!v) continue;
      const y = node.map((n, axis) => arrows.origin[axis] + n * arrows.spacing);
      const [x1, y1] = onCanvas(view, toVoxel(y)), [x0, y0] = onCanvas(view, toVoxel(y.map((c, axis) => c + v[axis])));
      const length = Math.hypot(x1 - x0, y1 - y0), head = Math.min(6 * dpr, length * 0.6);
      if (length < 1.5 * dpr) {
        heads.moveTo(x1 + dpr, y1);
        heads.arc(x1, y1, dpr, 0, 7);
        continue;
      }
      const [dx, dy] = [(x1 - x0) / length, (y1 - y0) / length];
      lines.moveTo(x0, y0);
      lines.lineTo(x1 - dx * head * 0.8, y1 - dy * head * 0.8);
      heads.moveTo(x1, y1);
      heads.lineTo(x1 - head * dx + 0.45 * head * dy, y1 - head * dy - 0.45 * head * dx);
      heads.lineTo(x1 - head * dx - 0.45 * head * dy, y1 - head * dy + 0.45 * head * dx);
      heads.closePath();
    }
  pen.lineJoin = "round";
  for (const [colour, line] of [["rgb(0 0 0 / 0.7)", 3], ["#fff", 1.3]]) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = line * dpr;
    pen.stroke(lines);
    if (colour !== "#fff") pen.lineWidth = 2 * dpr, pen.stroke(heads);
    else pen.fill(heads);
  }
}
