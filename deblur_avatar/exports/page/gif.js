// GIF: a motion in 256 colours, for where a video cannot be shown.
//
// One palette for all frames, by median cut over a few of them; where it has no colour that is near, ordered
// dithering, which stays where it is from frame to frame. Transparent pixels stay transparent, by half or not at all. Times are hundredths of
// a second. Source: Heckbert, "Color image quantization for frame buffer display", SIGGRAPH 1982; the GIF89a
// specification.

const GIF_RATE = 25; // frames a second: a whole number of hundredths each
const GIF_SIDE = 480; // pixels of the longer side, at most
const SAMPLED = 6; // frames that the palette is chosen from
const COLOURS = 255; // and one that is no colour
const NO_COLOUR = 255;
const CELL_BITS = 6; // of each of red, green and blue, that cells of the palette's histogram are told apart by
const DITHER = 6; // of 255, between the darkest and the lightest threshold
const BAYER = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5]; // of 16, four by four

// `draw(seconds)` and `report(share)` as for recordedClip; returns the file.
async function recordedGif(draw, duration, speed, report) {
  const small = document.createElement("canvas");
  const frameAt = (seconds) => shrunk(draw(seconds), small);
  const count = Math.max(Math.round((duration / speed) * GIF_RATE), 1);
  const samples = Array.from({ length: SAMPLED }, (_, k) => frameAt((duration * k) / SAMPLED).data);
  const palette = medianCut(samples);
  const nearest = new Int16Array(1 << (3 * CELL_BITS)).fill(-1); // colour of a cell, once one is asked for
  const blocks = [];
  for (let number = 0; number < count; number++) {
    const frame = frameAt((number / GIF_RATE) * speed);
    if (number === 0) blocks.push(gifHeader(frame, palette));
    blocks.push(gifFrame(frame, dithered(frame, palette, nearest)));
    if (!report((number + 1) / count)) break;
    await new Promise((resolve) => setTimeout(resolve));
  }
  return new Blob([...blocks, Uint8Array.of(0x3b)], { type: "image/gif" });
}

// Pixels of a canvas, drawn smaller where it is larger than a GIF is to be.
function shrunk(canvas, small) {
  const scale = Math.min(GIF_SIDE / Math.max(canvas.width, canvas.height), 1);
  const [width, height] = [canvas.width, canvas.height].map((side) => Math.max(Math.round(side * scale), 1));
  if (small.width !== width || small.height !== height) [small.width, small.height] = [width, height];
  const context = small.getContext("2d", { willReadFrequently: true });
  context.clearRect(0, 0, width, height);
  context.drawImage(canvas, 0, 0, width, height);
  return context.getImageData(0, 0, width, height);
}

// Up to COLOURS colours [r, g, b]: the box with the largest spread, weighted by its pixels, is cut at its
// median until there are as many.
function medianCut(frames) {
  const cells = new Map();
  for (const data of frames) {
    for (let at = 0; at < data.length; at += 4) {
      if (data[at + 3] < 128) continue;
      const key = cellOf(data[at], data[at + 1], data[at + 2]);
      const cell = cells.get(key) ?? { sum: [0, 0, 0], count: 0 };
      for (let k = 0; k < 3; k++) cell.sum[k] += data[at + k];
      cell.count++;
      cells.set(key, cell);
    }
  }
  const colours = [...cells.values()].map(({ sum, count }) => ({ colour: times(sum, 1 / count), count, weight: Math.sqrt(count) }));
  const boxes = [boxOf(colours)];
  while (boxes.length < COLOURS) {
    const widest = boxes.reduce((best, box) => (box.spread > best.spread ? box : best));
    if (widest.spread === 0) break;
    boxes.splice(boxes.indexOf(widest), 1, ...cutBox(widest));
  }
  return boxes.map(({ colours: own }) => meanColour(own).map(Math.round));
}

function boxOf(colours) {
  let [axis, length, weight] = [0, 0, 0];
  for (const one of colours) weight += one.weight;
  for (let k = 0; k < 3; k++) {
    let [low, high] = [Infinity, -Infinity];
    for (const { colour } of colours) [low, high] = [Math.min(low, colour[k]), Math.max(high, colour[k])];
    if (high - low > length) [axis, length] = [k, high - low];
  }
  return { colours, axis, weight, spread: length * weight };
}

function cutBox({ colours, axis, weight }) {
  const sorted = [...colours].sort((a, b) => a.colour[axis] - b.colour[axis]);
  let [sum, at] = [0, 0];
  while (at < sorted.length - 1 && (at === 0 || sum < weight / 2)) sum += sorted[at++].weight;
  return [boxOf(sorted.slice(0, at)), boxOf(sorted.slice(at))];
}

function meanColour(colours) {
  const pixels = colours.reduce((sum, one) => sum + one.count, 0);
  return times(colours.reduce((sum, one) => plus(sum, times(one.colour, one.count)), [0, 0, 0]), 1 / Math.max(pixels, 1));
}

function cellOf(r, g, b) {
  const drop = 8 - CELL_BITS;
  return ((r >> drop) << (2 * CELL_BITS)) | ((g >> drop) << CELL_BITS) | (b >> drop);
}

// The colour's number of every pixel.
function dithered({ data, width }, palette, nearest) {
  const indices = new Uint8Array(data.length / 4);
  const shift = BAYER.map((step) => ((step + 0.5) / BAYER.length - 0.5) * DITHER);
  for (let i = 0; i < indices.length; i++) {
    if (data[4 * i + 3] < 128) {
      indices[i] = NO_COLOUR;
      continue;
    }
    const pixel = data.subarray(4 * i, 4 * i + 3);
    indices[i] = lookedUp(pixel, palette, nearest);
    if (pixel.every((value, k) => Math.abs(value - palette[indices[i]][k]) <= DITHER / 2)) continue;
    const by = shift[4 * (Math.floor(i / width) % 4) + ((i % width) % 4)];
    indices[i] = lookedUp([...pixel].map((value) => Math.min(Math.max(Math.round(value + by), 0), 255)), palette, nearest);
  }
  return indices;
}

function lookedUp([r, g, b], palette, nearest) {
  const cell = cellOf(r, g, b);
  if (nearest[cell] < 0) nearest[cell] = nearestColour([r, g, b], palette);
  return nearest[cell];
}

function nearestColour([r, g, b], palette) {
  let [best, least] = [0, Infinity];
  palette.forEach((colour, index) => {
    const distance = (colour[0] - r) ** 2 + (colour[1] - g) ** 2 + (colour[2] - b) ** 2;
    if (distance < least) [best, least] = [index, distance];
  });
  return best;
}

function gifHeader({ width, height }, palette) {
  const table = new Uint8Array(3 * 256);
  palette.forEach((colour, index) => table.set(colour, 3 * index));
  const screen = [...littleEndian(width), ...littleEndian(height), 0xf7, NO_COLOUR, 0]; // a table of 256 colours
  const forever = [0x21, 0xff, 11, ...letters("NETSCAPE2.0"), 3, 1, 0, 0, 0];
  return joined([letters("GIF89a"), Uint8Array.from(screen), table, Uint8Array.from(forever)]);
}

function gifFrame({ width, height }, indices) {
  // What was drawn before goes; the colour without one is transparent.
  const control = [0x21, 0xf9, 4, 0b1001, ...littleEndian(100 / GIF_RATE), NO_COLOUR, 0];
  const place = [0x2c, 0, 0, 0, 0, ...littleEndian(width), ...littleEndian(height), 0, 8];
  const packed = lzw(indices);
  const blocks = [];
  for (let at = 0; at < packed.length; at += 255) {
    const block = packed.subarray(at, at + 255);
    blocks.push(Uint8Array.of(block.length), block);
  }
  return joined([Uint8Array.from([...control, ...place]), ...blocks, Uint8Array.of(0)]);
}

// Lempel, Ziv and Welch's code of bytes, in codes of 9 to 12 bits, lowest bits first.
function lzw(bytes) {
  const [clear, end] = [256, 257];
  const follow = new Int16Array(4096 * 256); // code of a known string and one byte more, 0 where there is none
  const out = [];
  let [bits, held, width, next] = [0, 0, 9, 258];
  const write = (code) => {
    bits |= code << held;
    for (held += width; held >= 8; held -= 8, bits >>= 8) out.push(bits & 255);
  };
  write(clear);
  let known = bytes[0];
  for (let i = 1; i < bytes.length; i++) {
    const at = known * 256 + bytes[i];
    if (follow[at]) {
      known = follow[at];
      continue;
    }
    write(known);
    known = bytes[i];
    if (next < 4096) {
      if (next === 1 << width) width++;
      follow[at] = next++;
    } else {
      write(clear);
      follow.fill(0);
      [width, next] = [9, 258];
    }
  }
  write(known);
  write(end);
  if (held > 0) out.push(bits & 255);
  return Uint8Array.from(out);
}

function littleEndian(number) {
  return [number & 255, number >> 8];
}
