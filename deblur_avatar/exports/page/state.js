// State: what is shown, as one plain object, and the link that holds it.
//
// motion: its name; seconds: of the motion; shutter: seconds it is open; speed: times real time;
// background: dark, light or transparent; view: view.js; bends: kinematics.js; frame, truth, beside: whether the
// filmed frame, the sharp one of the same instant and the second avatar are shown.

const BACKGROUNDS = { dark: [0.07, 0.08, 0.1], light: [1, 1, 1], transparent: null };
const PIXELS_AN_INSTANT = 3; // that a joint moves at most between two instants of an exposure
const MOST_INSTANTS = { slow: 3, moving: 7, still: 40 };

function startingState(content) {
  return {
    motion: content.avatars[0].motions[0].name,
    seconds: 0,
    shutter: 0,
    speed: 1,
    background: "dark",
    playing: false,
    frame: false,
    truth: false,
    beside: content.avatars.length > 1,
    bends: {},
    view: startingView(content.scene),
  };
}

// Everything that a link keeps: the state without what moves by itself.
function linkOf(state) {
  const { view } = state;
  const words = new URLSearchParams({
    motion: state.motion,
    t: state.seconds.toFixed(3),
    shutter: (1000 * state.shutter).toFixed(1),
    speed: String(state.speed),
    background: state.background,
  });
  if (view.filmed) words.set("view", "filmed");
  else words.set("view", [view.azimuth, view.elevation, view.distance, ...view.target].map((x) => x.toFixed(4)).join(","));
  for (const name of ["frame", "truth"]) if (state[name]) words.set(name, "1");
  if (!state.beside) words.set("beside", "0");
  for (const [joint, degrees] of Object.entries(state.bends)) words.append("bend", [joint, ...degrees].join(","));
  return `#${words}`;
}

// The state that a link tells; what it does not tell, or tells wrongly, is as at the start.
function stateOfLink(fragment, content) {
  const state = startingState(content);
  const words = new URLSearchParams(fragment.replace(/^#/, ""));
  const number = (name, low, high, otherwise) => {
    const value = words.has(name) ? Number(words.get(name)) : NaN;
    return Number.isFinite(value) ? Math.min(Math.max(value, low), high) : otherwise;
  };
  const [first] = content.avatars;
  state.motion = first.motions.find(({ name }) => name === words.get("motion"))?.name ?? state.motion;
  state.seconds = number("t", 0, durationOf(motionOf(first, state.motion)), 0);
  state.shutter = number("shutter", 0, 1000 * content.scene.longest_shutter, 0) / 1000;
  state.speed = number("speed", 0.05, 4, 1);
  if (words.get("background") in BACKGROUNDS) state.background = words.get("background");
  const view = (words.get("view") ?? "").split(",").map(Number);
  if (words.get("view") === "filmed") state.view.filmed = true;
  else if (view.length === 6 && view.every(Number.isFinite)) {
    const [azimuth, elevation, distance, ...target] = view;
    state.view = { azimuth, elevation, distance, target, filmed: false };
  }
  state.frame = words.get("frame") === "1" && content.frames.length > 0;
  state.truth = words.get("truth") === "1" && hasTruth(content);
  state.beside = words.get("beside") !== "0" && content.avatars.length > 1;
  for (const bend of words.getAll("bend")) {
    const [joint, ...degrees] = bend.split(",").map(Number);
    if (joint in first.parents && degrees.length === 3 && degrees.every(Number.isFinite)) state.bends[joint] = degrees;
  }
  return state;
}

function motionOf(avatar, name) {
  return avatar.motions.find((motion) => motion.name === name);
}

function durationOf(motion) {
  return motion.times[motion.times.length - 1];
}

function hasTruth(content) {
  return content.frames.some(({ truth }) => truth);
}

// The filmed frame nearest to a time.
function frameAt(content, seconds) {
  let best = 0;
  content.frames.forEach((frame, index) => {
    if (Math.abs(frame.seconds - seconds) < Math.abs(content.frames[best].seconds - seconds)) best = index;
  });
  return best;
}

// Joint transforms at `count` midpoints of an exposure whose middle is `seconds`.
function instantsOf(avatar, { motion, seconds, shutter, bends = {} }, count) {
  return Array.from({ length: count }, (_, l) => {
    const time = seconds + ((l + 0.5) / count - 0.5) * shutter;
    return jointTransforms(avatar, bentPose(poseAt(motionOf(avatar, motion), time), bends));
  });
}

// How many instants an exposure takes, so that its picture has no steps.
function instantCount(avatar, state, camera, most) {
  if (state.shutter === 0) return 1;
  const ends = [-0.5, -0.25, 0, 0.25, 0.5].map((u) => {
    const [transforms] = instantsOf(avatar, { ...state, seconds: state.seconds + u * state.shutter, shutter: 0 }, 1);
    return jointPositions(avatar, transforms);
  });
  let longest = 0;
  for (let k = 0; k < ends[0].length; k += 3) {
    let travel = 0;
    for (let i = 1; i < ends.length; i++) {
      const depth = Math.max(depthOf(ends[i].subarray(k, k + 3), 0, camera), 0.1);
      const step = [0, 1, 2].map((c) => ends[i][k + c] - ends[i - 1][k + c]);
      travel += (camera.fx * Math.hypot(...step)) / depth;
    }
    longest = Math.max(longest, travel);
  }
  return Math.min(Math.max(Math.ceil(longest / PIXELS_AN_INSTANT) + 1, 2), most);
}
