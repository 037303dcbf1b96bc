// Page: controls by their ids, the loop that draws, and what is saved.

const $ = (id) => document.getElementById(id);
const RECORDINGS = { // by the button
  record: { label: "Record clip", what: "Clip", make: recordedClip, suffix: ".webm" },
  gif: { label: "Record GIF", what: "GIF", make: recordedGif, suffix: ".gif" },
};

class Page {
  constructor(content) {
    this.content = content;
    this.state = stateOfLink(location.hash, content);
    this.stage = new Stage(content, [...document.querySelectorAll(".avatar")], $("filmed"), $("true"));
    this.recording = false;
    this.asked = false; // for a frame
    this.fill();
    this.listen();
    this.show({});
  }

  get motion() {
    return motionOf(this.content.avatars[0], this.state.motion);
  }

  // Changes the state and has it drawn.
  show(changes) {
    Object.assign(this.state, changes);
    this.changed = performance.now();
    this.stage.layOut(this.state);
    this.mirror();
    this.ask();
  }

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    this.asked = false;
    const { state, stage } = this;
    const took = now - (this.ticked ?? now);
    this.ticked = now;
    const moving = state.playing || now - this.changed < REST;
    if (moving && took > 0 && took < 2000) stage.adapt(took);
    if (state.playing) this.advance(took / 1000);
    if (this.recording) return;
    if (moving) stage.drawMoving(state);
    else stage.drawStill(state);
    this.mirrorTime();
    if (moving) this.ask();
    else this.settle();
  }

  advance(seconds) {
    const duration = durationOf(this.motion);
    this.state.seconds = duration > 0 ? (this.state.seconds + seconds * this.state.speed) % duration : 0;
  }

  // Nothing moves any more: the link says what is shown.
  settle() {
    this.ticked = undefined;
    const link = linkOf(this.state);
    if (link !== location.hash) history.replaceState(null, "", link);
  }

  fill() {
    const { avatars, frames, scene } = this.content;
    const option = (value, text) => new Option(text, value);
    this.fillMotions();
    $("joint").append(...avatars[0].joint_names.map((name, index) => option(index, name.replaceAll("_", " "))));
    $("shutter").max = Math.ceil(1000 * scene.longest_shutter);
    avatars.forEach((avatar, index) => {
      const figure = document.querySelectorAll(".avatar")[index];
      figure.querySelector("figcaption").textContent = avatar.name;
      figure.querySelector("canvas").ariaLabel =
        `Avatar ${avatar.name}. Drag or arrow keys turn, with Shift they move; wheel, plus and minus zoom; Home resets.`;
    });
    $("beside-row").hidden = avatars.length < 2;
    $("beside-name").textContent = avatars[1]?.name ?? "";
    $("frame-row").hidden = $("match").hidden = frames.length === 0;
    $("truth-row").hidden = $("match-truth").hidden = !hasTruth(this.content);
  }

  fillMotions() {
    $("motion").replaceChildren(...this.content.avatars[0].motions.map(({ name, label }) => new Option(label, name)));
  }

  listen() {
    const { content } = this;
    $("play").onclick = () => this.show({ playing: !this.state.playing });
    $("time").oninput = () => this.show({ playing: false, seconds: Number($("time").value) });
    $("motion").onchange = () => this.show({ motion: $("motion").value, seconds: 0 });
    $("open").onchange = () => $("open").files.length && this.open($("open").files[0]);
    $("speed").onchange = () => this.show({ speed: Number($("speed").value) });
    $("shutter").oninput = () => this.show({ shutter: Number($("shutter").value) / 1000 });
    $("background").onchange = () => this.show({ background: $("background").value });
    for (const id of ["frame", "truth", "beside"]) $(id).onchange = () => this.show({ [id]: $(id).checked });
    for (const button of document.querySelectorAll("[data-azimuth]")) {
      const azimuth = (Number(button.dataset.azimuth) * Math.PI) / 180;
      button.onclick = () => this.show({ view: { ...startingView(content.scene), azimuth } });
    }
    $("filming").onclick = () => this.show({ view: { ...this.state.view, filmed: true } });
    $("match").onclick = () => this.match({ shutter: content.scene.exposure, frame: true });
    $("match-truth").onclick = () => this.match({ shutter: 0, truth: true });
    $("save").onclick = () => this.save();
    for (const id of Object.keys(RECORDINGS)) $(id).onclick = () => this.record(id);
    $("link").onclick = () => this.copyLink();
    $("joint").onchange = () => this.mirror();
    for (const axis of ["x", "y", "z"]) $(`bend-${axis}`).oninput = () => this.bend();
    $("straight").onclick = () => this.show({ bends: {} });
    for (const { canvas } of this.stage.panes) {
      moveByHand(canvas, content.scene, () => this.state.view, (view) => this.show({ view }));
    }
    document.addEventListener("keydown", (event) => this.pressed(event));
    for (const kind of ["dragover", "dragleave", "drop"]) document.addEventListener(kind, (event) => this.dropped(event));
    window.addEventListener("hashchange", () => this.show(stateOfLink(location.hash, content)));
    new ResizeObserver(() => this.show({})).observe($("stage"));
  }

  dropped(event) {
    event.preventDefault(); // or the browser leaves the page for the file
    document.body.classList.toggle("dropping", event.type === "dragover");
    if (event.type === "drop" && event.dataTransfer.files.length) this.open(event.dataTransfer.files[0]);
  }

  // Shows the motion of a file; what cannot be opened changes nothing.
  async open(file) {
    const { avatars, rig_rules: rules } = this.content;
    try {
      const motions = await openedMotions(file, avatars, rules);
      const [{ name, times, moving }] = motions;
      const unread = moving.length ? ` Positions of ${moving.join(", ")} change, which is not read.` : "";
      avatars.forEach((avatar, index) => {
        avatar.motions = [...avatar.motions.filter((motion) => motion.name !== name), motions[index]];
      });
      this.fillMotions();
      this.show({ motion: name, seconds: 0 });
      this.say(`Opened ${file.name}: ${times.length} frames, ${durationOf(motions[0]).toFixed(1)} s.${unread}`);
    } catch (error) {
      this.say(`${file.name} cannot be opened: ${error.message}.`);
    }
  }

  pressed(event) {
    if (event.target.matches("button, select, input, summary") || event.ctrlKey || event.metaKey) return;
    if (event.key === " ") this.show({ playing: !this.state.playing });
    else if (event.key === "," || event.key === ".") this.step(event.key === "." ? 1 : -1);
    else return;
    event.preventDefault();
  }

  // To the next frame of the motion, or the one before.
  step(direction) {
    const { times } = this.motion;
    const near = [...times].findIndex((time) => time > this.state.seconds + 1e-6);
    const next = direction > 0 ? near : [...times].findLastIndex((time) => time < this.state.seconds - 1e-6);
    const last = times.length - 1;
    this.show({ playing: false, seconds: times[next < 0 ? (direction > 0 ? last : 0) : next] });
  }

  // Where the filming camera was at the nearest filmed frame, with the shutter and the picture of `changes`.
  match(changes) {
    const { frames, avatars } = this.content;
    const { seconds } = frames[frameAt(this.content, this.state.seconds)];
    const view = { ...this.state.view, filmed: true };
    const motion = avatars[0].motions[0].name;
    this.show({ motion, seconds, view, playing: false, bends: {}, ...changes });
  }

  bend() {
    const degrees = ["x", "y", "z"].map((axis) => Number($(`bend-${axis}`).value));
    this.show({ bends: { ...this.state.bends, [$("joint").value]: degrees } });
  }

  // Controls show the state.
  mirror() {
    const { state } = this;
    const duration = durationOf(this.motion);
    for (const id of ["motion", "background"]) $(id).value = state[id];
    $("speed").value = String(state.speed);
    $("shutter").value = 1000 * state.shutter;
    $("shutter-shown").textContent = state.shutter ? `${(1000 * state.shutter).toFixed(0)} ms` : "none";
    for (const id of ["frame", "truth", "beside"]) $(id).checked = state[id];
    $("play").textContent = state.playing ? "Pause" : "Play";
    $("play").disabled = $("time").disabled = duration === 0;
    $("time").max = duration;
    document.body.dataset.background = state.background;
    const degrees = state.bends[$("joint").value] ?? [0, 0, 0];
    ["x", "y", "z"].forEach((axis, k) => {
      $(`bend-${axis}`).value = degrees[k];
      $(`bend-${axis}-shown`).textContent = `${degrees[k]}°`;
    });
    this.mirrorTime();
  }

  mirrorTime() {
    const text = `${this.state.seconds.toFixed(2)} of ${durationOf(this.motion).toFixed(2)} s`;
    $("time").value = this.state.seconds;
    $("time").ariaValueText = text;
    $("time-shown").textContent = text;
  }

  say(text) {
    $("said").textContent = text;
  }

  save() {
    const canvas = this.stage.picture(this.state, document.createElement("canvas"));
    canvas.toBlob((blob) => download(blob, `${this.content.name}.png`), "image/png");
    this.say("Picture saved.");
  }

  // Writes the motion once, from its start, as it is shown. The same button stops it early.
  async record(id) {
    if (this.recording) {
      this.recording = false;
      return;
    }
    const { what, make, suffix } = RECORDINGS[id];
    const [canvas, before] = [document.createElement("canvas"), { ...this.state }];
    const draw = (seconds) => this.stage.picture({ ...before, seconds }, canvas);
    const report = (share) => {
      this.say(`Recording: ${Math.round(100 * share)} %`);
      return this.recording;
    };
    this.recording = true;
    this.show({ playing: false });
    $(id).textContent = "Stop recording";
    for (const other of Object.keys(RECORDINGS)) $(other).disabled = other !== id;
    try {
      download(await make(draw, durationOf(this.motion), before.speed, report), `${this.content.name}${suffix}`);
      this.say(`${what} saved.`);
    } catch (error) {
      this.say(`No ${what}: ${error.message}`);
    }
    this.recording = false;
    this.ticked = undefined;
    for (const [name, { label }] of Object.entries(RECORDINGS)) {
      $(name).disabled = false;
      $(name).textContent = label;
    }
    this.show({});
  }

  async copyLink() {
    const link = location.href.replace(/#.*$/, "") + linkOf(this.state);
    history.replaceState(null, "", link);
    try {
      await navigator.clipboard.writeText(link);
      this.say("Link copied.");
    } catch {
      this.say("The address bar holds the link.");
    }
  }

  // Transforms of one avatar's joints from the canonical pose, [J, 3, 4]; for tests.
  transforms({ avatar = 0, ...shown }) {
    const { avatar: whom } = this.stage.panes[avatar];
    return [...instantsOf(whom, { ...this.state, shutter: 0, ...shown }, 1)[0]];
  }

  // Pixels of one avatar as the page draws it, in base64, rows from top to bottom, RGBA; for tests.
  pixels({ avatar = 0, camera, background = [0, 0, 0], instants, ...shown }) {
    const { renderer, avatar: whom } = this.stage.panes[avatar];
    const bytes = renderer.pixels(instantsOf(whom, { ...this.state, ...shown }, instants), camera, background);
    let text = "";
    for (let at = 0; at < bytes.length; at += 4096) text += String.fromCharCode(...bytes.subarray(at, at + 4096));
    return btoa(text);
  }
}

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

async function start() {
  try {
    window.page = new Page(await readPayload($("payload").textContent.trim()));
  } catch (error) {
    document.body.classList.add("failed");
    $("said").textContent = `The avatar cannot be shown: ${error.message}`;
    window.failed = error.message;
  }
}

start();
