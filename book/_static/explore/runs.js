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

  /* The peaks of all runs over the first two settings of a group, as a table of cells that set both. */
  function map(group, peaks, chosen, choose) {
    const [down, along] = [group[1].setting, group[0].setting];
    const bounds = [15, 30, 60, 120, 240];
    const level = (peak) => (peak === null ? "x" : bounds.filter((bound) => peak > bound).length);
    const peakAt = (n, r) => peaks[(n * down.values.length + r) * group[2].setting.values.length + group[2].control.place];
    const grid = element("table", { role: "grid", class: "map", "aria-label": "Largest output over horizon and input weight" });
    const cells = down.values.map((_, r) => along.values.map((__, n) => {
      const cell = element("td", { tabindex: "-1" });
      cell.addEventListener("click", () => choose(n, r));
      cell.addEventListener("keydown", (event) => {
        const to = { ArrowLeft: [n - 1, r], ArrowRight: [n + 1, r], ArrowUp: [n, r - 1], ArrowDown: [n, r + 1],
          Home: [0, r], End: [along.values.length - 1, r] }[event.key];
        if (event.key === "Enter" || event.key === " ") choose(n, r);
        else if (to) focus(...to);
        else return;
        event.preventDefault();
      });
      return cell;
    }));
    function focus(n, r) {
      const cell = cells[r]?.[n];
      if (!cell) return;
      cells.flat().forEach((other) => { other.tabIndex = other === cell ? 0 : -1; });
      cell.focus();
    }
    const head = (scope, text) => element("th", { scope }, text);
    grid.append(
      element("thead", {}, element("tr", {}, head("col", `${down.symbol} \\ ${along.symbol}`),
        ...along.values.map((value) => head("col", short(value))))),
      element("tbody", {}, ...down.values.map((value, r) => element("tr", {}, head("row", short(value)), ...cells[r]))));
    const names = [...bounds.map((bound) => `up to ${bound}`), `above ${bounds.at(-1)}`];
    const keys = names.map((text, i) => element("span", { class: "key" }, element("i", { class: `peak-${i}` }), text));
    keys.push(element("span", { class: "key" }, element("i", { class: "peak-x" }, "×"), "diverges"));
    const figure = element("figure", { class: "peaks" },
      element("figcaption", {}, element("b", {}, "Largest |y| over the horizon N and the input weight R. A cell sets both.")),
      element("div", { class: "wide", role: "group", "aria-label": "Map of the largest output", tabindex: "0" }, grid),
      element("p", { class: "legend" }, ...keys));

    function draw() {
      const here = chosen();
      cells.forEach((row, r) => row.forEach((cell, n) => {
        const peak = peakAt(n, r);
        const shown = here !== null && here[0] === n && here[1] === r;
        cell.className = `peak-${level(peak)}`;
        cell.textContent = peak === null ? "×" : peak < 1000 ? String(Math.round(peak)) : short(Number(peak.toPrecision(1)));
        cell.setAttribute("aria-selected", String(shown));
        cell.setAttribute("aria-label", `${along.symbol} = ${short(along.values[n])}, ${down.symbol} = ` +
          `${short(down.values[r])}: ${peak === null ? "the run diverges" : `largest output ${short(peak)}`}`);
        if (shown && !figure.contains(document.activeElement)) {
          cells.flat().forEach((other) => { other.tabIndex = other === cell ? 0 : -1; });
        }
      }));
      if (!cells.flat().some((cell) => cell.tabIndex === 0)) cells[0][0].tabIndex = 0;
    }
    return { figure, draw };
  }

  function build(name, host, data) {
    const steps = Array.from({ length: data.steps }, (_, k) => k);
    const charts = data.panels.map((panel) => new Chart({
      title: panel.title,
      log: panel.log,
      across: { from: 0, to: data.steps - 1, name: "step k" },
      height: data.panels.length > 4 ? 150 : 165,
      hold: true,
      frame: Object.keys(panel.curves).flatMap((key) => data.own[key]).concat(...Object.values(panel.published)),
    }));
    const line = status();
    const numbers = element("table", { class: "dataframe" });
    const box = element("div", { class: "numbers" }, numbers);
    const more = element("details", {}, element("summary", {}, "The numbers of this run"), box);
    let shown = data.own;
    let before = null; // the run that was shown before the last change
    let held = false; // while a slider is dragged, that is the run from which the dragging began
    let news = ""; // which other settings the last change took back
    let said = ""; // the settings of the run that is shown
    let moved = null; // the group whose settings were changed last
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
        const layers = Object.keys(before ? curves : {}).map((key) =>
          ({ x: steps, y: before[key] ?? [], kind: "steps", look: "ghost" }));
        layers.push(...Object.entries(curves).map(([key, label], j) =>
          ({ x: steps, y: shown[key] ?? [], kind: "steps", colour: j + 1, label })));
        for (const circles of Object.values(published)) {
          layers.push({ x: steps, y: circles, kind: "dots", colour: 2, label: "published" });
        }
        chart.draw(layers, shown.diverged === null ? null : { x: shown.diverged, text: `diverges, k = ${shown.diverged}` });
      });
      table();
      peaksMap?.draw();
      const beyond = charts.some((chart) => chart.beyond);
      line.say(`${news}${summary()}${beyond ? " Curves leave the axes, which stay as they were." : ""}`);
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

    function change(run) {
      if (!held) before = shown;
      shown = run;
      draw();
    }

    async function move(number) {
      const back = groups.filter((_, i) => i !== number).flat()
        .filter(({ setting, control }) => control.place !== setting.own);
      back.forEach(({ setting, control }) => control.set(setting.own));
      const others = back.map(({ setting }) => `${setting.symbol} = ${short(setting.values[setting.own])}`).join(", ");
      // The reader should still find it there after the next move of the same slider.
      if (others) news = `This reset the other settings to ${others}. `;
      else if (number !== moved) news = "";
      moved = number;
      const places = groups[number].map(({ control }) => control.place);
      const { file, at } = locate(name, number, data.groups[number], places);
      asked += 1;
      const mine = asked;
      try {
        const { runs } = await load(file);
        if (mine !== asked) return; // the slider has moved on meanwhile
        change(runs[at]);
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
        say: (place) => short(setting.values[place]) + (place === setting.own ? ` (${setting.note})` : ""),
        move: () => move(number),
      }),
    })));
    const back = element("button", { type: "button" }, "Back to the first run");
    back.addEventListener("click", () => {
      groups.flat().forEach(({ setting, control }) => control.set(setting.own));
      asked += 1;
      [news, moved] = ["", null];
      change(data.own);
    });
    const fit = element("button", { type: "button" }, "Fit the axes to this run");
    fit.addEventListener("click", () => {
      charts.forEach((chart) => chart.refit());
      draw();
    });
    for (const { control } of groups.flat()) {
      control.input.addEventListener("pointerdown", () => {
        before = shown;
        held = true;
      });
      for (const end of ["pointerup", "pointercancel"]) control.input.addEventListener(end, () => { held = false; });
    }
    const mapped = groups.findIndex((group) => group.length > 2);
    const peaksMap = data.peaks === undefined ? null : map(groups[mapped], data.peaks,
      () => (moved === null || moved === mapped ? groups[mapped].slice(0, 2).map(({ control }) => control.place) : null),
      (...places) => {
        places.forEach((place, i) => groups[mapped][i].control.set(place));
        move(mapped);
      });
    more.addEventListener("toggle", table);

    const fields = (legend, chosen) =>
      element("fieldset", {}, element("legend", {}, legend), ...chosen.flat().map(({ control }) => control.row));
    const together = groups.filter((group) => group.length > 1);
    const alone = groups.filter((group) => group.length === 1);
    host.replaceChildren(
      ...(peaksMap ? [peaksMap.figure] : []),
      element("div", { class: data.panels.length > 4 ? "charts many" : "charts" }, ...charts.map((chart) => chart.figure)),
      line,
      element("div", { class: "controls" }, fit, back),
      ...together.map((group) => fields("These can be combined. Changing one resets all settings outside this box", [group])),
      fields("Changing one of these resets all other settings", alone),
      more,
    );
    draw();
  }

  for (const name of ["linear", "robot", "printed"]) install(name, (host, data) => build(name, host, data));
})();
