// Opened motion: a file from the user's disk, which the avatar does where it was filmed.

const LARGEST_FILE = 2e8; // bytes
const OPENED = "file:"; // what names of such motions begin with, so that none is another's

// The motion of a file, for every avatar of the page: {name, label, times, quats, transl} each, and `moving`, the
// joints whose places are not read.
async function openedMotions(file, avatars, rules) {
  if (file.size > LARGEST_FILE) throw new Error(`it is larger than ${LARGEST_FILE / 1e6} MB`);
  const suffix = /\.[^.]*$/.exec(file.name)?.[0].toLowerCase() ?? "";
  const stem = file.name.slice(0, file.name.length - suffix.length);
  let poses;
  if (suffix === ".bvh") {
    const skeleton = readBvh(await file.text());
    poses = (avatar) => retargeted(skeleton, avatar, rules);
  } else if (suffix === ".npz") {
    const motion = await readAmass(await file.arrayBuffer());
    poses = () => motion;
  } else throw new Error(`a motion is a .bvh file or an AMASS .npz, this is ${suffix || "neither"}`);
  return avatars.map((avatar) => {
    const { moving = [], ...motion } = poses(avatar);
    return { name: OPENED + stem, label: stem.replaceAll("_", " "), moving, ...placed(motion, avatar) };
  });
}

// The motion where the person was filmed, facing the camera at the start: animation/placement.py.
function placed({ step, rotations, transl }, { joints, placement }) {
  const { anchor, world_from_stage: worldFromStage } = placement;
  const [first] = rotations[0];
  const turn = product(worldFromStage, aboutAxis(UP, -Math.atan2(first[2], first[8])));
  const middle = [0, 1, 2].map((k) => transl.map((place) => place[k]).sort((a, b) => a - b)[Math.floor((transl.length - 1) / 2)]);
  return {
    times: Float64Array.from(rotations, (_, frame) => frame * step),
    quats: Float64Array.from(rotations.flatMap(([root, ...others]) => [product(turn, root), ...others].flatMap(quatOf))),
    transl: Float64Array.from(transl.flatMap((place) => {
      const path = applied(turn, minus(place, middle));
      return [0, 1, 2].map((k) => anchor[k] + path[k] - joints[k]);
    })),
  };
}
