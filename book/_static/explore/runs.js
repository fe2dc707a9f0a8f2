/* The explorers of the two simulations: sliders over runs that rhl computed, one file of runs for each sweep. */
"use strict";

(() => {
  const { load, short, element, slider, status, Chart, install } = rhlExplore;

  /* Which file holds the run at these places of a group's sliders, and where in it. */
  function locate(name, number, group, places) {
    if (group.length === 1) return { file: `${name}-${number}-0`, at: places[0] };
    const at = group.slice(1).reduce((sum, setting, i) => sum * setting.values.length + places[i + 1], 0);
    return { file: `${name}-${number}-${places[0]}`, at };
  }

  function build(name, host, data) {
    const steps = Array.from({ length: data.steps }, (_, k) => k);
    const charts = data.panels.map((panel) => new Chart({
      title: panel.title,
      log: panel.log,
      across: { from: 0, to: data.steps - 1, name: "step k" },
      height: data.panels.length > 4 ? 150 : 180,
      frame: Object.keys(panel.curves).flatMap((key) => data.own[key]).concat(...Object.values(panel.published)),
    }));
    const line = status();
    const numbers = element("table", { class: "dataframe" });
    const box = element("div", { class: "numbers" }, numbers);
    const more = element("details", {}, element("summary", {}, "The numbers of this run"), box);
    let shown = data.own;
    let said = ""; // the settings of the run that is shown
    let asked = 0;

    function table() {
      if (!more.open) return;
      const keys = data.panels.flatMap((panel) => Object.entries(panel.curves));
      const cell = (name, scope, text) => element(name, scope ? { scope } : {}, text);
      const head = ["k", ...keys.map(([, label]) => label)].map((text) => cell("th", "col", text));
      const rows = steps.slice(0, shown.y1?.length ?? 0).map((k) => element("tr", {}, cell("th", "row", String(k)),
        ...keys.map(([key]) => cell("td", null, String(shown[key][k] ?? "–")))));
      numbers.replaceChildren(element("caption", {}, `At ${said}`),
        element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...rows));
    }

    const settled = () => groups.flat()
      .map(({ setting, control }) => `${setting.symbol} = ${short(setting.values[control.place])}`).join(", ");

    function draw() {
      said = settled();
      charts.forEach((chart, i) => {
        const { curves, published } = data.panels[i];
        const layers = Object.entries(curves).map(([key, label], j) =>
          ({ x: steps, y: shown[key] ?? [], kind: "steps", colour: j + 1, label }));
        for (const circles of Object.values(published)) {
          layers.push({ x: steps, y: circles, kind: "dots", colour: 2, label: "published" });
        }
        chart.draw(layers, shown.diverged === null ? null : { x: shown.diverged, text: `diverges, k = ${shown.diverged}` });
      });
      table();
      line.say(summary());
    }

    function summary() {
      if (shown.diverged !== null) {
        return `At ${said} the run leaves the range of floating-point numbers at k = ${shown.diverged}.`;
      }
      const { curves } = data.panels[0];
      const [key, label] = Object.entries(curves)[0];
      const sizes = shown[key].map(Math.abs);
      const peak = Math.max(...sizes);
      const least = Math.min(...shown.margin_augmented.filter((value) => value !== null));
      return `At ${said}: |${label}| is at most ${short(peak)}, at k = ${sizes.indexOf(peak)}, ` +
        `and ${short(sizes.at(-1))} at the end; the augmented pair's smallest margin is ${short(least)}.`;
    }

    async function move(number) {
      groups.forEach((group, i) => {
        if (i !== number) group.forEach(({ setting, control }) => control.set(setting.own));
      });
      const places = groups[number].map(({ control }) => control.place);
      const { file, at } = locate(name, number, data.groups[number], places);
      asked += 1;
      const mine = asked;
      try {
        const { runs } = await load(file);
        if (mine !== asked) return; // the slider has moved on meanwhile
        shown = runs[at];
        draw();
      } catch (error) {
        line.say(`${error.message}; the curves are still those at ${said}.`);
      }
    }

    const groups = data.groups.map((group, number) => group.map((setting) => ({
      setting,
      control: slider({
        words: setting.words,
        symbol: setting.symbol,
        count: setting.values.length,
        place: setting.own,
        say: (place) => short(setting.values[place]) + (place === setting.own ? " (as published)" : ""),
        move: () => move(number),
      }),
    })));
    const back = element("button", { type: "button" }, "Back to the published run");
    back.addEventListener("click", () => {
      groups.flat().forEach(({ setting, control }) => control.set(setting.own));
      asked += 1;
      shown = data.own;
      draw();
    });
    more.addEventListener("toggle", table);

    const fields = (legend, chosen) =>
      element("fieldset", {}, element("legend", {}, legend), ...chosen.flat().map(({ control }) => control.row));
    const together = groups.filter((group) => group.length > 1);
    const alone = groups.filter((group) => group.length === 1);
    host.replaceChildren(
      element("div", { class: "charts" }, ...charts.map((chart) => chart.figure)),
      line,
      ...together.map((group) => fields("These may be combined", [group])),
      fields("One at a time: moving one takes all others back", alone),
      back,
      more,
    );
    draw();
  }

  for (const name of ["linear", "robot"]) install(name, (host, data) => build(name, host, data));
})();
