"use strict";
for (const film of document.querySelectorAll(".film:not([data-ready])")) {
  film.dataset.ready = "";
  const { step_s, frames } = JSON.parse(film.querySelector("script[type='application/json']").textContent);
  const [image, marker, bar, note] =
    [".film-image", ".film-marker", ".film-bar", "figcaption"].map(name => film.querySelector(name));
  const [button, range, time] = ["button", "input", "output"].map(name => bar.querySelector(name));
  let number = 0, timer = null;
  const show = (next) => {
    number = next;
    const [jpeg, x, y, degrees, caption] = frames[number];
    image.src = "data:image/jpeg;base64," + jpeg;
    if (marker) marker.setAttribute("transform", `translate(${x},${y}) rotate(${degrees})`);
    note.textContent = caption;
    range.value = number;
    time.textContent = (number * step_s).toFixed(1) + " s";
  };
  const play = (on) => {
    clearInterval(timer);
    timer = on ? setInterval(() => show((number + 1) % frames.length), 1000 * step_s) : null;
    button.textContent = on ? "Pause" : "Play";
  };
  button.onclick = () => play(timer === null);
  range.oninput = () => { play(false); show(Number(range.value)); };
  bar.hidden = false;
  show(0);
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
}
