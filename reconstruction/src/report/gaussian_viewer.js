// The scene of Gaussians as ellipses, blended from back to front before the sky, and a camera that flies or is moved.
//
// Data: the element #gaussians-data holds JSON; #gaussians-shapes the Gaussians in 24 bytes each (see gaussian_packing.rs),
// #gaussians-harmonics 8 bytes each of degree 1, #gaussians-sky 32-bit floats, all in base64. World: metres, z up. A camera
// looks along its z, x to the right and y down; a pose is x, y, z and the quaternion w, x, y, z of world_from_camera.
// Formulas are those of the crate `splats`, so that the picture is that of its renderer with a pinhole camera.
"use strict";
(() => {
/*SHARED*/
  const box = document.getElementById("gaussians");
  const canvas = document.getElementById("gaussians-canvas");
  const data = JSON.parse(document.getElementById("gaussians-data").textContent);
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
  if (!gl) return;
  const show = (isShown) => {
    box.toggleAttribute("data-none", !isShown);
    document.getElementById("gaussians-none").hidden = isShown;
  };

  // ---- Programs ----
  const ROW = 1024; // Gaussians in a row of the texture, two texels each.
  const SPLATS = `
    layout(location = 0) in uint index;
    uniform highp usampler2D gaussians;
    uniform mat3 world_from_camera;
    uniform vec3 center;
    uniform vec2 screen, scales;
    uniform float focal;
    uniform bool compensates, has_harmonics;
    out vec2 from_mean;
    flat out vec4 shade;
    vec3 coefficient(uint red, uint green, uint blue) { return (vec3(uvec3(red, green, blue) & 63u) - 32.0) / 31.0; }
    void main() {
      gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
      ivec2 texel = ivec2(2u * (index % ${ROW}u), index / ${ROW}u);
      uvec4 a = texelFetch(gaussians, texel, 0), b = texelFetch(gaussians, texel + ivec2(1, 0), 0);
      vec3 offset = uintBitsToFloat(a.xyz) - center;
      vec3 p = offset * world_from_camera;
      vec3 s = exp(scales.x + scales.y * vec3((uvec3(a.w) >> uvec3(0, 10, 20)) & 1023u));
      vec3 three = (vec3((uvec3(b.x) >> uvec3(0, 10, 20)) & 1023u) * (2.0 / 1023.0) - 1.0) * 0.70710678;
      float one = sqrt(max(1.0 - dot(three, three), 0.0));
      uint which = b.x >> 30;
      vec4 q = which == 0u ? vec4(one, three) : which == 1u ? vec4(three.x, one, three.yz)
        : which == 2u ? vec4(three.xy, one, three.z) : vec4(three, one);
      float w = q.x, x = q.y, y = q.z, z = q.w;
      mat3 axes = mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
      mat3 root = transpose(world_from_camera) * axes * mat3(s.x, 0, 0, 0, s.y, 0, 0, 0, s.z);
      // The projection's Jacobian, linearized at the border of the picture for means far beyond it.
      vec2 border = 0.65 * screen / focal, slope = clamp(p.xy / p.z, -border, border);
      vec3 u = vec3(focal / p.z, 0, -focal * slope.x / p.z) * root;
      vec3 v = vec3(0, focal / p.z, -focal * slope.y / p.z) * root;
      vec3 normal = cross(u, v);
      float xx = dot(u, u) + 0.3, yy = dot(v, v) + 0.3, xy = dot(u, v), det = xx * yy - xy * xy;
      vec4 rgba = vec4((uvec4(b.y) >> uvec4(0, 8, 16, 24)) & 255u) / 255.0;
      float opacity = rgba.a * (compensates ? max(sqrt(dot(normal, normal) / det), 0.005) : 1.0);
      if (!(opacity >= 1.0 / 255.0) || !(det > 0.0)) return;
      // Principal axes, as far as alpha reaches 1 / 255.
      float middle = 0.5 * (xx + yy), radius = length(vec2(0.5 * (xx - yy), xy));
      float angle = radius > 1e-6 * middle ? 0.5 * atan(xy, 0.5 * (xx - yy)) : 0.0;
      vec2 axis = vec2(cos(angle), sin(angle)), sigma = sqrt(vec2(middle + radius, det / (middle + radius)));
      vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
      from_mean = corner * sqrt(2.0 * log(255.0 * opacity));
      vec2 px = focal * p.xy / p.z + from_mean.x * sigma.x * axis + from_mean.y * sigma.y * vec2(-axis.y, axis.x);
      gl_Position = vec4(px * vec2(2, -2) / screen, 0.0, 1.0);
      vec3 d = normalize(offset), color = rgba.rgb * 2.0 - 0.5;
      if (has_harmonics) {
        color += 0.48860251 * (d.z * coefficient(b.z >> 18, b.z >> 24, b.w) - d.y * coefficient(b.z, b.z >> 6, b.z >> 12)
          - d.x * coefficient(b.w >> 6, b.w >> 12, b.w >> 18));
      }
      shade = vec4(max(color, 0.0), opacity);
    }`;
  const ELLIPSE = `
    in vec2 from_mean;
    flat in vec4 shade;
    out vec4 color;
    void main() {
      float alpha = min(shade.a * exp(-0.5 * dot(from_mean, from_mean)), 0.99);
      if (alpha < 1.0 / 255.0) discard;
      color = vec4(shade.rgb * alpha, alpha);
    }`;
  const CORNERS = `
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0, 0.0, 1.0); }`;
  // An octahedral map: as the struct Sky of the crate.
  const SKY = `
    uniform highp sampler2D sky;
    uniform mat3 world_from_camera;
    uniform vec2 screen;
    uniform float focal;
    out vec4 color;
    void main() {
      vec3 d = world_from_camera * vec3((gl_FragCoord.xy - 0.5 * screen) * vec2(1, -1) / focal, 1.0);
      d /= abs(d.x) + abs(d.y) + abs(d.z);
      vec2 at = d.z < 0.0 ? (1.0 - abs(d.yx)) * vec2(d.x < 0.0 ? -1 : 1, d.y < 0.0 ? -1 : 1) : d.xy;
      ivec2 last = textureSize(sky, 0) - 1;
      vec2 place = clamp((at * 0.5 + 0.5) * vec2(last), vec2(0), vec2(last));
      ivec2 low = min(ivec2(place), max(last - 1, 0)), high = min(low + 1, last);
      vec2 part = place - vec2(low);
      color = vec4(mix(
        mix(texelFetch(sky, low, 0).rgb, texelFetch(sky, ivec2(high.x, low.y), 0).rgb, part.x),
        mix(texelFetch(sky, ivec2(low.x, high.y), 0).rgb, texelFetch(sky, high, 0).rgb, part.x), part.y), 1.0);
    }`;

  // ---- Buffers and textures; numbers are read once and kept, so that a lost context can come back ----
  const count = data.count;
  const texels = new Uint32Array(8 * ROW * Math.max(1, Math.ceil(count / ROW)));
  {
    const shapes = new Uint32Array(blob("gaussians-shapes"));
    const harmonics = data.degree > 0 ? new Uint32Array(blob("gaussians-harmonics")) : null;
    for (let k = 0; k < count; k++) {
      texels.set(shapes.subarray(6 * k, 6 * k + 6), 8 * k);
      if (harmonics) texels.set(harmonics.subarray(2 * k, 2 * k + 2), 8 * k + 6);
    }
  }
  const sky = new Float32Array(blob("gaussians-sky"));
  let drawn = null;
  function texture(unit, inside, width, height, format, type, numbers) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, format, type, numbers);
  }
  function begin() {
    texture(0, gl.RGBA32UI, 2 * ROW, texels.length / (8 * ROW), gl.RGBA_INTEGER, gl.UNSIGNED_INT, texels);
    texture(1, gl.RGB32F, data.sky, data.sky, gl.RGB, gl.FLOAT, sky);
    const array = gl.createVertexArray(), order = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, order);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * Math.max(count, 1), gl.STREAM_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 4, 0);
    gl.vertexAttribDivisor(0, 1);
    const programs = [program(gl, CORNERS, SKY), program(gl, SPLATS, ELLIPSE)];
    gl.disable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    drawn = { programs, array, order };
  }

  // ---- Order by depth: a counting sort by the upper bits of depths, whose order is that of the numbers ----
  const NEAR_M = 0.05, SHIFT = 11;
  const place = new Float32Array(texels.buffer);
  const depth = new Float32Array(count), bits = new Uint32Array(depth.buffer);
  const kept = new Uint32Array(count), sorted = new Uint32Array(count);
  const nearest = new Uint32Array(new Float32Array([NEAR_M]).buffer)[0] >> SHIFT;
  const starts = new Uint32Array((0x7f800000 >> SHIFT) - nearest + 2);
  // Indices of what is in front of the camera, farthest first, in `sorted`; returns their number.
  function sort(center, forward) {
    const [cx, cy, cz] = center, [fx, fy, fz] = forward;
    const last = starts.length - 2;
    let inFront = 0;
    starts.fill(0);
    for (let k = 0; k < count; k++) {
      const at = 8 * k;
      depth[k] = (place[at] - cx) * fx + (place[at + 1] - cy) * fy + (place[at + 2] - cz) * fz;
      if (!(depth[k] >= NEAR_M)) continue;
      kept[inFront++] = k;
      starts[last - ((bits[k] >> SHIFT) - nearest) + 1]++;
    }
    for (let k = 0; k <= last; k++) starts[k + 1] += starts[k];
    for (let n = 0; n < inFront; n++) {
      const k = kept[n];
      sorted[starts[last - ((bits[k] >> SHIFT) - nearest)]++] = k;
    }
    return inFront;
  }

  // ---- The camera ----
  const FOCAL = 1.5; // Focal length by half the height of the canvas; a tall canvas shows as much to the sides as a square one.
  const camera = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
  const product = ([a, b, c, d], [e, f, g, h]) => [
    a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e,
  ];
  const unit = (q) => q.map((v) => v / (Math.hypot(...q) || 1));
  // Rotation by an angle about an axis of length 1.
  const about = (axis, angle) => [Math.cos(angle / 2), ...axis.map((v) => v * Math.sin(angle / 2))];
  // The camera's axes in the world: right, down, forward.
  function axes() {
    const [w, x, y, z] = camera.rotation;
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
      [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
      [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ];
  }
  function setPose(pose) {
    camera.position = pose.slice(0, 3);
    camera.rotation = unit(pose.slice(3));
    draw();
  }

  // ---- Drawing, at most once per frame of the screen ----
  let isWaiting = false, isVisible = true;
  function draw() {
    if (isWaiting || !isVisible) return;
    isWaiting = true;
    requestAnimationFrame((now) => {
      isWaiting = false;
      if (gl.isContextLost()) return;
      advance(now);
      fit(canvas);
      const screen = [canvas.width, canvas.height];
      const focal = FOCAL * Math.min(...screen) / 2;
      const [right, down, forward] = axes();
      gl.viewport(0, 0, ...screen);
      gl.bindVertexArray(drawn.array);
      const shown = sort(camera.position, forward);
      gl.bindBuffer(gl.ARRAY_BUFFER, drawn.order);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, sorted, 0, shown);
      for (const [number, { made, at }] of drawn.programs.entries()) {
        gl.useProgram(made);
        gl.uniformMatrix3fv(at("world_from_camera"), false, [...right, ...down, ...forward]);
        gl.uniform2fv(at("screen"), screen);
        gl.uniform1f(at("focal"), focal);
        if (number === 0) {
          gl.uniform1i(at("sky"), 1);
          gl.disable(gl.BLEND);
          gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
          continue;
        }
        gl.uniform1i(at("gaussians"), 0);
        gl.uniform3fv(at("center"), camera.position);
        gl.uniform2fv(at("scales"), data.scales);
        gl.uniform1i(at("compensates"), data.compensates);
        gl.uniform1i(at("has_harmonics"), data.degree > 0);
        gl.enable(gl.BLEND);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, shown);
      }
    });
  }

  // ---- Flight along the path of a camera: poses at equal steps of time, with a cubic between them ----
  const STEP_WAIT_MS = 1500; // Between poses where the reader wants no motion.
  const LONGEST_S = 120; // Longer walks fly faster.
  const button = document.getElementById("gaussians-fly");
  const slider = document.getElementById("gaussians-place");
  const select = document.getElementById("gaussians-camera");
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let path = data.paths[0], isFlying = false, lastMs = null;
  // Catmull-Rom spline.
  function poseAt(where) {
    const last = path.poses.length - 1, low = clamp(Math.floor(where), 0, Math.max(last - 1, 0)), t = where - low;
    const [a, b, c, d] = [-1, 0, 1, 2].map((k) => path.poses[clamp(low + k, 0, last)]);
    return b.map((v, k) => v + 0.5 * t * (c[k] - a[k] + t * (2 * a[k] - 5 * v + 4 * c[k] - d[k] + t * (3 * (v - c[k]) + d[k] - a[k]))));
  }
  function goTo(where) {
    const text = (where * path.step_s).toFixed(1) + " s";
    slider.value = where;
    slider.setAttribute("aria-valuetext", text);
    document.getElementById("gaussians-time").textContent = text;
    setPose(poseAt(where));
  }
  function fly(flies) {
    isFlying = flies;
    lastMs = null;
    button.textContent = flies ? "Stop" : "Fly along the path";
    button.setAttribute("aria-pressed", flies);
    if (flies) draw();
  }
  // The next place of a flight, before a frame is drawn.
  function advance(now) {
    if (!isFlying) return;
    const last = path.poses.length - 1, passed = now - (lastMs ?? now);
    lastMs ??= now;
    let where = Number(slider.value);
    if (calm.matches) {
      if (passed >= STEP_WAIT_MS) where = Math.floor(where) + 1;
    } else {
      const speed = Math.max(1, last * path.step_s / LONGEST_S);
      where += Math.min(passed, 100) / 1000 * speed / path.step_s;
    }
    if (where !== Number(slider.value)) {
      lastMs = now;
      goTo(where > last ? 0 : where);
    }
    if (calm.matches) setTimeout(draw, STEP_WAIT_MS - passed); else draw();
  }

  // ---- What the reader does ----
  const REACH_M = 3; // Distance at which what is dragged follows the pointer.
  function turn(dx, dy) {
    fly(false);
    const yaw = about([0, 0, 1], 0.004 * dx), pitch = about([1, 0, 0], 0.004 * dy);
    camera.rotation = unit(product(product(yaw, camera.rotation), pitch));
    draw();
  }
  function move(dx, dy, ahead = 0) {
    fly(false);
    const perPx = REACH_M / (FOCAL * Math.min(canvas.clientWidth, canvas.clientHeight) / 2);
    const by = [-dx * perPx, -dy * perPx, ahead];
    axes().forEach((axis, k) => { camera.position = add(camera.position, axis, by[k]); });
    draw();
  }
  watchPointers(canvas, (dx, dy, isPan, spread) => {
    if (isPan) move(dx, dy, -REACH_M * Math.log(spread)); else turn(dx, dy);
  });
  canvas.addEventListener("wheel", (event) => {
    // A reader who scrolls past keeps scrolling; a click into the view makes the wheel move the camera.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    move(0, 0, -0.002 * REACH_M * clamp(event.deltaY, -300, 300));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const shift = event.shiftKey ? move : turn;
    const keys = {
      ArrowLeft: () => shift(20, 0), ArrowRight: () => shift(-20, 0), ArrowUp: () => shift(0, 20), ArrowDown: () => shift(0, -20),
      "+": () => move(0, 0, 0.2), "=": () => move(0, 0, 0.2), "-": () => move(0, 0, -0.2), Home: () => goTo(0),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  button.addEventListener("click", () => fly(!isFlying));
  slider.addEventListener("input", () => {
    fly(false);
    goTo(Number(slider.value));
  });
  for (const [number, { name }] of data.paths.entries()) select.append(new Option(name, number));
  function choose() {
    path = data.paths[Number(select.value)];
    slider.max = path.poses.length - 1;
    goTo(0);
  }
  select.addEventListener("change", choose);
  // An address that ends with #gaussians= and a pose shows what is seen from there.
  function goToAddress() {
    const [name, text] = location.hash.slice(1).split("="), pose = (text ?? "").split(",").map(Number);
    if (name !== "gaussians" || pose.length !== 7 || !pose.every(Number.isFinite)) return;
    fly(false);
    setPose(pose);
  }
  addEventListener("hashchange", goToAddress);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { begin(); draw(); });
  new ResizeObserver(draw).observe(canvas);
  new IntersectionObserver(([seen]) => {
    isVisible = seen.isIntersecting;
    if (isVisible) draw();
  }).observe(canvas);

  show(true);
  try {
    begin();
    choose();
    goToAddress();
  } catch (error) {
    show(false);
    throw error;
  }
})();
