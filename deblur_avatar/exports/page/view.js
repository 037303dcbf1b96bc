// View: a camera that turns about the person, and the hands that move it.
//
// The stage is the person's: +Y up, +Z towards the camera that filmed it. Angles are in radians, azimuth 0
// looks from where the filming camera stood, positive to its right. `filmed` shows what that camera saw,
// whose axes need not be level, until the view is moved.

const STEEPEST = 1.5; // radians from the horizontal
const FILLED = 0.92; // of the picture, by the motion that the page starts with

function startingView(scene) {
  return { azimuth: 0, elevation: scene.elevation, distance: scene.distance, target: [...scene.target], filmed: false };
}

// The camera of a view, for a picture of this size in pixels.
function cameraOf(view, scene, width, height) {
  if (view.filmed) return filmingCamera(scene, width, height);
  const [a, e] = [view.azimuth, view.elevation];
  const towards = onStage(scene, [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)]);
  const right = onStage(scene, [Math.cos(a), 0, -Math.sin(a)]);
  const forward = towards.map((c) => -c);
  const down = cross(forward, right);
  const rotation = [...right, ...down, ...forward];
  const eye = view.target.map((c, k) => c + view.distance * towards[k]);
  const translation = [0, 1, 2].map((row) => -dot(rotation.slice(3 * row, 3 * row + 3), eye));
  const half = Math.min(width / scene.half_size[0], height / scene.half_size[1]) / 2;
  const focal = FILLED * scene.distance * half;
  return { rotation, translation, fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
}

// The camera that filmed, its whole picture in the middle of this one.
function filmingCamera(scene, width, height) {
  const { K, viewmat, size } = scene.camera;
  const scale = Math.min(width / size[0], height / size[1]);
  return {
    rotation: [0, 1, 2].flatMap((row) => viewmat.slice(4 * row, 4 * row + 3)),
    translation: [3, 7, 11].map((at) => viewmat[at]),
    fx: scale * K[0],
    fy: scale * K[4],
    cx: scale * K[2] + (width - scale * size[0]) / 2,
    cy: scale * K[5] + (height - scale * size[1]) / 2,
    width,
    height,
  };
}

function orbited(view, right, up) {
  const elevation = Math.min(Math.max(view.elevation + up, -STEEPEST), STEEPEST);
  const turn = 2 * Math.PI;
  const azimuth = (((view.azimuth + right + Math.PI) % turn) + turn) % turn - Math.PI;
  return { ...view, azimuth, elevation, filmed: false };
}

// Moves the picture by shares of its shorter side.
function panned(view, scene, right, down) {
  const { rotation } = cameraOf({ ...view, filmed: false }, scene, 1, 1);
  const metres = 2 * Math.max(...scene.half_size) * (view.distance / scene.distance);
  const target = view.target.map((c, k) => c - metres * (right * rotation[k] + down * rotation[3 + k]));
  return { ...view, target, filmed: false };
}

function zoomed(view, scene, factor) {
  const distance = Math.min(Math.max(view.distance * factor, 0.1 * scene.distance), 6 * scene.distance);
  return { ...view, distance, filmed: false };
}

// Lets pointers, the wheel and keys on a canvas move the view that get() returns and set() takes.
function moveByHand(canvas, scene, get, set) {
  const pointers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const ended of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(ended, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const here = [event.clientX, event.clientY];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    const side = Math.min(canvas.clientWidth, canvas.clientHeight);
    const [x, y] = [(here[0] - before[0]) / side, (here[1] - before[1]) / side];
    pointers.set(event.pointerId, here);
    if (other) {
      const spread = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
      set(zoomed(panned(get(), scene, x / 2, y / 2), scene, spread(before) / Math.max(spread(here), 1)));
    } else if (event.shiftKey || event.buttons & 6) set(panned(get(), scene, x, y));
    else set(orbited(get(), -4 * x, 4 * y));
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    set(zoomed(get(), scene, Math.exp(event.deltaY * (event.deltaMode ? 0.05 : 0.0015))));
  }, { passive: false });
  canvas.addEventListener("dblclick", () => set(startingView(scene)));
  canvas.addEventListener("keydown", (event) => {
    const moved = movedByKey(event, get(), scene);
    if (!moved) return;
    event.preventDefault();
    set(moved);
  });
}

function movedByKey(event, view, scene) {
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  if (event.key in arrows) {
    const [x, y] = arrows[event.key];
    return event.shiftKey ? panned(view, scene, 0.05 * x, 0.05 * y) : orbited(view, 0.12 * x, -0.12 * y);
  }
  if (event.key === "+" || event.key === "=") return zoomed(view, scene, 1 / 1.1);
  if (event.key === "-") return zoomed(view, scene, 1.1);
  return event.key === "Home" ? startingView(scene) : null;
}

function onStage(scene, vector) {
  return [0, 1, 2].map((row) => dot(scene.world_from_stage.slice(3 * row, 3 * row + 3), vector));
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
