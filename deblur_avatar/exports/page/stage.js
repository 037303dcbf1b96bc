// Stage: one canvas an avatar, drawn as fast as the machine can, pictures of the filming camera beside them,
// and one picture of all that is shown.

const SLOW = 50; // milliseconds a frame, over which pictures get coarser
const QUICK = 24; // and under which they get finer again
const COARSEST = 0.2; // pixels of the picture a pixel of the screen
const PATIENCE = 800; // milliseconds that a still exposure may take
const REST = 250; // milliseconds without a change, after which the whole resolution is drawn

class Stage {
  constructor(content, panes, filmed, sharp) {
    this.content = content;
    this.panes = content.avatars.map((avatar, index) => ({
      avatar,
      figure: panes[index],
      canvas: panes[index].querySelector("canvas"),
    }));
    for (const pane of this.panes) pane.renderer = new Renderer(pane.canvas, pane.avatar, content.limits);
    this.sharpness = 1; // of pixels while something moves
    this.cost = 100; // milliseconds an instant at the resolution of the screen, once one is drawn
    this.instants = MOST_INSTANTS.moving; // of an exposure then
    this.filmed = { figure: filmed, asked: "frame", links: content.frames.map(({ file, kind }) => linkTo(file, kind)) };
    this.sharp = { figure: sharp, asked: "truth", links: content.frames.map(({ truth, kind }) => linkTo(truth, kind)) };
  }

  // Draws all panes as well as the machine can follow while something moves.
  drawMoving(state) {
    this.draw(state, this.sharpness, this.instants);
  }

  // Draws all panes at the resolution of the screen; an exposure of as many instants as is worth waiting for.
  drawStill(state) {
    const begin = performance.now();
    const drawn = this.draw(state, 1, Math.min(Math.max(PATIENCE / this.cost, MOST_INSTANTS.moving), MOST_INSTANTS.still));
    for (const { figure, renderer } of this.panes) if (!figure.hidden) renderer.finish();
    this.cost = (performance.now() - begin) / drawn;
  }

  // Returns how many instants an exposure of the first avatar took.
  draw(state, sharpness, most) {
    this.layOut(state);
    const density = Math.min(window.devicePixelRatio || 1, 2) * sharpness;
    const drawn = this.panes.map(({ avatar, canvas, figure, renderer }) => {
      if (figure.hidden) return 0;
      const width = Math.max(Math.round(canvas.clientWidth * density), 16);
      const height = Math.max(Math.round(canvas.clientHeight * density), 16);
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
      const camera = cameraOf(state.view, this.content.scene, width, height);
      const instants = instantsOf(avatar, state, instantCount(avatar, state, camera, Math.floor(most)));
      renderer.draw(instants, camera, BACKGROUNDS[state.background]);
      return instants.length;
    });
    return drawn[0];
  }

  layOut(state) {
    this.panes.forEach(({ figure }, index) => (figure.hidden = index > 0 && !state.beside));
    for (const taken of [this.filmed, this.sharp]) this.showTaken(taken, state);
    const shown = this.shown();
    shown[0].figure.parentElement.classList.toggle("many", shown.length > 2);
  }

  // Of pictures that the filming camera took, the one nearest in time.
  showTaken({ figure, asked, links }, state) {
    figure.hidden = !state[asked];
    if (figure.hidden) return;
    const index = frameAt(this.content, state.seconds);
    const image = figure.querySelector("img");
    if (image.dataset.index !== String(index)) {
      image.dataset.index = index;
      image.src = links[index];
    }
    const { number, seconds } = this.content.frames[index];
    const what = asked === "frame" ? `Filmed frame ${number}` : "Sharp truth";
    figure.querySelector("figcaption").textContent = `${what}, ${seconds.toFixed(3)} s`;
  }

  // From left to right.
  shown() {
    return [this.filmed, ...this.panes, this.sharp].filter(({ figure }) => !figure.hidden);
  }

  // Coarser or finer pixels, then fewer or more instants, after a frame that took so many milliseconds.
  adapt(took) {
    if (took > SLOW && this.sharpness > COARSEST) {
      this.sharpness = Math.max(this.sharpness * Math.max(Math.sqrt(SLOW / took), 0.7), COARSEST);
    } else if (took > SLOW) this.instants = Math.max(this.instants - 1, MOST_INSTANTS.slow);
    else if (took < QUICK && this.instants < MOST_INSTANTS.moving) this.instants++;
    else if (took < QUICK) this.sharpness = Math.min(this.sharpness * 1.1, 1);
  }

  // All that is shown, side by side on one canvas, at the resolution of the screen.
  picture(state, canvas) {
    this.draw(state, 1, MOST_INSTANTS.still);
    const shown = this.shown().map(({ figure }) => figure.querySelector("img, canvas"));
    const { height } = this.panes[0].canvas;
    const widths = shown.map((one) => Math.round((height * (one.naturalWidth ?? one.width)) / (one.naturalHeight ?? one.height)));
    const width = widths.reduce((sum, one) => sum + one, 0);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    let left = 0;
    shown.forEach((one, index) => {
      context.drawImage(one, left, 0, widths[index], height);
      left += widths[index];
    });
    return canvas;
  }
}

// An address for a file of the payload; of none where the payload lacks it.
function linkTo(file, kind) {
  return file && URL.createObjectURL(new Blob([file], { type: kind }));
}
