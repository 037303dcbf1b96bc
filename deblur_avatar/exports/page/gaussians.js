// Gaussians: posed by linear blend skinning, projected, and put in order for drawing.
//
// The same formulas and limits as the project's rasterizer (rendering/conventions.py, from where the
// header has the numbers): linearised pinhole, 0.3 square pixels of low-pass, slopes clamped beyond
// the picture's edge, order by the depth of centres. A camera is {rotation [9], translation [3], fx, fy,
// cx, cy, width, height}, OpenCV axes, pixel centres at halves.

const SPLAT = 12; // numbers of a projected Gaussian: centre, first half axis, ratio, conic, colour, opacity
const SPLATS_A_ROW = 256; // of the texture that takes them to the graphics card, three texels each
const NUMBERS = 2 ** 20; // Gaussians that a sorting key can tell apart
const DEPTHS = 2 ** 32 - 1; // and steps of depth: 53 bits hold both

// Means [N, 3] and factors [N, 3, 3] of the Gaussians, moved by the blended transforms. The blended
// rotation is not made orthonormal again: covariances stretch as the skin does.
function posedGaussians(avatar, transforms, out) {
  const { means, factors, weights, bones } = avatar;
  const influences = weights.length / avatar.count;
  const blend = new Float64Array(12);
  for (let n = 0; n < avatar.count; n++) {
    blend.fill(0);
    for (let i = n * influences; i < (n + 1) * influences; i++) {
      const weight = weights[i];
      if (weight === 0) continue;
      const bone = 12 * bones[i];
      for (let k = 0; k < 12; k++) blend[k] += weight * transforms[bone + k];
    }
    const [x, y, z] = [means[3 * n], means[3 * n + 1], means[3 * n + 2]];
    for (let row = 0; row < 3; row++) {
      const [a, b, c] = [blend[4 * row], blend[4 * row + 1], blend[4 * row + 2]];
      out.means[3 * n + row] = a * x + b * y + c * z + blend[4 * row + 3];
      for (let column = 0; column < 3; column++) {
        const at = 9 * n + column;
        out.factors[9 * n + 3 * row + column] = a * factors[at] + b * factors[at + 3] + c * factors[at + 6];
      }
    }
  }
  return out;
}

// Ellipses of the visible Gaussians, farthest first, in out.splats; returns how many there are.
function projectGaussians(avatar, posed, camera, limits, out) {
  const [depths, keys] = [out.depths, out.keys];
  let [near, far] = [Infinity, -Infinity];
  const visible = [];
  for (let n = 0; n < avatar.count; n++) {
    depths[n] = depthOf(posed.means, n, camera);
    if (depths[n] >= limits.near_plane && avatar.opacities[n] >= limits.min_alpha) {
      visible.push(n);
      near = Math.min(near, depths[n]);
      far = Math.max(far, depths[n]);
    }
  }
  const scale = DEPTHS / Math.max(far - near, 1e-9);
  visible.forEach((n, i) => {
    keys[i] = Math.floor((depths[n] - near) * scale) * NUMBERS + n;
  });
  const sorted = keys.subarray(0, visible.length).sort();
  let count = 0;
  for (let i = sorted.length - 1; i >= 0; i--) {
    const n = sorted[i] % NUMBERS;
    if (projectOne(avatar, posed, camera, limits, n, depths[n], out.splats, SPLAT * count)) count++;
  }
  return count;
}

function depthOf(means, n, { rotation, translation }) {
  return rotation[6] * means[3 * n] + rotation[7] * means[3 * n + 1] + rotation[8] * means[3 * n + 2] + translation[2];
}

// Writes one ellipse; false if no pixel of the picture is in its box.
function projectOne(avatar, posed, camera, limits, n, depth, out, to) {
  const { rotation: r, translation: t, fx, fy, cx, cy, width, height } = camera;
  const [x, y, z] = [posed.means[3 * n], posed.means[3 * n + 1], posed.means[3 * n + 2]];
  const slopeX = (r[0] * x + r[1] * y + r[2] * z + t[0]) / depth;
  const slopeY = (r[3] * x + r[4] * y + r[5] * z + t[1]) / depth;
  const clampedX = clampSlope(slopeX, fx, cx, width, limits.view_margin);
  const clampedY = clampSlope(slopeY, fy, cy, height, limits.view_margin);
  let [xx, xy, yy] = [limits.eps2d, 0, limits.eps2d];
  for (let column = 0; column < 3; column++) {
    const at = 9 * n + column;
    const [a, b, c] = [posed.factors[at], posed.factors[at + 3], posed.factors[at + 6]];
    const forward = r[6] * a + r[7] * b + r[8] * c;
    const u = (fx / depth) * (r[0] * a + r[1] * b + r[2] * c - clampedX * forward);
    const v = (fy / depth) * (r[3] * a + r[4] * b + r[5] * c - clampedY * forward);
    xx += u * u;
    xy += u * v;
    yy += v * v;
  }
  const reach = 2 * Math.log(avatar.opacities[n] / limits.min_alpha);
  const [centreX, centreY] = [fx * slopeX + cx, fy * slopeY + cy];
  const [halfX, halfY] = [Math.sqrt(reach * xx), Math.sqrt(reach * yy)];
  if (centreX + halfX < 0 || centreX - halfX > width || centreY + halfY < 0 || centreY - halfY > height) return false;
  // The longer half axis of the ellipse of faintest opacity, and how much shorter the other one is.
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const angle = Math.atan2(2 * xy, xx - yy) / 2;
  const long = Math.sqrt(reach * (mean + spread));
  const determinant = xx * yy - xy * xy;
  out[to] = centreX;
  out[to + 1] = centreY;
  out[to + 2] = long * Math.cos(angle);
  out[to + 3] = long * Math.sin(angle);
  out[to + 4] = Math.sqrt(Math.max(mean - spread, 0) / (mean + spread));
  out[to + 5] = yy / determinant;
  out[to + 6] = -xy / determinant;
  out[to + 7] = xx / determinant;
  for (let k = 0; k < 3; k++) out[to + 8 + k] = avatar.colors[3 * n + k];
  out[to + 11] = avatar.opacities[n];
  return true;
}

function clampSlope(slope, focal, centre, size, margin) {
  const beyond = (margin * 0.5 * size) / focal;
  return Math.min(Math.max(slope, -centre / focal - beyond), (size - centre) / focal + beyond);
}

// Memory for one avatar's Gaussians, used again for every picture.
function gaussianBuffers(count) {
  return {
    means: new Float64Array(3 * count),
    factors: new Float64Array(9 * count),
    depths: new Float64Array(count),
    keys: new Float64Array(count),
    splats: new Float32Array(SPLAT * Math.ceil(count / SPLATS_A_ROW) * SPLATS_A_ROW),
  };
}
