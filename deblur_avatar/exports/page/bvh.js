// Biovision hierarchy files (.bvh): a skeleton and its joint angles over time.
//
// Read as animation/bvh.py reads them: degrees, multiplied in the order of a joint's channels, the first
// outermost; positions replace components of a joint's offset; ends of bones become joints of their own.

const AXES = { X: 0, Y: 1, Z: 2 };
const MOST_TURNS = 1e6; // frames times joints of a file that a page opens
const SHORTEST_STEP = 1e-6; // seconds
const LARGEST = 1e9; // of any number

// {step, names, parents, offsets [J][3], rotations [F][J] local matrices, positions: {joint: [F][3]}, of the root always}
function readBvh(text) {
  const rows = text.split(/\r\n|\r|\n/).map((row, index) => ({ number: index + 1, words: row.trim().split(/\s+/) }));
  const lines = rows.filter(({ words }) => words[0] !== "");
  let at = 0;
  const next = (wanted) => {
    if (at === lines.length) throw new Error(`the file ends where ${wanted} should stand`);
    return lines[at++];
  };
  const expected = (start, count) => {
    const { number, words } = next(`"${start}"`);
    if (words.slice(0, words.length - count).join(" ") !== start) wrong(number, `wanted "${start}", got "${words.join(" ")}"`);
    return numbersOf(words.slice(words.length - count), count, number);
  };
  expected("HIERARCHY", 0);
  const joints = hierarchyOf(next);
  const [count] = expected("Frames:", 1);
  if (!(Number.isInteger(count) && count > 0)) throw new Error(`Frames must be a positive number, got ${count}`);
  const [step] = expected("Frame Time:", 1);
  if (step < SHORTEST_STEP) throw new Error(`Frame Time must be ${SHORTEST_STEP} s or more, got ${step}`);
  if (count * joints.length > MOST_TURNS) throw new Error(`${count} frames of ${joints.length} joints are too many; cut it`);
  const width = joints.reduce((sum, { channels }) => sum + channels.length, 0);
  const values = Array.from({ length: count }, (_, frame) => {
    const { number, words } = next(`frame ${frame + 1} of ${count}`);
    return numbersOf(words, width, number);
  });
  if (at < lines.length) wrong(lines[at].number, `Frames says ${count}, but more follows`);
  return { step, names: joints.map(({ name }) => name), parents: joints.map(({ parent }) => parent),
    offsets: joints.map(({ offset }) => offset), ...posesOf(joints, values) };
}

function hierarchyOf(next) {
  const [joints, open] = [[], []];
  const enter = (name) => {
    joints.push({ name, parent: open.length ? open[open.length - 1] : -1, offset: null, channels: [] });
    open.push(joints.length - 1);
    const { number, words } = next('"{"');
    if (words.join(" ") !== "{") wrong(number, `wanted "{", got "${words.join(" ")}"`);
  };
  for (;;) {
    const { number, words } = next("MOTION");
    const [first, ...rest] = words;
    const joint = joints[open[open.length - 1]];
    if (first === "MOTION" && joints.length && !open.length) return joints;
    if (first === "ROOT" && rest.length && !joints.length) enter(rest.join(" "));
    else if (first === "JOINT" && rest.length && joint) enter(rest.join(" "));
    else if (first === "End" && rest[0] === "Site" && joint) enter(`${joint.name}_end`);
    else if (first === "OFFSET" && joint && !joint.offset) joint.offset = numbersOf(rest, 3, number);
    else if (first === "CHANNELS" && joint) joint.channels = channelsOf(rest, number);
    else if (first === "}" && joint?.offset) open.pop();
    else wrong(number, `"${words.join(" ").slice(0, 60)}" does not belong here`);
  }
}

function channelsOf([count, ...names], number) {
  const known = names.every((name) => /^[XYZ](position|rotation)$/.test(name)) && new Set(names).size === names.length;
  if (!known || Number(count) !== names.length) wrong(number, `CHANNELS must give a number and as many names, got ${count} ${names.join(" ")}`);
  return names;
}

function posesOf(joints, values) {
  const rotations = [];
  const moved = joints.flatMap(({ channels }, joint) => (joint === 0 || channels.some((one) => one.endsWith("position")) ? [joint] : []));
  const positions = Object.fromEntries(moved.map((joint) => [joint, []]));
  for (const row of values) {
    for (const joint of moved) positions[joint].push([...joints[joint].offset]);
    let column = 0;
    rotations.push(joints.map(({ channels }, joint) => {
      let rotation = IDENTITY;
      for (const channel of channels) {
        const [axis, value] = [AXES[channel[0]], row[column++]];
        if (channel.endsWith("rotation")) rotation = product(rotation, aboutAxis([0, 1, 2].map((k) => Number(k === axis)), (value * Math.PI) / 180));
        else positions[joint].at(-1)[axis] = value;
      }
      return rotation;
    }));
  }
  return { rotations, positions };
}

function numbersOf(words, count, number) {
  const values = words.map(Number);
  if (values.length !== count || !values.every((value) => Math.abs(value) <= LARGEST)) {
    wrong(number, `wanted ${count} numbers, got "${words.join(" ").slice(0, 60)}"`);
  }
  return values;
}

function wrong(number, what) {
  throw new Error(`line ${number}: ${what}`);
}
