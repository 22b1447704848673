// Shared by the views of a report, within the function of each: vectors, WebGL2 programs and embedded numbers.
const add = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = {};
  return { made, at: (name) => places[name] ??= gl.getUniformLocation(made, name) };
}
// Bytes of an element that holds them in base64.
function blob(name) {
  const text = atob(document.getElementById(name).textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes.buffer;
}
// A canvas gets the size of its place on the page, two device pixels per CSS pixel at most; returns that ratio.
function fit(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  return ratio;
}
// Pointers on a canvas, as moves of their middle in CSS pixels and changes of their spread; `begin` at a touch.
function watchPointers(canvas, move, begin = () => {}) {
  const fingers = new Map();
  const hold = () => {
    const all = [...fingers.values()];
    const middle = [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
    const spread = all.length < 2 ? 0 : Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]);
    return { middle, spread };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    begin();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = hold();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const after = hold();
    const [dx, dy] = [0, 1].map((k) => after.middle[k] - before.middle[k]);
    const isPan = fingers.size > 1 || event.shiftKey || (event.buttons & 6) !== 0;
    move(dx, dy, isPan, before.spread > 0 && after.spread > 0 ? before.spread / after.spread : 1);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}
