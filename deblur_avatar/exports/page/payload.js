// Payload: the numbers of the page, as payload.py packs them.
//
// gzip of: the header's length (32 bits, little-endian), the header (JSON), arrays. The header says of
// each array its type and where it starts and, of quantised ones, the value of zero and the step of each
// column. Arrays lie column by column, of each column first all lowest bytes. They come out row by row.

const TYPES = { u1: Uint8Array, u2: Uint16Array, i2: Int16Array, u4: Uint32Array, f4: Float32Array };

async function readPayload(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(stream).arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const arrays = {};
  for (const [name, array] of Object.entries(header.arrays)) {
    arrays[name] = unpackArray(bytes, 4 + length, array);
  }
  return {
    ...header,
    avatars: header.avatars.map((avatar, index) => readAvatar(avatar, arrays, `avatar${index}.`)),
    frames: header.frames.map((frame, index) => ({ ...frame, file: arrays[`frame${index}`], truth: arrays[`truth${index}`] })),
  };
}

function unpackArray(bytes, start, { type, offset, rows, columns, low, step }) {
  const raw = new TYPES[type](rows * columns);
  const width = raw.BYTES_PER_ELEMENT;
  const planes = new Uint8Array(bytes, start + offset, rows * columns * width);
  const placed = new Uint8Array(raw.buffer); // little-endian, as browsers' machines are
  for (let at = 0, column = 0; column < columns; column++) {
    for (let byte = 0; byte < width; byte++) {
      for (let row = 0; row < rows; row++) placed[(row * columns + column) * width + byte] = planes[at++];
    }
  }
  if (!step) return raw;
  return Float64Array.from(raw, (stored, i) => low[i % columns] + step[i % columns] * stored);
}

function readAvatar(avatar, arrays, prefix) {
  const own = {};
  for (const [name, values] of Object.entries(arrays)) {
    if (name.startsWith(prefix)) own[name.slice(prefix.length)] = values;
  }
  const motions = avatar.motions.map((motion, index) => ({
    ...motion,
    times: own[`motion${index}.times`],
    quats: own[`motion${index}.quats`],
    transl: own[`motion${index}.transl`],
  }));
  return { ...avatar, ...own, motions, factors: covarianceFactors(own.quats, own.log_scales) };
}

// Rotation times scales of every Gaussian, [N, 3, 3]: its covariance is factor factor^T.
function covarianceFactors(quats, logScales) {
  const count = logScales.length / 3;
  const factors = new Float64Array(9 * count);
  const rotation = new Float64Array(9);
  for (let n = 0; n < count; n++) {
    matrixOfQuat(quats, 4 * n, rotation, 0, 3);
    for (let k = 0; k < 9; k++) factors[9 * n + k] = rotation[k] * Math.exp(logScales[3 * n + (k % 3)]);
  }
  return factors;
}
