// Clip: a motion as a WebM file, frame by frame, however long a frame takes to draw.
//
// The browser encodes VP8, what is around it is Matroska's: elements of an id, a size in eight bytes and
// their content. Times are milliseconds.

const CLIP_RATE = 30; // frames a second
const KEY_FRAMES = 30; // frames from one that stands alone to the next, each of which starts a cluster

// `draw(seconds)` returns a canvas that shows this time; `report(share)` is told how far it is and
// returns false to stop early. Returns the file.
async function recordedClip(draw, duration, speed, report) {
  if (!window.VideoEncoder) throw new Error("this browser cannot encode video");
  const blocks = [];
  let failure = null;
  const encoder = new VideoEncoder({
    output: (chunk) => {
      const data = new Uint8Array(chunk.byteLength);
      chunk.copyTo(data);
      blocks.push({ data, milliseconds: Math.round(chunk.timestamp / 1000), key: chunk.type === "key" });
    },
    error: (error) => (failure = error),
  });
  const count = Math.max(Math.round((duration / speed) * CLIP_RATE), 1);
  let [width, height] = [0, 0];
  for (let number = 0; number < count && !failure; number++) {
    const canvas = draw((number / CLIP_RATE) * speed);
    if (number === 0) {
      [width, height] = [canvas.width, canvas.height].map((side) => side - (side % 2));
      encoder.configure({ codec: "vp8", width, height, bitrate: 8e6, framerate: CLIP_RATE });
    }
    const frame = new VideoFrame(canvas, {
      timestamp: (number * 1e6) / CLIP_RATE,
      duration: 1e6 / CLIP_RATE,
      visibleRect: { x: 0, y: 0, width, height },
      alpha: "discard",
    });
    encoder.encode(frame, { keyFrame: number % KEY_FRAMES === 0 });
    frame.close();
    if (!report((number + 1) / count)) break;
    await new Promise((resolve) => setTimeout(resolve));
  }
  if (failure) throw failure;
  await encoder.flush();
  encoder.close();
  return new Blob([webmFile(blocks, width, height)], { type: "video/webm" });
}

function webmFile(blocks, width, height) {
  const duration = new Uint8Array(8);
  new DataView(duration.buffer).setFloat64(0, blocks[blocks.length - 1].milliseconds + 1000 / CLIP_RATE);
  const clusters = [];
  for (const block of blocks) {
    if (block.key) clusters.push([]);
    clusters[clusters.length - 1].push(block);
  }
  const header = element(0x1a45dfa3, [
    element(0x4286, bigEndian(1)), // version,
    element(0x42f7, bigEndian(1)), // of readers
    element(0x42f2, bigEndian(4)), // longest id
    element(0x42f3, bigEndian(8)), // longest size
    element(0x4282, letters("webm")),
    element(0x4287, bigEndian(4)),
    element(0x4285, bigEndian(2)),
  ]);
  const info = element(0x1549a966, [
    element(0x2ad7b1, bigEndian(1000000)), // nanoseconds a unit of time
    element(0x4489, duration),
    element(0x4d80, letters("deblur_avatar")),
    element(0x5741, letters("deblur_avatar")),
  ]);
  const track = element(0xae, [
    element(0xd7, bigEndian(1)), // number
    element(0x73c5, bigEndian(1)), // and a number that is nobody else's
    element(0x83, bigEndian(1)), // video
    element(0x86, letters("V_VP8")),
    element(0xe0, [element(0xb0, bigEndian(width)), element(0xba, bigEndian(height))]),
  ]);
  const content = [info, element(0x1654ae6b, [track]), ...clusters.map(clusterOf)];
  return joined([header, element(0x18538067, content)]);
}

function clusterOf(blocks) {
  const start = blocks[0].milliseconds;
  return element(0x1f43b675, [
    element(0xe7, bigEndian(start)),
    ...blocks.map(({ data, milliseconds, key }) => {
      const after = milliseconds - start;
      return element(0xa3, [Uint8Array.of(0x81, after >> 8, after & 255, key ? 0x80 : 0), data]);
    }),
  ]);
}

function element(id, content) {
  const bytes = Array.isArray(content) ? joined(content) : content;
  const size = bigEndian(bytes.length, 7);
  return joined([bigEndian(id), Uint8Array.of(1), size, bytes]);
}

// A whole number in as many bytes as it needs, or in so many.
function bigEndian(number, width = 0) {
  const bytes = [];
  for (let rest = number; rest > 0 || bytes.length < Math.max(width, 1); rest = Math.floor(rest / 256)) {
    bytes.unshift(rest % 256);
  }
  return Uint8Array.from(bytes);
}

function letters(text) {
  return new TextEncoder().encode(text);
}

function joined(parts) {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
