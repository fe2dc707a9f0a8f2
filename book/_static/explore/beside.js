/* The explorers beside the paper's simulations: the pace of the terminal weight, and plants that others chose. */
"use strict";

(() => {
  const { load, short, element, slider, status, Chart, install } = rhlExplore;

  const capital = (text) => text[0].toUpperCase() + text.slice(1);

  function pace(host, data) {
    const chart = new Chart({
      title: "size of the state |x|", log: true, height: 230, across: { from: 0, to: data.k.at(-1), name: "step k" },
      hold: true, frame: [1e-6, 1],
    });
    const line = status();

    function draw() {
      const [i, j, n] = [growth.place, schedule.place, horizon.place];
      const [size, level] = [data.size[i][j][n], data.level[i][n]];
      const limit = level === null ? null : data.epsilon[j].map((value) => Math.sqrt(level * value));
      chart.draw([
        { x: data.k, y: size, kind: "line", colour: 1, label: "|x(k)|" },
        ...(limit ? [{ x: data.k, y: limit, kind: "line", colour: 2, label: "root of level·ε(k)" }] : []),
      ]);
      const start = `With a = ${data.growths[i]}, N = ${data.horizons[n]} and ε(k) = ${data.schedules[j]}, `;
      line.say(start + (limit
        ? `the terminal weight settles at ${short(level)}, so that |x(k)| falls like the root of ε(k): at k = ` +
          `${data.k.at(-1)} it is ${short(size.at(-1))}, and the root is ${short(limit.at(-1))}.`
        : `the stage costs alone hold the plant, and |x(k)| falls geometrically, to ${short(size.at(-1))} at k = ${data.k.at(-1)}.`));
    }

    const control = (words, symbol, values, place) => slider({
      words, symbol, count: values.length, place, say: (at) => String(values[at]), move: draw,
    });
    const horizon = control("horizon", "N", data.horizons, 0);
    const schedule = control("schedule", "ε(k)", data.schedules, 1);
    const growth = control("growth of the plant", "a", data.growths, 1);
    host.replaceChildren(
      element("div", { class: "charts one" }, chart.figure),
      line,
      element("fieldset", {}, element("legend", {}, "A scalar plant with a known model"), horizon.row, schedule.row, growth.row),
    );
    draw();
  }

  function plants(host, data) {
    const chart = new Chart({
      title: "largest output, in first sizes", log: true, height: 240,
      across: { from: 0, to: data.steps - 1, name: "step k" }, hold: true, frame: [1e-6, 10], floor: 1e-6,
    });
    const line = status();
    const fit = element("button", { type: "button" }, "Fit the axes to this run");
    const picker = element("select", { id: "rhl-plants" },
      ...Object.entries(data.names).map(([name, title]) =>
        element("option", { value: name }, title.startsWith("COMPleib") ? title : `${capital(title)} (${name})`)));
    const steps = Array.from({ length: data.steps }, (_, k) => k);
    const curves = { default: "default scheme", window: "window scheme", known: "known model" };
    let run = null;
    let asked = 0;

    function ended(values) {
      if (values.length < data.steps) return `leaves the range of numbers at k = ${values.length}`;
      return `peaks at ${short(Math.max(...values))} and ends at ${short(values.at(-1))}`;
    }

    function draw() {
      if (!run) return;
      const i = noise.place;
      chart.draw(Object.entries(curves).map(([key, label], j) =>
        ({ x: steps, y: run[key][i], kind: "line", colour: j + 1, label })));
      const parts = Object.entries(curves).map(([key, label]) => `${label}: ${ended(run[key][i])}`).join("; ");
      line.say(`${capital(run.title)}, order ${run.order}, spectral radius ${short(run.radius)}. ${parts}.` +
        (chart.beyond ? " Curves leave the axes, which stay as they were." : ""));
    }

    async function choose() {
      asked += 1;
      const mine = asked;
      try {
        const found = await load(`plant-${picker.value}`);
        if (mine !== asked) return;
        run = found;
        draw();
      } catch (error) {
        line.say(`${error.message}${run ? `; the curves are still those of ${run.title}` : ""}.`);
      }
    }

    const percent = data.noises.map((share) => 100 * share);
    const noise = slider({
      words: "errors of the sensor, in % of the first outputs", symbol: "σ", count: percent.length, place: 0,
      say: (place) => `${percent[place]} %`, move: draw,
    });
    picker.value = "maglev";
    picker.addEventListener("change", choose);
    fit.addEventListener("click", () => {
      chart.refit();
      draw();
    });
    host.replaceChildren(
      element("div", { class: "charts one" }, chart.figure),
      line,
      element("div", { class: "controls" }, element("label", { for: picker.id }, "Plant"), picker, fit),
      noise.row,
    );
    choose();
  }

  install("pace", pace);
  install("plants", plants);
})();
