/* The first page's picture: drawn step by step once it is in view, and again when asked for.

   Without this script, and where less motion is asked for, the picture stands there complete. */
"use strict";

(() => {
  const LASTS = 4500; // milliseconds; what moves for longer than five seconds would need a way to stop it
  const figure = document.querySelector(".rhl-opening");
  if (!figure) return;
  const frame = figure.querySelector("clipPath rect");
  const whole = Number(frame.getAttribute("width"));
  const curves = [...figure.querySelectorAll(".curves path")];
  const points = curves.map((path) => path.getAttribute("d").slice(1).split("L").map((pair) => pair.split(" ").map(Number)));
  const heads = curves.map((path) => {
    const head = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    head.setAttribute("class", `head ${path.getAttribute("class")}`);
    head.setAttribute("r", 5);
    path.parentNode.append(head);
    return head;
  });
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  let begun = null;
  let moving = false;

  function show(share) {
    const at = share * (points[0].length - 1);
    const [k, part] = [Math.min(Math.floor(at), points[0].length - 2), at - Math.min(Math.floor(at), points[0].length - 2)];
    points.forEach((path, i) => {
      const [[x0, y0], [x1, y1]] = [path[k], path[k + 1]];
      heads[i].setAttribute("cx", x0 + part * (x1 - x0));
      heads[i].setAttribute("cy", y0 + part * (y1 - y0));
    });
    const reached = Number(heads[0].getAttribute("cx"));
    frame.setAttribute("width", share < 1 ? reached + 5 - Number(frame.getAttribute("x")) : whole);
  }

  function tick(now) {
    begun ??= now;
    const share = Math.min((now - begun) / LASTS, 1);
    show(share);
    figure.dataset.shown = String(share);
    if (share < 1) { requestAnimationFrame(tick); return; }
    begun = null;
    moving = false;
  }

  const play = () => {
    if (moving) return;
    moving = true;
    requestAnimationFrame(tick);
  };
  const again = document.createElement("button");
  again.type = "button";
  again.textContent = "Play again";
  again.addEventListener("click", play);
  figure.querySelector(".keys").append(again);
  show(1);
  figure.dataset.shown = "1";
  if (still.matches) {
    again.textContent = "Play";
    return;
  }
  const seen = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    play();
  }, { threshold: 0.5 });
  seen.observe(figure.querySelector("svg"));
})();
