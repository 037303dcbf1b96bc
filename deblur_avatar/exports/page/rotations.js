// Rotations: small linear algebra of arrays. A matrix is nine numbers, row by row, a quaternion wxyz.

const SWEEPS = 50; // of Jacobi's rotations, at most; a handful do

function plus(a, b) {
  return a.map((value, k) => value + b[k]);
}

function minus(a, b) {
  return a.map((value, k) => value - b[k]);
}

function times(a, factor) {
  return a.map((value) => factor * value);
}

function mean(rows) {
  return times(rows.reduce(plus), 1 / rows.length);
}

function unit(vector) {
  return times(vector, 1 / Math.max(Math.hypot(...vector), 1e-12));
}

// What of a vector is at right angles to a unit vector.
function across(vector, direction) {
  return minus(vector, times(direction, dot(vector, direction)));
}

function product(a, b) {
  return a.map((_, k) => {
    const [row, column] = [3 * Math.floor(k / 3), k % 3];
    return a[row] * b[column] + a[row + 1] * b[column + 3] + a[row + 2] * b[column + 6];
  });
}

function transposed(m) {
  return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
}

function applied(m, v) {
  return [0, 3, 6].map((row) => m[row] * v[0] + m[row + 1] * v[1] + m[row + 2] * v[2]);
}

function fromColumns(x, y, z) {
  return [0, 1, 2].flatMap((k) => [x[k], y[k], z[k]]);
}

// Rotation by an angle, radians, about a unit vector.
function aboutAxis(axis, angle) {
  return matrixOf([Math.cos(angle / 2), ...times(axis, Math.sin(angle / 2))]);
}

// Rotation about a vector by its length, radians.
function ofAxisAngle(vector) {
  return aboutAxis(unit(vector), Math.hypot(...vector));
}

function matrixOf(quat) {
  const out = new Array(9);
  matrixOfQuat(quat, 0, out, 0, 3);
  return out;
}

// The rotation nearest to a matrix in the sum of squares.
function nearestRotation(m) {
  return matrixOf(quatOf(m));
}

// Quaternion of the rotation nearest to a matrix: the eigenvector of Davenport's symmetric matrix with the
// largest value, by Jacobi's method. Source: Horn, "Closed-form solution of absolute orientation", 1987.
function quatOf(m) {
  const [xx, xy, xz, yx, yy, yz, zx, zy, zz] = m;
  const a = [
    [xx + yy + zz, zy - yz, xz - zx, yx - xy],
    [zy - yz, xx - yy - zz, xy + yx, xz + zx],
    [xz - zx, xy + yx, yy - xx - zz, yz + zy],
    [yx - xy, xz + zx, yz + zy, zz - xx - yy],
  ];
  const vectors = [0, 1, 2, 3].map((row) => [0, 1, 2, 3].map((column) => Number(row === column)));
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    let off = 0;
    for (let p = 0; p < 3; p++) for (let q = p + 1; q < 4; q++) off += a[p][q] * a[p][q];
    if (off < 1e-30) break;
    for (let p = 0; p < 3; p++) for (let q = p + 1; q < 4; q++) jacobi(a, vectors, p, q);
  }
  const values = [0, 1, 2, 3].map((k) => a[k][k]);
  const best = values.indexOf(Math.max(...values));
  return vectors.map((row) => row[best]);
}

// Turns the plane of two axes so that a[p][q] vanishes.
function jacobi(a, vectors, p, q) {
  const angle = 0.5 * Math.atan2(2 * a[p][q], a[q][q] - a[p][p]);
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  for (const rows of [a, vectors]) {
    for (const row of rows) [row[p], row[q]] = [c * row[p] - s * row[q], s * row[p] + c * row[q]];
  }
  for (let k = 0; k < 4; k++) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
}

// The value under which a share of the numbers lies, in straight lines between them.
function quantile(numbers, share) {
  const sorted = [...numbers].sort((a, b) => a - b);
  const at = share * (sorted.length - 1);
  const below = Math.floor(at);
  return sorted[below] + (at - below) * (sorted[Math.min(below + 1, sorted.length - 1)] - sorted[below]);
}
