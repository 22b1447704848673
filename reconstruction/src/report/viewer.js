// The view of a scene in three dimensions: a canvas, layers that draw themselves into it, and a camera that orbits.
//
// Data: the element #viewer-data holds JSON (see viewer.rs); the element named by a layer's `blob` holds its numbers,
// little-endian, in base64. World: metres, z up. A new kind of layer is a function in LAYERS; nothing else knows it.
"use strict";
(() => {
/*SHARED*/
  const box = document.getElementById("viewer");
  const canvas = document.getElementById("viewer-canvas");
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
  if (!gl) return;
  // Without WebGL2, or where it fails, the page keeps its words in place of the view.
  const show = (isShown) => {
    box.toggleAttribute("data-none", !isShown);
    document.getElementById("viewer-none").hidden = isShown;
  };

  // ---- The camera: looks at `target` from `distance`, along yaw (from x) and pitch (down is negative) ----
  const FOCAL = 1.5; // Focal length by half the height of the canvas.
  const size_m = Math.hypot(...add(data.high, data.low, -1)) || 1;
  const view = {};
  const axes = () => {
    const forward = [
      Math.cos(view.pitch) * Math.cos(view.yaw), Math.cos(view.pitch) * Math.sin(view.yaw), Math.sin(view.pitch),
    ];
    const right = [Math.sin(view.yaw), -Math.cos(view.yaw), 0];
    return { forward, right, up: cross(right, forward) };
  };
  function clipFromWorld() {
    const { forward, right, up } = axes();
    const eye = add(view.target, forward, -view.distance);
    const wide = canvas.width / canvas.height;
    // A tall canvas shows as much to the sides as a square one.
    const focal = FOCAL * Math.min(1, wide);
    const near = Math.max(0.01, 0.01 * view.distance);
    const far = view.distance + 2 * size_m + 1;
    const a = (far + near) / (near - far), b = 2 * far * near / (near - far);
    const rows = [
      right.map((v) => v * focal / wide).concat(-dot(right, eye) * focal / wide),
      up.map((v) => v * focal).concat(-dot(up, eye) * focal),
      forward.map((v) => -v * a).concat(dot(forward, eye) * a + b),
      forward.concat(-dot(forward, eye)),
    ];
    const matrix = new Float32Array(16);
    rows.forEach((row, r) => row.forEach((v, c) => { matrix[4 * c + r] = v; }));
    return { matrix, px: focal * canvas.height / 2 };
  }
  function look(name) {
    const { eye, target } = data.view;
    const to = add(target, eye, -1);
    view.target = target.slice();
    view.distance = Math.hypot(...to) || size_m;
    view.yaw = Math.atan2(to[1], to[0]);
    view.pitch = Math.asin(clamp(to[2] / view.distance, -1, 1));
    if (name !== "start") {
      // All but the outermost points, as large as fits.
      const [low, high] = data.core;
      const half = add(high, low, -1).map((v) => v / 2);
      const wide = canvas.clientWidth / canvas.clientHeight, focal = FOCAL * Math.min(1, wide);
      view.target = add(low, half);
      if (name === "above") {
        view.yaw = Math.PI / 2;
        view.pitch = -Math.PI / 2;
        view.distance = 1.05 * Math.max(half[0] * focal / wide, half[1] * focal) + half[2];
      } else {
        view.pitch = -0.12;
        view.distance = 1.35 * Math.hypot(half[0], half[1]) * Math.max(focal / wide, 1);
      }
    }
    draw();
  }

  // ---- Programs and buffers ----
  function buffer(array) {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    return made;
  }
  function attribute(place, of, count, type, isNormalised, stride = 0, offset = 0, divisor = 0) {
    gl.bindBuffer(gl.ARRAY_BUFFER, of);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, type, isNormalised, stride, offset);
    gl.vertexAttribDivisor(place, divisor);
  }
  // ---- Colours of values, by the reader's choice of a light or dark screen ----
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const anchors = () => dark.matches ? data.ramp.dark : data.ramp.light;
  const grey = () => dark.matches ? [150, 156, 163] : [140, 140, 140];
  function ramp(share) {
    const of = anchors(), place = clamp(share, 0, 1) * (of.length - 1), below = Math.min(Math.floor(place), of.length - 2);
    return of[below].map((v, k) => v + (of[below + 1][k] - v) * (place - below));
  }

  // ---- Layers: each gives {draw(scene), recolour()}; blobs are read once and kept, so that a lost context can come back ----
  const UNKNOWN = 255;
  const LAYERS = {
    // u16 x 3 per point: steps from `low`; then u8 x 3 per point: colour.
    points(layer) {
      const numbers = layer.numbers ??= blob(layer.blob);
      const shaders = program(gl, `
        layout(location = 0) in vec3 place;
        layout(location = 1) in vec3 colour;
        uniform mat4 clip_from_world;
        uniform vec3 low, steps;
        uniform float px, size_m, cut;
        out vec3 shade;
        void main() {
          vec3 x = low + place * steps;
          gl_Position = x.z > cut ? vec4(2.0, 2.0, 2.0, 1.0) : clip_from_world * vec4(x, 1.0);
          gl_PointSize = clamp(size_m * px / gl_Position.w, 1.5, 40.0);
          shade = colour;
        }`, `
        in vec3 shade;
        out vec4 colour;
        void main() { colour = vec4(shade, 1.0); }`);
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      attribute(0, buffer(new Uint16Array(numbers, 0, 3 * layer.count)), 3, gl.UNSIGNED_SHORT, false);
      attribute(1, buffer(new Uint8Array(numbers, 6 * layer.count, 3 * layer.count)), 3, gl.UNSIGNED_BYTE, true);
      return {
        recolour() {},
        draw(scene) {
          gl.useProgram(shaders.made);
          gl.bindVertexArray(array);
          gl.uniformMatrix4fv(shaders.at("clip_from_world"), false, scene.matrix);
          gl.uniform3fv(shaders.at("low"), data.low);
          gl.uniform3fv(shaders.at("steps"), add(data.high, data.low, -1).map((v) => v / 65535));
          gl.uniform1f(shaders.at("px"), scene.px);
          gl.uniform1f(shaders.at("size_m"), layer.size_m * scene.size);
          gl.uniform1f(shaders.at("cut"), scene.cut);
          gl.drawArrays(gl.POINTS, 0, layer.count);
        },
      };
    },

    // f32 x 3 per place: metres from `low`; then per place u8: what it is coloured by, of 254, 255 if not known; and u8: whether
    // the line goes on from the place before. Drawn as rectangles as wide as the screen wants; behind points it shines through.
    line(layer) {
      const numbers = layer.numbers ??= blob(layer.blob);
      const shaders = program(gl, `
        layout(location = 0) in vec3 from;
        layout(location = 1) in vec3 to;
        layout(location = 2) in vec4 from_colour;
        layout(location = 3) in vec4 to_colour;
        uniform mat4 clip_from_world;
        uniform vec3 low;
        uniform vec2 screen;
        uniform float wide;
        out vec3 shade;
        void main() {
          vec4 a = clip_from_world * vec4(low + from, 1.0), b = clip_from_world * vec4(low + to, 1.0);
          bool is_end = (gl_VertexID & 1) == 1, is_left = (gl_VertexID & 2) == 2;
          vec2 along = (b.xy / b.w - a.xy / a.w) * screen;
          along = length(along) > 1e-4 ? normalize(along) : vec2(1.0, 0.0);
          vec4 here = is_end ? b : a;
          // A little beyond both ends, so that corners are closed.
          vec2 off = wide * ((is_left ? 0.5 : -0.5) * vec2(-along.y, along.x) + (is_end ? 0.35 : -0.35) * along);
          here.xy += 2.0 * off / screen * here.w;
          bool is_seen = to_colour.a > 0.5 && a.w > 0.0 && b.w > 0.0;
          gl_Position = is_seen ? here : vec4(2.0, 2.0, 2.0, 1.0);
          shade = is_end ? to_colour.rgb : from_colour.rgb;
        }`, `
        in vec3 shade;
        uniform float opacity;
        out vec4 colour;
        void main() { colour = vec4(shade, opacity); }`);
      const places = buffer(new Float32Array(numbers, 0, 3 * layer.count));
      const values = new Uint8Array(numbers, 12 * layer.count, 2 * layer.count);
      const colours = new Uint8Array(4 * layer.count);
      const coloured = buffer(colours);
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      attribute(0, places, 3, gl.FLOAT, false, 12, 0, 1);
      attribute(1, places, 3, gl.FLOAT, false, 12, 12, 1);
      attribute(2, coloured, 4, gl.UNSIGNED_BYTE, true, 4, 0, 1);
      attribute(3, coloured, 4, gl.UNSIGNED_BYTE, true, 4, 4, 1);
      return {
        recolour() {
          for (let k = 0; k < layer.count; k++) {
            const value = values[2 * k];
            colours.set(value === UNKNOWN ? grey() : ramp(value / 254), 4 * k);
            colours[4 * k + 3] = values[2 * k + 1] ? 255 : 0;
          }
          gl.bindBuffer(gl.ARRAY_BUFFER, coloured);
          gl.bufferData(gl.ARRAY_BUFFER, colours, gl.STATIC_DRAW);
        },
        draw(scene) {
          if (layer.count < 2) return;
          gl.useProgram(shaders.made);
          gl.bindVertexArray(array);
          gl.uniformMatrix4fv(shaders.at("clip_from_world"), false, scene.matrix);
          gl.uniform3fv(shaders.at("low"), data.low);
          gl.uniform2f(shaders.at("screen"), canvas.width, canvas.height);
          gl.uniform1f(shaders.at("wide"), layer.wide_px * scene.ratio);
          gl.disable(gl.DEPTH_TEST);
          gl.enable(gl.BLEND);
          gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
          gl.uniform1f(shaders.at("opacity"), 0.3);
          gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, layer.count - 1);
          gl.disable(gl.BLEND);
          gl.enable(gl.DEPTH_TEST);
          gl.uniform1f(shaders.at("opacity"), 1);
          gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, layer.count - 1);
        },
      };
    },
  };

  // ---- Drawing, at most once per frame of the screen ----
  const size = document.getElementById("viewer-size");
  const cut = document.getElementById("viewer-cut");
  const cutM = document.getElementById("viewer-cut-m");
  let drawn = [], isWaiting = false;
  const cutAt = () => data.low[2] + Number(cut.value) * (data.high[2] - data.low[2]);
  function draw() {
    if (isWaiting) return;
    isWaiting = true;
    requestAnimationFrame(() => {
      isWaiting = false;
      if (gl.isContextLost()) return;
      const ratio = fit(canvas);
      gl.viewport(0, 0, canvas.width, canvas.height);
      const paper = dark.matches ? [0.07, 0.08, 0.09] : [1, 1, 1];
      gl.clearColor(...paper, 1);
      gl.enable(gl.DEPTH_TEST);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const isAll = Number(cut.value) >= 1;
      const scene = { ...clipFromWorld(), ratio, size: Number(size.value), cut: isAll ? 1e30 : cutAt() };
      cutM.textContent = isAll ? "nothing" : cutAt().toFixed(1) + " m";
      data.layers.forEach((layer, k) => { if (layer.isShown) drawn[k].draw(scene); });
    });
  }
  function recolour() {
    drawn.forEach((layer) => layer.recolour());
    const css = anchors().map((c) => `rgb(${c.join(",")})`).join(",");
    document.getElementById("viewer-ramp").style.background = `linear-gradient(to right, ${css})`;
    draw();
  }
  function begin() {
    drawn = data.layers.map((layer) => LAYERS[layer.kind](layer));
    recolour();
  }

  // ---- What the reader does ----
  function turn(dx, dy) {
    view.yaw -= dx * 0.006;
    view.pitch = clamp(view.pitch - dy * 0.006, -Math.PI / 2, Math.PI / 2);
    draw();
  }
  function pan(dx, dy) {
    const { right, up } = axes();
    const perPx = view.distance / (clipFromWorld().px * canvas.clientHeight / canvas.height);
    view.target = add(add(view.target, right, -dx * perPx), up, dy * perPx);
    draw();
  }
  function zoom(factor) {
    view.distance = clamp(view.distance * factor, 0.05, 20 * size_m);
    draw();
  }
  watchPointers(canvas, (dx, dy, isPan, spread) => {
    if (isPan) pan(dx, dy); else turn(dx, dy);
    if (spread !== 1) zoom(spread);
  });
  canvas.addEventListener("wheel", (event) => {
    // A reader who scrolls past keeps scrolling; a click into the view makes the wheel zoom.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(clamp(event.deltaY, -300, 300) * 0.0015));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const move = event.shiftKey ? pan : turn;
    const keys = {
      ArrowLeft: () => move(-20, 0), ArrowRight: () => move(20, 0), ArrowUp: () => move(0, -20), ArrowDown: () => move(0, 20),
      "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), Home: () => look("start"),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  for (const button of box.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => look(button.dataset.view));
  }
  for (const layer of data.layers) {
    layer.isShown = true;
    const label = document.createElement("label"), check = document.createElement("input");
    check.type = "checkbox";
    check.checked = true;
    check.addEventListener("change", () => { layer.isShown = check.checked; draw(); });
    label.append(check, layer.name);
    document.getElementById("viewer-layers").append(label, " ");
  }
  for (const input of [size, cut]) input.addEventListener("input", draw);
  for (const [id, text] of [["least", "0"], ["what", data.ramp.what], ["most", data.ramp.most]]) {
    document.getElementById("viewer-" + id).textContent = text;
  }
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", begin);
  dark.addEventListener("change", recolour);
  new ResizeObserver(draw).observe(canvas);

  show(true);
  cut.value = data.cut;
  try {
    begin();
    look("start");
  } catch (error) {
    show(false);
    throw error;
  }
})();
