/* The page on which a reader runs the scheme: fields, four charts, and a worker that is begun when a run is asked for. */
"use strict";

(() => {
  const { short, element, status, Chart } = rhlExplore;
  const HERE = new URL(".", document.currentScript.src);

  const GROUPS = [
    ["The plant: z(k+1) = F z(k) + G v(k), y(k) = H z(k)", [
      { key: "F", words: "state matrix", symbol: "F", area: true },
      { key: "G", words: "input matrix", symbol: "G", area: true },
      { key: "H", words: "output matrix", symbol: "H", area: true },
      { key: "z0", words: "initial state", symbol: "z(0)", area: true },
    ]],
    ["The scheme", [
      { key: "m", words: "past outputs and inputs that are stacked", symbol: "m" },
      { key: "window", words: "transitions that the estimator fits", symbol: "N̄" },
      { key: "rho", words: "weight of the distance to the last model", symbol: "ρ" },
      { key: "lambda", words: "share of the last model that is mixed in", symbol: "λ" },
      { key: "N", words: "horizon", symbol: "N" },
      { key: "Q", words: "weight of the state", symbol: "Q" },
      { key: "R", words: "weight of the input", symbol: "R" },
      { key: "QN", words: "weight of the terminal state", symbol: "Q", below: "N" },
      { key: "eta", words: "rate of the terminal weight, ε(k) = 1/(1 + ηk)", symbol: "η" },
      { key: "delay", words: "model that the controller uses, 0: of this step, 1: of the step before", symbol: "d" },
    ]],
    ["The run", [
      { key: "steps", words: "number of steps", symbol: "K" },
      { key: "push_step", words: "step at which the plant's input is disturbed", symbol: "k" },
      { key: "push_size", words: "what is added to the input there, a number for each input or one for all", symbol: "Δv" },
    ]],
  ];
  /* What the library calls a field in its sentences, where that is not the field's own name. */
  const CALLED = {
    outputs: "m", horizon: "N", rate: "eta", lam: "lambda", weight: "rho", model_delay: "delay",
    "the step of the disturbance": "push_step", "the size of the disturbance": "push_size",
  };

  const whyNot = (build) => {
    if (location.protocol === "file:") {
      return "This page was opened from a folder, from which a browser lets no page start an interpreter. " +
        "Serve the folder, for instance with “make serve”, and open the page from there.";
    }
    if (!build?.engine) return "This build of the book holds no engine, so nothing can be run on this page.";
    if (typeof WebAssembly !== "object" || typeof Worker !== "function") {
      return "This browser has no WebAssembly or no workers, which the page needs to run Python.";
    }
    return "";
  };

  const megabytes = (bytes) => `${(bytes / 1e6).toFixed(1)} MB`;
  const lines = (text) => text.split(";").map((row) => row.trim()).join("\n");
  const inline = (text) => text.split(/[;\n]/).map((row) => row.trim()).filter(Boolean).join("; ");

  function install(host, build) {
    const impossible = whyNot(build);
    host.hidden = false;
    if (impossible) {
      const sweeps = element("a", { href: "explore.html" }, "page to explore");
      host.replaceChildren(element("p", { role: "status", class: "status" },
        `${impossible} The `, sweeps, " shows runs that were computed beforehand."));
      return;
    }
    page(host, build);
  }

  function page(host, build) {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const inputs = {};
    let preset = build.presets[0];
    let worker = null;
    let loaded = null; // what loading the engine came to
    let asked = 0;
    let shown = null; // the run that is drawn: its settings, its steps, whether it goes on
    let dragged = null; // a disturbance that is being dragged

    /* ---- fields */

    function field({ key, words, symbol, below, area }) {
      const id = `rhl-live-${key}`;
      const input = element(area ? "textarea" : "input",
        { id, spellcheck: "false", autocomplete: "off", ...(area ? { rows: 3 } : { type: "text" }) });
      input.addEventListener("keydown", (event) => {
        if (event.key === "Enter" && (!area || event.ctrlKey)) start();
      });
      inputs[key] = input;
      return element("div", { class: area ? "field area" : "field" },
        element("label", { for: id }, `${words} `, element("i", {}, symbol, ...(below ? [element("sub", {}, below)] : []))),
        input);
    }

    const settings = () => Object.fromEntries(Object.entries(inputs).map(([key, input]) => [key, inline(input.value)]));

    function fill(fields) {
      for (const [key, input] of Object.entries(inputs)) {
        input.value = input.rows ? lines(fields[key]) : fields[key];
        input.removeAttribute("aria-invalid");
      }
    }

    /* ---- a run's settings in the address */

    function toAddress(chosen) {
      const changed = Object.entries(chosen).filter(([key, value]) => value !== preset.fields[key]);
      history.replaceState(null, "", `#${new URLSearchParams([["plant", preset.name], ...changed])}`);
    }

    function fromAddress() {
      const given = new URLSearchParams(location.hash.slice(1));
      const found = build.presets.find(({ name }) => name === given.get("plant"));
      if (!found) return false;
      preset = found;
      picked.value = found.name;
      fill({ ...found.fields, ...Object.fromEntries([...given].filter(([key]) => key in found.fields)) });
      return true;
    }

    /* ---- the worker */

    function engine() {
      if (worker) return worker;
      worker = new Worker(new URL("worker.js", HERE), { type: "module" });
      worker.onmessage = ({ data }) => hear(data);
      worker.onerror = (event) => {
        event.preventDefault();
        hear({ mine: asked, broken: event.message || "its files could not be loaded" });
      };
      return worker;
    }

    function start() {
      const chosen = settings();
      toAddress(chosen);
      Object.values(inputs).forEach((input) => input.removeAttribute("aria-invalid"));
      asked += 1;
      engine().postMessage({ start: chosen, mine: asked, binary: build.binary });
      shown = { steps: [], going: true, read: { steps: 0, at: 0, size: [] } };
      busy(true);
      line.say(loaded ? "Running …" : `Loading the interpreter, ${megabytes(build.bytes)}, from this book's own folder …`);
    }

    function stop() {
      if (!shown?.going) return;
      asked += 1;
      if (loaded) worker.postMessage({ stop: true, mine: asked });
      else {
        worker.terminate(); // what loads cannot listen
        worker = null;
      }
      shown.going = false;
      busy(false);
      if (shown.steps.length) draw();
      line.say(`Stopped after ${shown.steps.length} of ${shown.read.steps || "all"} steps.`);
    }

    function hear(data) {
      if (data.ready) {
        loaded = data.ready;
        host.dataset.bytes = loaded.bytes;
        host.dataset.loading = loaded.seconds;
        return;
      }
      if (data.mine !== asked) return;
      if (data.read) {
        shown.read = data.read;
        line.say("Running …");
        return;
      }
      if (data.steps) {
        shown.steps.push(...data.steps);
        if (!still) draw();
        Object.assign(progress, { max: shown.read.steps, value: shown.steps.length });
        return;
      }
      shown.going = false;
      busy(false);
      if (data.refused) refuse(data.refused);
      else if (data.broken) {
        worker?.terminate(); // so that the next run begins from nothing
        [worker, loaded] = [null, null];
        line.say(`The run could not be made: ${data.broken}.`);
      } else {
        host.dataset.seconds = data.seconds;
        if (shown.steps.length) draw();
        line.say(summary(data));
      }
      host.dispatchEvent(new CustomEvent("settled", { detail: data }));
    }

    function refuse(sentence) {
      const name = Object.keys({ ...CALLED, ...inputs }).sort((a, b) => b.length - a.length)
        .find((start) => sentence.startsWith(`${start} `));
      const input = inputs[CALLED[name] ?? name];
      input?.setAttribute("aria-invalid", "true");
      input?.focus();
      line.say(`rhl refuses this: ${sentence}.`);
    }

    function summary({ ended, seconds }) {
      const { steps } = shown;
      const took = `${steps.length} steps in ${seconds.toFixed(1)} s.`;
      if (!steps.length) return `${ended}.`;
      const sizes = steps.map(({ y }) => Math.max(...y.map(Math.abs)));
      const peak = Math.max(...sizes);
      const pushed = push();
      const late = pushed.size.some(Boolean) && pushed.k >= shown.read.steps;
      const margins = steps.map(({ augmented }) => augmented).filter(Number.isFinite);
      const least = margins.length ? `; the augmented pair's smallest margin is ${short(Math.min(...margins))}` : "";
      return `${took} The output is at most ${short(peak)} in size, at k = ${sizes.indexOf(peak)}, and ` +
        `${short(sizes.at(-1))} at the end${least}.` +
        (late ? ` The disturbance at k = ${pushed.k} comes after the last step.` : "") +
        (ended ? ` Then ${ended}.` : "");
    }

    function busy(is) {
      if (!is && document.activeElement === halt) run.focus(); // what is disabled loses the focus
      halt.disabled = !is;
      progress.hidden = !is;
      if (is) progress.removeAttribute("value");
    }

    /* ---- charts */

    const across = { from: 0, to: 59, name: "step k" };
    const make = (title, log = false) => new Chart({ title, log, across });
    const charts = {
      y: make("output y"),
      v: make("input v"),
      weight: make("terminal weight Γ(x)/ε(k)", true),
      margin: make("controllability margin", true),
    };

    // As the driver has read it, or as it is being dragged.
    const push = () => dragged ?? { k: shown.read.at, size: shown.read.size };
    const mark = () => {
      const { k, size } = push();
      return size.some(Boolean) && k <= across.to ? { x: k, text: `Δv = ${size.map(short).join(", ")}, k = ${k}` } : null;
    };

    function signals(name) {
      const { steps } = shown;
      const k = steps.map((_, i) => i);
      const first = steps[0]?.[name] ?? []; // a run can fail before its first step
      const several = first.length > 1;
      return first.map((_, i) => ({
        x: k,
        y: steps.map((step) => step[name][i]),
        kind: "steps",
        colour: (i % 4) + 1,
        label: several ? `${name}${"₁₂₃₄₅₆₇₈₉"[i] ?? i + 1}` : name,
      }));
    }

    function draw() {
      const { steps } = shown;
      across.to = Math.max(shown.read.steps - 1, 1);
      const k = steps.map((_, i) => i);
      const curve = (key, label, colour = 1) =>
        ({ x: k, y: steps.map((step) => (Number.isFinite(step[key]) ? step[key] : null)), kind: "steps", colour, label });
      charts.y.draw(signals("y"), mark());
      const pushed = push();
      const at = steps[pushed.k];
      const dots = at ? pushed.size.flatMap((size, i) => (size
        ? [{ x: [pushed.k], y: [at.v[i] + size], kind: "dots", colour: 2, label: "what the plant gets" }] : [])) : [];
      charts.v.draw([...signals("v"), ...dots], mark());
      charts.weight.draw([curve("weight", "")]);
      charts.margin.draw([curve("augmented", "augmented pair"), curve("lifted", "lifted pair", 2)]);
      host.querySelector(".charts").hidden = false;
      document.querySelector(".tag_live-picture")?.classList.add("explored");
      table();
    }

    /* A disturbance is dragged into the first input: where it is let go, there the plant's input is at that step. */
    function pull(event) {
      const { x, y } = charts.v.where(event);
      const k = Math.min(Math.round(x), shown.steps.length - 1);
      const size = Number((y - shown.steps[k].v[0]).toPrecision(3));
      dragged = { k, size: shown.steps[k].v.map((_, i) => (i ? 0 : size)) };
      draw();
    }

    function letDrag({ canvas }) {
      let held = null; // where the pointer went down; a drag begins some pixels away from there
      canvas.classList.add("drag");
      canvas.addEventListener("pointerdown", (event) => {
        // A finger scrolls the page.
        if (!shown?.steps.length || shown.going || event.button || event.pointerType === "touch") return;
        event.preventDefault(); // no text is selected on the way
        canvas.setPointerCapture(event.pointerId);
        held = event;
      });
      canvas.addEventListener("pointermove", (event) => {
        if (held && (dragged || Math.hypot(event.clientX - held.clientX, event.clientY - held.clientY) > 4)) pull(event);
      });
      canvas.addEventListener("pointerup", () => {
        held = null;
        if (!dragged) return;
        inputs.push_step.value = String(dragged.k);
        inputs.push_size.value = dragged.size.join(" ");
        dragged = null;
        start();
      });
      canvas.addEventListener("pointercancel", () => {
        held = null;
        if (!dragged) return;
        dragged = null;
        draw();
      });
    }

    /* ---- the numbers of the run */

    const numbers = element("table", { class: "dataframe" });
    const more = element("details", {}, element("summary", {}, "The numbers of this run"),
      element("div", { class: "numbers", tabindex: "0", role: "region", "aria-label": "The numbers of this run" }, numbers));

    function table() {
      if (!more.open || !shown?.steps.length) return;
      const cell = (name, scope, text) => element(name, scope ? { scope } : {}, text);
      const columns = Object.entries(shown.steps[0]).flatMap(([key, value]) =>
        (Array.isArray(value) ? value.map((_, i) => [`${key}${i + 1}`, (step) => step[key][i]]) : [[key, (step) => step[key]]]));
      numbers.replaceChildren(
        element("thead", {}, element("tr", {}, ...["k", ...columns.map(([name]) => name)].map((text) => cell("th", "col", text)))),
        element("tbody", {}, ...shown.steps.map((step, k) => element("tr", {}, cell("th", "row", String(k)),
          ...columns.map(([, of]) => cell("td", null, String(of(step))))))),
      );
    }
    more.addEventListener("toggle", table);

    /* ---- put together */

    const picked = element("select", { id: "rhl-live-plant" },
      ...build.presets.map(({ name, title }) => element("option", { value: name }, `${name}: ${title}`)));
    const back = element("button", { type: "button" }, "Back to this plant's settings");
    const run = element("button", { type: "button", class: "run" }, "Run");
    const halt = element("button", { type: "button" }, "Stop");
    const progress = element("progress", { "aria-label": "steps taken" });
    const line = status();
    line.textContent = `Nothing is loaded yet. The first run loads ${megabytes(build.bytes)} from this book's own folder.`;

    picked.addEventListener("change", () => {
      preset = build.presets.find(({ name }) => name === picked.value);
      fill(preset.fields);
    });
    back.addEventListener("click", () => fill(preset.fields));
    run.addEventListener("click", start);
    halt.addEventListener("click", stop);
    addEventListener("hashchange", fromAddress);
    letDrag(charts.v);

    const drawn = element("div", { class: "charts" }, ...Object.values(charts).map(({ figure }) => figure));
    drawn.hidden = true;
    const pick = element("div", { class: "field pick" }, element("label", { for: picked.id }, "plant to begin with"), picked);
    const sets = GROUPS.map(([legend, fields]) =>
      element("fieldset", {}, element("legend", {}, legend), ...fields.map(field)));
    host.replaceChildren(pick, element("div", { class: "buttons" }, run, halt, back), progress, line, drawn, ...sets, more);
    busy(false);
    fill(preset.fields);
    fromAddress();
    host.dispatchEvent(new Event("ready"));
  }

  const host = document.querySelector("[data-live]");
  if (host) install(host, window.rhlLive);
})();
