/* A run step by step: the data that the model is fitted to, its entries, its prediction, its plan, and what was applied.

   The run and the step stand in the address, #watch=linear&k=12, so that a link restores them. */
"use strict";

(() => {
  const { load, short, element, slider, status, Chart, install } = rhlExplore;
  const RUNS = { ball: "The suspended ball", linear: "The linear example", arm: "The robot arm" };
  const PACE = 700; // milliseconds for a step

  function asked() {
    const [, run, k] = location.hash.match(/^#watch=([a-z]+)(?:&k=(\d+))?$/) ?? [];
    return Object.hasOwn(RUNS, run) ? { run, k: k === undefined ? null : Number(k) } : null;
  }

  /* "position (m)" and 0.01 as "position = 0.01 m", "output y" and 2 as "y = 2". */
  function named(title, value) {
    const [, name, unit] = title.match(/^(?:input |output )?(.*?)(?: \((.*)\))?$/);
    return `${name} = ${short(value)}${unit ? ` ${unit}` : ""}`;
  }
  const list = (titles, rows, k) => titles.map((title, i) => named(title, rows[i][k])).join(", ");

  function words(data, k) {
    const came = list(data.outputs, data.y, k);
    const first = k === 0 ? `At step 0, ${came} was measured.`
      : `At step ${k} the model of step ${k - 1} had predicted ${list(data.outputs, data.predicted, k)}; ${came} was measured.`;
    const [from, to] = data.fitted[k] ?? [];
    const fit = from === undefined ? "There are too few data for a fit, so the initial model is kept."
      : `The model was then fitted to the outputs of ${from === to ? `step ${to}` : `steps ${from} to ${to}`}.`;
    const older = data.lag ? (k === 0 ? "with the initial model" : `with the model of step ${k - 1}`) : "with it";
    return `${first} ${fit} The plan was made ${from === undefined && !data.lag ? "with that model" : older}: it looks ` +
      `${data.horizon} steps ahead and weights its end by ${short(data.weight[k])}. Its first input, ` +
      `${list(data.inputs, data.v, k)}, was applied.`;
  }

  const upTo = (values, k) => values.map((value, i) => (i <= k ? value : null));

  function build(host, start, startRun) {
    let [data, run] = [start, startRun];
    let charts = [];
    let timer = null;
    let wanted = 0;
    const line = status();
    const panels = element("div", { class: "charts" });
    const plan = element("table", { class: "dataframe" });
    const model = element("table", { class: "dataframe" });
    const box = element("div", { class: "numbers pair" }, plan, model);
    const more = element("details", {}, element("summary", {}, "The numbers at this step"), box);

    function lay() {
      const last = data.y[0].length - 1;
      const across = { from: 0, to: last, name: "step k" };
      const make = (title, values, draw) => {
        const chart = new Chart({ title, across, height: data.outputs.length > 1 ? 140 : 175 });
        chart.fix(values.flat());
        return { chart, draw };
      };
      const steps = data.y[0].map((_, k) => k);
      const ahead = (k, count) => Array.from({ length: count }, (_, i) => k + i);
      const entries = (title, found, colour) => make(title, found.map(({ values }) => values), (k) => [
        found.map(({ values }) => ({ x: steps, y: upTo(values, k), kind: "steps", colour, label: "entries" })), null]);
      charts = [
        ...data.outputs.map((title, i) => make(title, [data.y[i], data.predicted[i]], (k) => [[
          { x: ahead(k, data.planned_y[k][i].length), y: data.planned_y[k][i], kind: "line", colour: 3, look: "ahead", label: "planned" },
          { x: steps, y: upTo(data.y[i], k), kind: "steps", colour: 1, label: "measured" },
          { x: steps, y: upTo(data.predicted[i], k - 1), kind: "dots", colour: 2, look: "past", label: "predicted" },
          { x: [k], y: [data.predicted[i][k]], kind: "dots", colour: 2, size: 5, look: "now", label: "predicted" },
        ], data.fitted[k] && { from: Math.max(0, data.fitted[k][0] - 0.5), to: Math.min(last, data.fitted[k][1] + 0.5) }])),
        ...data.inputs.map((title, i) => make(title, [data.v[i]], (k) => [[
          { x: ahead(k, data.planned_v[k][i].length), y: data.planned_v[k][i], kind: "steps", colour: 3, look: "ahead", label: "planned" },
          { x: steps, y: upTo(data.v[i], k), kind: "steps", colour: 1, label: "applied" },
        ], null])),
        entries("model entries for past outputs", data.of_outputs, 1),
        entries("model entries for inputs", data.of_inputs, 2),
      ];
      panels.replaceChildren(...charts.map(({ chart }) => chart.figure));
      panels.classList.toggle("many", charts.length > 4);
    }

    function table() {
      if (!more.open) return;
      const k = at.place;
      const cell = (name, scope, text) => element(name, scope ? { scope } : {}, text);
      const rows = data.planned_y[k][0].map((_, i) => element("tr", {}, cell("th", "row", String(k + i)),
        ...data.planned_y[k].map((row) => cell("td", null, String(row[i]))),
        ...data.planned_v[k].map((row) => cell("td", null, String(row[i] ?? "–")))));
      plan.replaceChildren(element("caption", {}, `The plan at step ${k}`),
        element("thead", {}, element("tr", {},
          ...["step", ...data.outputs, ...data.inputs].map((title) => cell("th", "col", title)))),
        element("tbody", {}, ...rows));
      const known = [...data.of_outputs, ...data.of_inputs];
      model.replaceChildren(element("caption", {}, `The model at step ${k}: what predicts y(k+1)`),
        element("tbody", {}, ...known.map(({ name, values }) =>
          element("tr", {}, cell("th", "row", name), cell("td", null, String(values[k]))))));
    }

    function show() {
      const k = at.place;
      for (const { chart, draw } of charts) {
        const [layers, band] = draw(k);
        chart.draw(layers, { x: k, text: `k = ${k}` }, band);
      }
      table();
      line.say(words(data, k));
    }

    const keep = () => history.replaceState(null, "", `#watch=${run}&k=${at.place}`);

    function go(k) {
      at.set(Math.min(Math.max(k, 0), data.y[0].length - 1));
      show();
      if (timer === null) keep();
    }

    function stop() {
      if (timer === null) return;
      clearInterval(timer);
      timer = null;
      play.textContent = "Play";
      line.quiet = false;
      line.say(words(data, at.place));
      keep();
    }

    function toggle() {
      if (timer !== null) { stop(); return; }
      const last = data.y[0].length - 1;
      if (at.place === last) go(0);
      play.textContent = "Pause";
      // Every step would be read out over the one before.
      line.quiet = true;
      timer = setInterval(() => {
        go(at.place + 1);
        if (at.place === last) stop();
      }, PACE);
    }

    async function choose(name, k) {
      stop();
      wanted += 1;
      const mine = wanted;
      try {
        const found = await load(`watch-${name}`);
        if (mine !== wanted) return;
        [data, run] = [found, name];
      } catch (error) {
        picker.value = run;
        line.say(`${error.message}; this is still ${data.title.toLowerCase()}.`);
        return;
      }
      picker.value = run;
      at.input.max = data.y[0].length - 1;
      lay();
      go(k ?? data.start);
    }

    const button = (text, act) => {
      const made = element("button", { type: "button" }, text);
      made.addEventListener("click", act);
      return made;
    };
    const step = (by) => {
      stop();
      go(at.place + by);
    };
    const play = button("Play", toggle);
    const back = button("Step back", () => step(-1));
    const on = button("Step on", () => step(1));
    const copy = button("Copy link", async () => {
      keep();
      try {
        await navigator.clipboard.writeText(location.href);
        line.say("The link to this step is copied.");
      } catch {
        line.say("The browser does not let this page copy. The address bar holds the link to this step.");
      }
    });
    const at = slider({
      words: "step", symbol: "k", count: data.y[0].length, place: data.start, say: String, move: () => step(0),
    });
    const picker = element("select", { id: "rhl-watch-run" },
      ...Object.entries(RUNS).map(([key, title]) => element("option", { value: key }, title)));
    picker.value = run;
    picker.addEventListener("change", () => choose(picker.value, null));

    // A click on a chart brings the focus here. Space plays and arrows step wherever it is, but where the browser gives them a meaning of their own.
    host.tabIndex = -1;
    panels.tabIndex = 0;
    panels.setAttribute("role", "group");
    panels.setAttribute("aria-label", "Charts of the run. Space plays and pauses, the arrow keys step.");
    host.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      const kind = event.target.localName;
      if (event.key === " " && !["button", "summary", "select"].includes(kind)) toggle();
      else if (["ArrowLeft", "ArrowRight"].includes(event.key) && !["input", "select"].includes(kind)) {
        step(event.key === "ArrowLeft" ? -1 : 1);
      } else return;
      event.preventDefault();
    });
    more.addEventListener("toggle", table);
    addEventListener("hashchange", () => {
      const view = asked();
      if (view && (view.run !== run || view.k !== at.place)) choose(view.run, view.k);
    });

    host.replaceChildren(
      panels,
      line,
      element("div", { class: "controls" },
        element("label", { for: picker.id }, "Run"), picker, back, play, on, copy),
      at.row,
      more,
    );
    lay();
    const view = asked();
    if (view) at.set(Math.min(view.k ?? data.start, data.y[0].length - 1));
    show();
    if (view) host.addEventListener("ready", () => host.scrollIntoView());
  }

  const first = asked()?.run ?? "ball";
  install("watch", (host, data) => build(host, data, first), `watch-${first}`);
})();
