/* The explorers of two lemmas: the spiral of Lemma 4, and the mixtures of Lemma 5. */
"use strict";

(() => {
  const { short, element, shape, slider, status, Chart, install } = rhlExplore;

  /* ---- Lemma 4: iterates in the plane, by norm and angle */

  function spiral(host, data) {
    const size = 360;
    const figure = element("figure", { class: "plane" });
    const svg = shape("svg", { viewBox: `${-size / 2} ${-size / 2} ${size} ${size}`, role: "img" }, figure);
    const unit = size / 2 - 22;
    for (const r of [0.25, 0.5, 0.75, 1]) {
      shape("circle", { class: "grid ring", r: r * unit }, svg);
    }
    const path = shape("path", { class: "curve c1" }, svg);
    for (const r of [0.25, 0.5, 0.75, 1]) {
      shape("text", { class: "tick along ring", x: 0, y: -r * unit - 3 }, svg, String(r));
    }
    const target = shape("path", { class: "target", d: "M0-8L2-2.5 8-2.5 3 1.2 5 7.5 0 3.6-5 7.5-3 1.2-8-2.5-2-2.5Z" }, svg);
    shape("title", {}, target, "the only common minimiser");
    const point = shape("circle", { class: "point", r: 5 }, svg);
    const line = status();
    const at = (norm, angle) => [unit * norm * Math.cos(angle), -unit * norm * Math.sin(angle)];

    function draw() {
      const [place, choice] = [k.place, e.place];
      const [norm, angle] = [data.norm[choice], data.angle[choice]];
      let d = "";
      for (let i = 0; i <= place; i += 1) {
        // Between the iterates that are kept, the path is drawn in steps of a tenth of a radian.
        const pieces = i ? Math.max(1, Math.ceil((angle[i] - angle[i - 1]) / 0.1)) : 1;
        for (let part = 1; part <= pieces; part += 1) {
          const t = i ? part / pieces : 0;
          const before = Math.max(i - 1, 0);
          const [x, y] = at(norm[before] + t * (norm[i] - norm[before]), angle[before] + t * (angle[i] - angle[before]));
          d += `${d ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
        }
      }
      path.setAttribute("d", d);
      const [x, y] = at(norm[place], angle[place]);
      point.setAttribute("cx", x.toFixed(3));
      point.setAttribute("cy", y.toFixed(3));
      const turns = angle[place] / (2 * Math.PI);
      const words = `After ${data.k[place].toLocaleString("en")} steps with e = ${data.exponents[choice]}: ` +
        `distance ${short(norm[place])} from the only common minimiser, ${short(turns)} turns around it.`;
      svg.setAttribute("aria-label", words);
      line.say(words);
    }

    const k = slider({
      words: "iterations", symbol: "k", count: data.k.length, place: data.k.length - 1,
      say: (place) => data.k[place].toLocaleString("en"), move: draw,
    });
    const e = slider({
      words: "exponent of δ(k)", symbol: "e", count: data.exponents.length, place: data.own,
      say: (place) => `${data.exponents[place]}${place === data.own ? " (the counterexample)" : ""}`, move: draw,
    });

    const play = element("button", { type: "button" }, "Let it turn");
    let turning = null;
    function stop() {
      clearInterval(turning);
      turning = null;
      play.textContent = "Let it turn";
    }
    play.addEventListener("click", () => {
      if (turning !== null) { stop(); return; }
      if (k.place === data.k.length - 1) k.set(0);
      play.textContent = "Stop";
      turning = setInterval(() => {
        k.set(k.place + 1);
        draw();
        if (k.place === data.k.length - 1) stop();
      }, 30);
    });
    k.input.addEventListener("input", stop);

    host.replaceChildren(
      figure,
      line,
      element("fieldset", {}, element("legend", {}, "The spiral"), k.row, e.row),
      play,
    );
    draw();
  }

  /* ---- Lemma 5: the margin of the mixture over lambda */

  function mixtures(host, data) {
    const chart = new Chart({
      title: "margin of the mixture", log: true, height: 240, across: { from: 0, to: 1, name: "λ" },
    });
    const line = status();

    function draw() {
      const n = order.place;
      const [lam, margin, bad] = [data.lam[n], data.margin[n], data.bad[n]];
      const place = mixing.place;
      const here = lam[place];
      chart.draw([
        { x: lam, y: margin, kind: "line", colour: 1, label: "margin" },
        { x: data.candidates[n], y: data.found[n], kind: "dots", colour: 2, label: "the paper's candidates" },
      ], { x: here, text: `λ = ${short(here)}` });
      const root = bad.indexOf(place);
      const which = here === 0 ? ": this is the estimate itself" : `, bad value ${root} of ${bad.length - 1} inside (0, 1)`;
      const says = root < 0
        ? `controllable, with a margin of ${short(margin[place])}`
        : `exactly not controllable${which}`;
      line.say(`At λ = ${Number(here.toPrecision(5))} the mixture of order ${data.orders[n]} is ${says}. ` +
        `${data.enough[n]} nonzero candidates are enough; the paper tries ${data.candidates[n].length}.`);
    }

    function reorder() {
      // The places of lambda differ from order to order: stay as near as there is one.
      const [before, after] = [data.lam[shown], data.lam[order.place]];
      const here = before[mixing.place];
      shown = order.place;
      mixing.input.max = after.length - 1;
      mixing.set(after.reduce((best, share, i) => (Math.abs(share - here) < Math.abs(after[best] - here) ? i : best), 0));
      draw();
    }

    const start = data.orders.indexOf(4);
    let shown = start;
    const order = slider({
      words: "order", symbol: "n", count: data.orders.length, place: start,
      say: (place) => String(data.orders[place]), move: reorder,
    });
    const mixing = slider({
      words: "mixing weight", symbol: "λ", count: data.lam[start].length, place: data.bad[start][1],
      say: (place) => short(data.lam[order.place][place]), move: draw,
    });
    const next = element("button", { type: "button" }, "To the next bad λ");
    next.addEventListener("click", () => {
      const bad = data.bad[order.place];
      mixing.set(bad.find((place) => place > mixing.place) ?? bad[0]);
      draw();
    });
    host.replaceChildren(
      element("div", { class: "charts one" }, chart.figure),
      line,
      element("fieldset", {}, element("legend", {}, "The mixture"), mixing.row, order.row),
      next,
    );
    draw();
  }

  install("spiral", spiral);
  install("mixtures", mixtures);
})();
