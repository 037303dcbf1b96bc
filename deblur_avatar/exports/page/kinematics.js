// Kinematics: local rotations of joints at any time, and the transforms that pose an avatar.
//
// Quaternions are wxyz. A transform is 12 numbers, three rows of a 3 x 4 matrix. Parents come before
// their children, the root's parent is -1.

// Writes the matrix of quats[at .. at + 3], normalised, into out from `to` on, `stride` numbers a row.
function matrixOfQuat(quats, at, out, to, stride) {
  let [w, x, y, z] = [quats[at], quats[at + 1], quats[at + 2], quats[at + 3]];
  const norm = Math.hypot(w, x, y, z);
  [w, x, y, z] = [w / norm, x / norm, y / norm, z / norm];
  out[to] = 1 - 2 * (y * y + z * z);
  out[to + 1] = 2 * (x * y - w * z);
  out[to + 2] = 2 * (x * z + w * y);
  out[to + stride] = 2 * (x * y + w * z);
  out[to + stride + 1] = 1 - 2 * (x * x + z * z);
  out[to + stride + 2] = 2 * (y * z - w * x);
  out[to + 2 * stride] = 2 * (x * z - w * y);
  out[to + 2 * stride + 1] = 2 * (y * z + w * x);
  out[to + 2 * stride + 2] = 1 - 2 * (x * x + y * y);
}

function multiplyQuats([aw, ax, ay, az], [bw, bx, by, bz]) {
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

// Turns about x, then y, then z of the parent's axes, degrees.
function quatOfDegrees([x, y, z]) {
  const half = (degrees) => (degrees * Math.PI) / 360;
  const about = (angle, axis) => [Math.cos(angle), ...[0, 1, 2].map((k) => (k === axis ? Math.sin(angle) : 0))];
  return multiplyQuats(about(half(z), 2), multiplyQuats(about(half(y), 1), about(half(x), 0)));
}

// Local rotations [J, 4] and root translation at a time: along the shorter arc between frames, places
// in straight lines; before the first frame and after the last the pose stays.
function poseAt(motion, seconds) {
  const { times, quats, transl } = motion;
  const last = times.length - 1;
  let after = 1;
  while (after < last && times[after] < seconds) after++;
  after = Math.min(after, last);
  const before = Math.max(after - 1, 0);
  const gap = times[after] - times[before];
  const share = gap > 0 ? Math.min(Math.max((seconds - times[before]) / gap, 0), 1) : 0;
  const width = quats.length / times.length;
  const pose = { quats: new Float64Array(width), transl: new Float64Array(3) };
  for (let k = 0; k < width; k += 4) {
    turnBetween(quats, before * width + k, after * width + k, share, pose.quats, k);
  }
  for (let k = 0; k < 3; k++) {
    pose.transl[k] = (1 - share) * transl[3 * before + k] + share * transl[3 * after + k];
  }
  return pose;
}

function turnBetween(quats, a, b, share, out, to) {
  let dot = 0;
  for (let k = 0; k < 4; k++) dot += quats[a + k] * quats[b + k];
  const sign = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(Math.abs(dot), 1));
  const small = angle < 1e-6;
  const first = small ? 1 - share : Math.sin((1 - share) * angle) / Math.sin(angle);
  const second = sign * (small ? share : Math.sin(share * angle) / Math.sin(angle));
  for (let k = 0; k < 4; k++) out[to + k] = first * quats[a + k] + second * quats[b + k];
}

// Turns joints of a pose further: bends is {joint: [x, y, z] degrees}.
function bentPose(pose, bends) {
  const quats = pose.quats.slice();
  for (const [joint, degrees] of Object.entries(bends)) {
    const own = quats.subarray(4 * joint, 4 * joint + 4);
    own.set(multiplyQuats(own, quatOfDegrees(degrees)));
  }
  return { ...pose, quats };
}

// Transforms of all joints from the canonical to the given pose, 12 numbers each.
function jointTransforms(avatar, pose) {
  const { parents, joints, rest_from_canonical: restFromCanonical } = avatar;
  const world = new Float64Array(12 * parents.length); // from a joint's own frame
  const posed = new Float64Array(12 * parents.length);
  const local = new Float64Array(12);
  const back = new Float64Array(12); // from rest to a joint's own frame
  back[0] = back[5] = back[10] = 1;
  for (let j = 0; j < parents.length; j++) {
    const parent = parents[j];
    matrixOfQuat(pose.quats, 4 * j, local, 0, 4);
    for (let k = 0; k < 3; k++) {
      local[4 * k + 3] = joints[3 * j + k] - (parent < 0 ? 0 : joints[3 * parent + k]);
      back[4 * k + 3] = -joints[3 * j + k];
    }
    if (parent < 0) world.set(local, 12 * j);
    else compose(world, 12 * parent, local, 0, world, 12 * j);
    const restToPosed = new Float64Array(12);
    compose(world, 12 * j, back, 0, restToPosed, 0);
    for (let k = 0; k < 3; k++) restToPosed[4 * k + 3] += pose.transl[k];
    compose(restToPosed, 0, restFromCanonical, 12 * j, posed, 12 * j);
  }
  return posed;
}

// Positions of all joints, given the transforms; the canonical joints are those at rest, moved back.
function jointPositions(avatar, transforms) {
  const positions = new Float64Array(avatar.joints.length);
  for (let j = 0; j < avatar.parents.length; j++) {
    for (let k = 0; k < 3; k++) {
      const row = 12 * j + 4 * k;
      let sum = transforms[row + 3];
      for (let c = 0; c < 3; c++) sum += transforms[row + c] * avatar.canonical_joints[3 * j + c];
      positions[3 * j + k] = sum;
    }
  }
  return positions;
}

// out = a b, of 3 x 4 matrices with an implied last row.
function compose(a, atA, b, atB, out, to) {
  for (let row = 0; row < 3; row++) {
    for (let column = 0; column < 4; column++) {
      let sum = column === 3 ? a[atA + 4 * row + 3] : 0;
      for (let k = 0; k < 3; k++) sum += a[atA + 4 * row + k] * b[atB + 4 * k + column];
      out[to + 4 * row + column] = sum;
    }
  }
}
