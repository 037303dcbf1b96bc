// AMASS sequences (.npz): poses of SMPL's joints, as animation/amass.py reads them.
//
// The file is a ZIP archive of numpy's arrays. The world has +Z up, metres; hands stay straight.

const BODY = 66; // numbers of the root and the 21 joints that all models of the family share
const WIDTHS = [66, 72, 156, 165]; // the body alone, SMPL, SMPL-H, SMPL-X
const UPRIGHT_FROM_AMASS = [1, 0, 0, 0, 0, 1, 0, -1, 0];
const NUMPY_TYPES = { "<f4": Float32Array, "<f8": Float64Array, "<i4": Int32Array, "<i8": BigInt64Array };

// Local rotations [F][24] and translations [F][3], upright.
async function readAmass(buffer) {
  const names = ["poses", "trans", "mocap_framerate", "mocap_frame_rate"];
  const arrays = await readNpz(buffer, names);
  const [poses, trans, rate] = [arrays.poses, arrays.trans, arrays.mocap_framerate ?? arrays.mocap_frame_rate];
  if (!poses || !trans || !rate) throw new Error(`wanted poses, trans and mocap_framerate, found ${Object.keys(arrays).join(", ") || "none of them"}`);
  const [count, width] = poses.shape;
  const [fps] = rate.values;
  if (poses.shape.length !== 2 || !WIDTHS.includes(width) || String(trans.shape) !== `${count},3`) {
    throw new Error(`poses must be frames of ${WIDTHS.join(", ")} numbers and trans of 3, got ${poses.shape} and ${trans.shape}`);
  }
  if (!(fps > 0) || count < 1) throw new Error(`wanted frames and a positive rate, got ${count} and ${fps}`);
  if (count * 24 > MOST_TURNS) throw new Error(`${count} frames are too many; cut it`);
  if (![...poses.values, ...trans.values].every(Number.isFinite)) throw new Error("not all of its numbers are finite");
  const frames = Array.from({ length: count }, (_, f) => f);
  return {
    step: 1 / fps,
    rotations: frames.map((f) => {
      const turns = [];
      for (let k = 0; k < BODY; k += 3) turns.push(ofAxisAngle([...poses.values.slice(f * width + k, f * width + k + 3)]));
      return [product(UPRIGHT_FROM_AMASS, turns[0]), ...turns.slice(1), IDENTITY, IDENTITY];
    }),
    transl: frames.map((f) => applied(UPRIGHT_FROM_AMASS, trans.values.slice(3 * f, 3 * f + 3))),
  };
}

// The arrays of these names that the archive has: {shape, values}. Its directory lies at its end.
async function readNpz(buffer, names) {
  const view = new DataView(buffer);
  let end = buffer.byteLength - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw new Error("it is no archive of numpy's");
  const arrays = {};
  for (let at = view.getUint32(end + 16, true), left = view.getUint16(end + 10, true); left > 0; left--) {
    const [length, extra, comment] = [28, 30, 32].map((field) => view.getUint16(at + field, true));
    const name = new TextDecoder().decode(new Uint8Array(buffer, at + 46, length)).replace(/\.npy$/, "");
    if (names.includes(name)) {
      const start = view.getUint32(at + 42, true);
      const skipped = 30 + view.getUint16(start + 26, true) + view.getUint16(start + 28, true);
      const packed = new Uint8Array(buffer, start + skipped, view.getUint32(at + 20, true));
      arrays[name] = readNpy(await inflated(packed, view.getUint16(at + 10, true)), name);
    }
    at += 46 + length + extra + comment;
  }
  return arrays;
}

async function inflated(packed, method) {
  if (method === 0) return packed.slice().buffer;
  if (method !== 8) throw new Error(`it is packed by method ${method}, which a browser cannot unpack`);
  return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer();
}

function readNpy(buffer, name) {
  const view = new DataView(buffer);
  const long = view.getUint8(6) > 1; // of the header's own length
  const start = long ? 12 : 10;
  const size = long ? view.getUint32(8, true) : view.getUint16(8, true);
  const header = new TextDecoder().decode(new Uint8Array(buffer, start, size));
  const type = /'descr': *'([^']*)'/.exec(header)?.[1];
  const shape = (/'shape': *\(([^)]*)\)/.exec(header)?.[1] ?? "").split(",").filter((word) => word.trim()).map(Number);
  if (!(type in NUMPY_TYPES)) throw new Error(`${name} holds ${type}, not numbers`);
  if (shape.length > 1 && /'fortran_order': *True/.test(header)) throw new Error(`${name} is stored column by column`);
  const count = shape.reduce((size, side) => size * side, 1);
  return { shape, values: Array.from(new NUMPY_TYPES[type](buffer.slice(start + size), 0, count), Number) };
}
