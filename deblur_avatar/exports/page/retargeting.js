// Retargeting: the motion of any humanoid skeleton as poses of the avatar's joints.
//
// The method of animation/retargeting.py and animation/rig_names.py, which say why; names and thresholds
// come from there through the page's header. A matrix is nine numbers, row by row; `fitted` holds for each
// joint how its own frame sees the avatar's T-pose.

const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];
const UP = [0, 1, 0];
const FORWARD = [0, 0, 1];
const BACKWARD = [0, 0, -1];
const LEG = [["left_hip", "left_knee"], ["left_knee", "left_ankle"]];

// Local rotations [F][J] of the avatar's joints and its translation [F][3], upright, in metres; `moving` are
// the joints below the hips that leave their place, which is ignored.
function retargeted(skeleton, avatar, rules) {
  const rig = recognised(skeleton.names, skeleton.parents, rules.names);
  const { motion, moving } = carried(skeleton, rig, rules);
  const rest = Object.fromEntries(avatar.joint_names.map((name, j) => [name, [...avatar.joints.slice(3 * j, 3 * j + 3)]]));
  const { world, places } = worldOf(motion);
  const upright = uprightOf(places, rig);
  const turned = world.map((frame) => frame.map((rotation) => product(upright, rotation)));
  const risen = places.map((frame) => frame.map((place) => applied(upright, place)));
  const fitted = restFrames(motion, rig, turned, risen, rest, rules);
  const rotations = turned.map((frame) => localRotations(avatar, rig, frame, fitted));
  const scale = scaleOf(motion, rig, rest);
  const transl = risen.map((frame) => minus(times(frame[rig.pelvis], scale), rest.pelvis));
  return { step: motion.step, rotations, transl, moving };
}

// The motion with the positions of those joints alone that carry the hips, where they say more than offsets do.
function carried(motion, rig, rules) {
  const { names, parents, offsets, positions } = motion;
  const limit = rules.loose * legLength(motion, rig);
  const rests = (joint) => [offsets[joint], [0, 0, 0]].some(
    (place) => positions[joint].every((one) => Math.hypot(...minus(one, place)) <= limit));
  const off = Object.keys(positions).map(Number).filter((joint) => joint > 0 && !rests(joint));
  const above = pathOf(motion, 0, rig.pelvis);
  const body = new Set(Object.values(rig).flatMap((joint) => pathOf(motion, rig.pelvis, joint)));
  const kept = [0, ...off.filter((joint) => above.includes(joint))];
  return {
    motion: { ...motion, positions: Object.fromEntries(kept.map((joint) => [joint, positions[joint]])) },
    moving: off.filter((joint) => body.has(joint)).map((joint) => names[joint]),
  };
}

// Which joint of a skeleton is which of the avatar's, by name and by what lies between those.
function recognised(names, parents, known) {
  const plain = names.map(plainName);
  const found = {};
  for (const [joint, forms] of Object.entries(known)) {
    const form = forms.find((one) => plain.includes(one));
    if (form !== undefined) found[joint] = plain.indexOf(form);
  }
  const missing = Object.keys(known).filter((joint) => !(joint in found));
  if (missing.length) {
    throw new Error(`the skeleton has no joint for ${missing.join(", ")}; it has ${names.join(", ")}. Names as mixamo's, CMU's or Bandai Namco's are understood`);
  }
  const ways = {};
  for (const [joint, index] of Object.entries(found)) {
    ways[joint] = [];
    for (let at = index; at !== found.pelvis; at = parents[at]) {
      if (at < 0) throw new Error(`${names[index]} does not hang on ${names[found.pelvis]}`);
      ways[joint].unshift(at);
    }
  }
  const shared = ways.left_shoulder.filter((at) => ways.right_shoulder.includes(at) && ways.head.includes(at));
  if (!shared.length) throw new Error("arms and head must hang on one chest above the pelvis");
  const below = shared.slice(0, -1);
  found.spine3 = shared[shared.length - 1];
  if (below.length) found.spine1 = below[0];
  if (below.length > 1) found.spine2 = below[Math.floor(below.length / 2)];
  const neck = ways.head.slice(shared.length, -1);
  if (neck.length) found.neck = neck[0];
  for (const side of ["left", "right"]) {
    const collar = ways[`${side}_shoulder`].slice(shared.length, -1);
    if (collar.length) found[`${side}_collar`] = collar[collar.length - 1];
  }
  return found;
}

// A name to be compared, its side first.
function plainName(name) {
  const own = name.split(":").pop().toLowerCase();
  return own.replace(/^(.+)[^a-z0-9](left|right|l|r)$/, "$2$1").replace(/[^a-z0-9]/g, "");
}

// World rotations [F][J] and places [F][J] of all joints, in the file's axes and unit.
function worldOf({ parents, offsets, rotations, positions }) {
  const world = rotations.map((frame) => {
    const above = [];
    frame.forEach((local, j) => above.push(parents[j] < 0 ? local : product(above[parents[j]], local)));
    return above;
  });
  return {
    world,
    places: world.map((turned, f) => {
      const known = [];
      offsets.forEach((offset, j) => {
        const parent = parents[j];
        const place = positions[j]?.[f] ?? offset;
        known.push(parent < 0 ? place : plus(known[parent], applied(turned[parent], place)));
      });
      return known;
    }),
  };
}

// Rotation that takes the file's vertical, along which heads are above feet, to +Y.
function uprightOf(places, rig) {
  const height = mean(places.map((frame) => minus(frame[rig.head], times(plus(frame[rig.left_ankle], frame[rig.right_ankle]), 0.5))));
  const sizes = height.map(Math.abs);
  const axis = sizes.indexOf(Math.max(...sizes));
  return swing(IDENTITY, [0, 1, 2].map((k) => (k === axis ? Math.sign(height[axis]) || -1 : 0)), UP);
}

// Length of the avatar's legs over that of the skeleton's.
function scaleOf(motion, rig, rest) {
  const ours = LEG.reduce((sum, [upper, lower]) => sum + Math.hypot(...minus(rest[lower], rest[upper])), 0);
  return ours / legLength(motion, rig);
}

function legLength(motion, rig) {
  const steps = LEG.flatMap(([upper, lower]) => pathOf(motion, rig[upper], rig[lower]));
  return steps.reduce((sum, step) => sum + Math.hypot(...motion.offsets[step]), 0);
}

function restFrames(motion, rig, turned, places, rest, rules) {
  const aim = (joint, target) => aimOf(motion, rig[joint], rig[target]);
  const bone = (joint, child) => unit(minus(rest[child], rest[joint]));
  const fitted = {
    pelvis: frameOf(minus(aim("pelvis", "left_hip"), aim("pelvis", "right_hip")), aim("pelvis", "spine3")),
    spine3: frameOf(minus(aim("spine3", "left_shoulder"), aim("spine3", "right_shoulder")), aim("spine3", "head")),
  };
  let above = fitted.pelvis;
  for (const [joint, child] of [["spine1", "spine2"], ["spine2", "spine3"]]) {
    if (joint in rig) above = fitted[joint] = swing(above, UP, aim(joint, child in rig ? child : "spine3"));
  }
  above = fitted.spine3;
  if ("neck" in rig) above = fitted.neck = swing(above, UP, aim("neck", "head"));
  fitted.head = meanFrame(turned, rig.head, rig["neck" in rig ? "neck" : "spine3"], above);
  for (const side of ["left", "right"]) {
    const [hip, knee, ankle] = ["hip", "knee", "ankle"].map((name) => `${side}_${name}`);
    const thigh = swing(fitted.pelvis, bone(hip, knee), aim(hip, knee));
    const shin = directions(turned, rig[hip], rig[knee], aim(knee, ankle));
    fitted[hip] = twist(thigh, bone(hip, knee), shin, bone(knee, ankle), BACKWARD, rules.min_bend);
    fitted[knee] = swing(fitted[hip], bone(knee, ankle), aim(knee, ankle));
    const heights = places.map((frame) => frame[rig[ankle]][1]);
    const low = quantile(heights, rules.standing);
    const standing = turned.filter((_, f) => heights[f] <= low).map((frame) => frame[rig[ankle]]);
    fitted[ankle] = level(standing, tipOf(motion, rig[ankle]), fitted[knee], rules.min_bend);
    const [shoulder, elbow, wrist] = ["shoulder", "elbow", "wrist"].map((name) => `${side}_${name}`);
    const arm = swing(fitted.spine3, bone(shoulder, elbow), aim(shoulder, elbow));
    const forearm = directions(turned, rig[shoulder], rig[elbow], aim(elbow, wrist));
    fitted[shoulder] = twist(arm, bone(shoulder, elbow), forearm, bone(elbow, wrist), FORWARD, rules.min_bend);
    fitted[elbow] = swing(fitted[shoulder], bone(elbow, wrist), aim(elbow, wrist));
    const tip = tipOf(motion, rig[wrist]);
    fitted[wrist] = tip ? swing(fitted[elbow], bone(wrist, `${side}_hand`), tip) : fitted[elbow];
    const collar = `${side}_collar`;
    if (collar in rig) fitted[collar] = meanFrame(turned, rig[collar], rig.spine3, fitted.spine3);
  }
  return fitted;
}

// Rotations relative to the avatar's parents; joints the file lacks go with their parents.
function localRotations({ joint_names: names, parents }, rig, turned, fitted) {
  const world = [];
  return names.map((name, j) => {
    world.push(name in fitted ? product(turned[rig[name]], fitted[name]) : world[parents[j]]);
    return parents[j] < 0 ? world[j] : product(transposed(world[parents[j]]), world[j]);
  });
}

// Joints from below `joint` down to `target`.
function pathOf({ parents }, joint, target) {
  const path = [];
  for (let at = target; at !== joint; at = parents[at]) path.unshift(at);
  return path;
}

function aimOf(motion, joint, target) {
  const step = pathOf(motion, joint, target).find((at) => Math.hypot(...motion.offsets[at]) > 0);
  if (step === undefined) throw new Error(`the skeleton has no length between ${motion.names[joint]} and ${motion.names[target]}`);
  return unit(motion.offsets[step]);
}

// Of the bones that start at a joint the one most in line with all; null at a bare end.
function tipOf({ parents, offsets }, joint) {
  const length = (at) => Math.hypot(...offsets[at]);
  const bones = [];
  for (let child = joint + 1; child < parents.length; child++) {
    if (length(child) === 0) continue;
    let parent = parents[child];
    while (parent > joint && length(parent) === 0) parent = parents[parent];
    if (parent === joint) bones.push(unit(offsets[child]));
  }
  const sum = bones.reduce(plus, [0, 0, 0]);
  return bones.reduce((best, bone) => (best && dot(best, sum) >= dot(bone, sum) ? best : bone), null);
}

// Directions [F] of the child's bone in the joint's frame.
function directions(turned, joint, child, bone) {
  return turned.map((frame) => applied(transposed(frame[joint]), applied(frame[child], bone)));
}

// Rotation that takes +X to `left` and +Y as near to `up` as that allows.
function frameOf(left, up) {
  const x = unit(left);
  const y = unit(across(up, x));
  return fromColumns(x, y, cross(x, y));
}

// Turns `frame` by the least angle that makes it take `bone` to `wanted`.
function swing(frame, bone, wanted) {
  const now = applied(frame, bone);
  let axis = cross(now, wanted);
  const [sine, cosine] = [Math.hypot(...axis), dot(now, wanted)];
  if (sine < 1e-9) {
    if (cosine > 0) return frame;
    const sizes = now.map(Math.abs);
    const least = sizes.indexOf(Math.min(...sizes));
    axis = cross(now, [0, 1, 2].map((k) => Number(k === least)));
  }
  return product(aboutAxis(unit(axis), Math.atan2(sine, cosine)), frame);
}

// Turns `frame` about `bone` so that the joint below bends towards `pole` on average.
function twist(frame, bone, below, straight, pole, minBend) {
  const back = transposed(frame);
  const bend = across(mean(below.map((direction) => applied(back, direction))), bone);
  const side = unit(across(pole, bone));
  const hinge = cross(bone, side);
  const along = dot(straight, hinge);
  if (Math.hypot(...bend) < Math.max(minBend, 1.01 * Math.abs(along))) return frame;
  const wanted = plus(times(side, Math.sqrt(dot(bend, bend) - along * along)), times(hinge, along));
  return product(frame, aboutAxis(bone, Math.atan2(dot(cross(wanted, bend), bone), dot(wanted, bend))));
}

// Frame of a foot whose sole is level on average and whose toes are in front.
function level(standing, toes, shin, minBend) {
  const lean = mean(standing.map((rotation) => applied(transposed(rotation), UP)));
  if (!toes || Math.hypot(...lean) < minBend) return shin;
  const up = unit(lean);
  const ahead = unit(across(toes, up));
  return fromColumns(cross(up, ahead), up, ahead);
}

// Frame of a joint whose mean place over the clip, as seen from its parent, is rest.
function meanFrame(turned, joint, parent, frameOfParent) {
  return nearestRotation(mean(turned.map((frame) => product(transposed(frame[joint]), product(frame[parent], frameOfParent)))));
}
