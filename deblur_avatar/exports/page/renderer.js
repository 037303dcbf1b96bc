// Renderer: ellipses to pixels in WebGL2, instants to one exposure, averaged light to sRGB.
//
// Ellipses come back to front and are blended in half floats, in the space in which the avatar's light is
// averaged; what is shown is encoded last. Textures have the picture's first row first; only the last pass
// to the canvas turns it over. Vertices come from gl_VertexID: instancing is far slower in software.

const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D splats;
uniform vec2 size;
flat out vec2 centre;
flat out vec4 conic_opacity;
flat out vec3 color;
const vec2 CORNERS[6] = vec2[](vec2(-1, -1), vec2(1, -1), vec2(-1, 1), vec2(-1, 1), vec2(1, -1), vec2(1, 1));
void main() {
  int number = gl_VertexID / 6;
  ivec2 texel = ivec2(3 * (number % ${SPLATS_A_ROW}), number / ${SPLATS_A_ROW});
  vec4 first = texelFetch(splats, texel, 0);
  vec4 second = texelFetch(splats, texel + ivec2(1, 0), 0);
  vec4 third = texelFetch(splats, texel + ivec2(2, 0), 0);
  vec2 corner = 1.001 * CORNERS[gl_VertexID % 6];
  vec2 axis = first.zw;
  vec2 place = first.xy + corner.x * axis + corner.y * second.x * vec2(-axis.y, axis.x);
  centre = first.xy;
  conic_opacity = vec4(second.yzw, third.w);
  color = third.rgb;
  gl_Position = vec4(2.0 * place / size - 1.0, 0.0, 1.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
uniform float max_alpha;
uniform float min_alpha;
flat in vec2 centre;
flat in vec4 conic_opacity;
flat in vec3 color;
out vec4 light;
void main() {
  vec2 d = gl_FragCoord.xy - centre;
  vec3 conic = conic_opacity.xyz;
  float power = -0.5 * (conic.x * d.x * d.x + conic.z * d.y * d.y) - conic.y * d.x * d.y;
  float alpha = min(max_alpha, conic_opacity.w * exp(power));
  if (alpha < min_alpha) discard;
  light = vec4(color * alpha, alpha);
}`;

const SCREEN_VERTEX = `#version 300 es
uniform float flip;
out vec2 place;
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1);
  place = 0.5 * vec2(corner.x, flip * corner.y) + 0.5;
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const MEAN_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform float share;
in vec2 place;
out vec4 light;
void main() { light = share * texture(picture, place); }`;

const ENCODE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform bool linear;
uniform bool transparent;
uniform vec3 background;
in vec2 place;
out vec4 shown;
vec3 encode(vec3 light) {
  light = clamp(light, 0.0, 1.0);
  vec3 curve = 1.055 * pow(max(light, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return linear ? mix(curve, 12.92 * light, lessThanEqual(light, vec3(0.0031308))) : light;
}
void main() {
  vec4 light = texture(picture, place);
  if (transparent) shown = vec4(encode(light.rgb / max(light.a, 1e-4)), light.a);
  else shown = vec4(encode(light.rgb + (1.0 - light.a) * background), 1.0);
}`;

class Renderer {
  constructor(canvas, avatar, limits) {
    const gl = canvas.getContext("webgl2", { alpha: true, premultipliedAlpha: false, antialias: false });
    if (!gl) throw new Error("This browser has no WebGL 2, which the avatar is drawn with.");
    gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    [this.gl, this.canvas, this.avatar, this.limits] = [gl, canvas, avatar, limits];
    this.buffers = gaussianBuffers(avatar.count);
    this.splats = program(gl, SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.mean = program(gl, SCREEN_VERTEX, MEAN_FRAGMENT);
    this.encode = program(gl, SCREEN_VERTEX, ENCODE_FRAGMENT);
    this.table = texture(gl, gl.RGBA32F, 3 * SPLATS_A_ROW, this.buffers.splats.length / SPLAT / SPLATS_A_ROW);
    this.targets = {};
    gl.bindVertexArray(gl.createVertexArray());
  }

  // Draws the mean of these instants (joint transforms) to the canvas.
  draw(instants, camera, background) {
    const light = this.averaged(instants, camera);
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, null);
    this.encoded(light, background, -1);
  }

  // The same as bytes, rows from top to bottom, RGBA.
  pixels(instants, camera, background) {
    const { gl } = this;
    const light = this.averaged(instants, camera);
    const target = this.target("shown", gl.RGBA8, camera.width, camera.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    this.encoded(light, background, 1);
    const bytes = new Uint8Array(4 * camera.width * camera.height);
    gl.readPixels(0, 0, camera.width, camera.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes;
  }

  // Waits until all is drawn.
  finish() {
    const { gl } = this;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  averaged(instants, camera) {
    const { gl } = this;
    const instant = this.target("instant", gl.RGBA16F, camera.width, camera.height);
    if (instants.length === 1) {
      this.blended(instants[0], camera, instant);
      return instant;
    }
    const mean = this.target("mean", gl.RGBA16F, camera.width, camera.height);
    clear(gl, mean);
    for (const transforms of instants) {
      this.blended(transforms, camera, instant);
      gl.bindFramebuffer(gl.FRAMEBUFFER, mean.framebuffer);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE);
      this.screen(this.mean, instant, 1);
      gl.uniform1f(this.mean.at("share"), 1 / instants.length);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    return mean;
  }

  // Blends one instant's Gaussians into a target.
  blended(transforms, camera, target) {
    const { gl, avatar, limits, buffers } = this;
    posedGaussians(avatar, transforms, buffers);
    const count = projectGaussians(avatar, buffers, camera, limits, buffers);
    clear(gl, target);
    if (!count) return;
    gl.useProgram(this.splats.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    const rows = Math.ceil(count / SPLATS_A_ROW);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3 * SPLATS_A_ROW, rows, gl.RGBA, gl.FLOAT, buffers.splats);
    gl.uniform1i(this.splats.at("splats"), 0);
    gl.uniform2f(this.splats.at("size"), camera.width, camera.height);
    gl.uniform1f(this.splats.at("max_alpha"), limits.max_alpha);
    gl.uniform1f(this.splats.at("min_alpha"), limits.min_alpha);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArrays(gl.TRIANGLES, 0, 6 * count);
  }

  encoded(light, background, flip) {
    const { gl, encode, avatar } = this;
    gl.viewport(0, 0, light.width, light.height);
    gl.disable(gl.BLEND);
    this.screen(encode, light, flip);
    const linear = avatar.averaging_space === "linear";
    gl.uniform1i(encode.at("linear"), linear);
    gl.uniform1i(encode.at("transparent"), background === null);
    gl.uniform3fv(encode.at("background"), (background ?? [0, 0, 0]).map((c) => (linear ? linearOfSrgb(c) : c)));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  screen(pass, source, flip) {
    const { gl } = this;
    gl.useProgram(pass.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, source.texture);
    gl.uniform1i(pass.at("picture"), 0);
    gl.uniform1f(pass.at("flip"), flip);
  }

  // A texture to draw into, made anew when its size changes.
  target(name, format, width, height) {
    const { gl } = this;
    const old = this.targets[name];
    if (old && old.width === width && old.height === height) return old;
    if (old) {
      gl.deleteTexture(old.texture);
      gl.deleteFramebuffer(old.framebuffer);
    }
    const made = { texture: texture(gl, format, width, height), framebuffer: gl.createFramebuffer(), width, height };
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.texture, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
      throw new Error("This browser cannot draw into half-float pictures, which the avatar needs.");
    }
    this.targets[name] = made;
    return made;
  }
}

function clear(gl, target) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
  gl.viewport(0, 0, target.width, target.height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT);
}

function texture(gl, format, width, height) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return made;
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(made, name));
    return places.get(name);
  };
  return { program: made, at };
}

function linearOfSrgb(value) {
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}
