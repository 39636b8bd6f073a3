/** A volume of bytes that is decoded from its mosaic of axial slices when it is first needed. */
class Volume {
  constructor(data, space) {
    this.data = data;
    this.id = data.id;
    this.name = data.name ?? data.id;
    this.space = space;
    this.voxels = null;
  }

  /** The value of a byte [unit of the volume]; null where a scalar volume knows nothing. */
  value(byte) {
    const { kind, low, high } = this.data;
    if (kind === "grey") return low + (byte / 255) * (high - low);
    return byte === 0 ? null : low + ((byte - 1) / 254) * (high - low);
  }

  /** The byte of a voxel; 0 outside or before decoding. */
  byteAt([i, j, k]) {
    const [nx, ny, nz] = this.space.size;
    return this.voxels && i >= 0 && j >= 0 && k >= 0 && i < nx && j < ny && k < nz ? this.voxels[(k * ny + j) * nx + i] : 0;
  }

  /** Decodes once; later calls wait for the same. */
  load() {
    this.loading ??= this.decode();
    return this.loading;
  }

  async decode() {
    const { tile: [tw, th], columns, picture } = this.data.mosaic, [nx, ny, nz] = this.space.size;
    const image = new Image(), rows = Math.ceil(nz / columns);
    image.src = picture;
    try {
      await image.decode();
    } catch {
      throw new Error(`the picture of “${this.name}” cannot be decoded; the file is damaged or this browser is too old. Write the report again, or open it in a current browser`);
    }
    if (image.naturalWidth < columns * tw || image.naturalHeight < rows * th || tw < nx || th < ny)
      throw new Error(`the picture of “${this.name}” has ${image.naturalWidth} × ${image.naturalHeight} pixels, but ${nz} slices in tiles of ${tw} × ${th} need ${columns * tw} × ${rows * th}. Write the report again`);
    const voxels = new Uint8Array(nx * ny * nz);
    const band = element("canvas", { width: columns * tw, height: th }), pen = band.getContext("2d", { willReadFrequently: true });
    for (let row = 0; row < rows; ++row) {
      pen.drawImage(image, 0, row * th, columns * tw, th, 0, 0, columns * tw, th);
      const pixels = pen.getImageData(0, 0, columns * tw, th).data;
      for (let column = 0; column < columns && row * columns + column < nz; ++column)
        for (let j = 0, to = (row * columns + column) * nx * ny; j < ny; ++j)
          for (let i = 0, from = 4 * (j * columns * tw + column * tw); i < nx; ++i, from += 4) voxels[to++] = pixels[from];
    }
    this.voxels = voxels;
  }
}

/** The vectors v(y) [mm] on a coarse grid: the point y of the fixed image came from y + v(y) of the moving one. */
class Arrows {
  constructor(data) {
    Object.assign(this, { size: data.size, spacing: data.spacing_mm, origin: data.origin_mm, scale: data.scale_mm, numbers: int16FromBase64(data.data) });
  }

  /** v at a node, or null where it is unknown. */
  at(i, j, k) {
    const at = 3 * ((k * this.size[1] + j) * this.size[0] + i);
    return this.numbers[at] === -32768 ? null : [0, 1, 2].map((c) => this.numbers[at + c] * this.scale);
  }

  /** v at a point [mm], linear between nodes; null outside and beside unknown ones. */
  between(point) {
    const place = point.map((p, a) => (p - this.origin[a]) / this.spacing), low = place.map(Math.floor), sum = [0, 0, 0];
    for (let corner = 0; corner < 8; ++corner) {
      const node = low.map((l, a) => l + ((corner >> a) & 1));
      const weight = place.reduce((product, p, a) => product * ((corner >> a) & 1 ? p - low[a] : 1 - p + low[a]), 1);
      if (weight < 1e-9) continue;
      if (node.some((n, a) => n < 0 || n >= this.size[a])) return null;
      const v = this.at(...node);
      if (!v) return null;
      v.forEach((component, a) => (sum[a] += weight * component));
    }
    return sum;
  }
}
