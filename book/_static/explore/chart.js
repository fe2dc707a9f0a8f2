/* What the explorers share: data loaded when they are needed, charts drawn as SVG, labelled sliders.

   Classic scripts, not modules, and data in scripts, not fetched: so it works from a folder without a server too. */
"use strict";

const rhlExplore = (() => {
  const SVG = "http://www.w3.org/2000/svg";
  const DATA = new URL("data/", document.currentScript.src);
  const FLOOR = 1e-16; // what is smaller is rounding, and is drawn here on a logarithmic axis
  const wanted = new Map();

  /* ---- data */

  function load(name) {
    if (!wanted.has(name)) {
      const entry = {};
      entry.promise = new Promise((resolve, reject) => {
        entry.resolve = resolve;
        const script = document.createElement("script");
        script.src = new URL(`${name}.js`, DATA);
        script.onerror = () => {
          wanted.delete(name); // so that the next move of a slider tries again
          reject(new Error(`${name}.js could not be loaded`));
        };
        document.head.append(script);
      });
      wanted.set(name, entry);
    }
    return wanted.get(name).promise;
  }

  function take(name, data) {
    wanted.get(name)?.resolve(data);
  }

  /* ---- numbers as text */

  const raised = (n) => String(n).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻");

  function short(value) {
    if (value === null || value === undefined) return "–";
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size >= 0.001 && size < 1e4) return String(Number(value.toPrecision(3))).replace("-", "−");
    const [digits, power] = value.toExponential(2).split("e");
    const front = Number(digits);
    return `${front === 1 ? "" : front === -1 ? "−" : `${String(front).replace("-", "−")}·`}10${raised(Number(power))}`;
  }

  const power = (value) => (value >= 0.1 && value <= 100 ? String(value) : `10${raised(Math.round(Math.log10(value)))}`);

  /* ---- elements */

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function shape(name, attributes, parent, text) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parent.append(made);
    return made;
  }

  let made = 0;

  /* A slider over the places 0 ... count-1; `say(place)` is its value in words, `move(place)` is called on each move. */
  function slider({ words, symbol, count, place, say, move }) {
    const id = `rhl-slider-${(made += 1)}`;
    const input = element("input", { type: "range", id, min: 0, max: count - 1, step: 1, value: place });
    const output = element("output", { for: id });
    const sign = element("i", {}, symbol);
    const show = () => {
      const said = say(Number(input.value));
      output.textContent = said;
      input.setAttribute("aria-valuetext", `${symbol} = ${said}`);
    };
    input.addEventListener("input", () => {
      show();
      move(Number(input.value));
    });
    show();
    const row = element("div", { class: "slider" }, element("label", { for: id }, `${words} `, sign), output, input);
    const set = (value) => {
      input.value = value;
      show();
    };
    return { row, input, set, show, get place() { return Number(input.value); } };
  }

  /* A line of text that changes at once, and is read out when the sliders rest; never while `quiet`. */
  function status() {
    const line = element("p", { role: "status", "aria-live": "off", class: "status" });
    let timer;
    line.say = (text) => {
      clearTimeout(timer);
      line.setAttribute("aria-live", "off");
      line.textContent = text;
      timer = setTimeout(() => {
        if (line.quiet) return;
        line.setAttribute("aria-live", "polite");
        line.replaceChildren(text); // it is a change that is read out
      }, 400);
    };
    return line;
  }

  /* ---- axes */

  function decades(low, high) {
    const first = Math.floor(Math.log10(low));
    const last = Math.max(Math.ceil(Math.log10(high)), first + 1);
    const every = Math.max(1, Math.ceil((last - first) / 4));
    const ticks = [];
    for (let power = last; power >= first; power -= every) ticks.push(10 ** power);
    return { low: 10 ** first, high: 10 ** last, ticks };
  }

  function even(low, high, parts) {
    const rough = (high - low) / parts;
    const unit = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * unit).find((width) => width >= rough * 0.999);
    const [first, last] = [Math.floor(low / step + 1e-9), Math.ceil(high / step - 1e-9)];
    const ticks = [];
    for (let i = first; i <= last; i += 1) ticks.push(Number((i * step).toPrecision(12)));
    return { low: first * step, high: last * step, ticks };
  }

  function powers(low, high) {
    const top = Math.ceil(Math.log10(Math.max(-low, high)));
    const every = Math.max(1, Math.ceil(top / 2));
    const ticks = [0];
    for (let power = every; power <= top; power += every) {
      if (high > 0) ticks.push(10 ** power);
      if (low < 0) ticks.unshift(-(10 ** power));
    }
    return { low: low < 0 ? -(10 ** top) : 0, high: high > 0 ? 10 ** top : 0, ticks };
  }

  const bend = {
    even: (v) => v,
    log: (v) => Math.log10(Math.max(v, FLOOR)),
    signed: (v) => Math.sign(v) * Math.log10(1 + Math.abs(v)),
  };
  const unbend = {
    even: (v) => v,
    log: (v) => 10 ** v,
    signed: (v) => Math.sign(v) * (10 ** Math.abs(v) - 1),
  };

  /* The vertical axis that holds all values: logarithmic where asked for, and signed-logarithmic where they explode. */
  function axis(values, log, floor = FLOOR) {
    const finite = values.filter((v) => v !== null && v !== undefined && Number.isFinite(v));
    if (log) {
      const positive = finite.map((v) => Math.max(v, floor));
      return { kind: "log", ...decades(Math.min(...positive), Math.max(...positive)) };
    }
    const [low, high] = [Math.min(0, ...finite), Math.max(0, ...finite)];
    if (Math.max(-low, high) > 1e6) return { kind: "signed", ...powers(low, high) };
    return { kind: "even", ...even(low, low === high ? low + 1 : high, 3) };
  }

  /* ---- a chart: a title, two axes, and layers of curves */

  const FAR = 1e5; // pixels: what is farther outside of the picture need not be drawn where it is

  class Chart {
    /* `hold`: the vertical axis stays as it was first drawn until `refit` is called; `frame`: values it has to hold;
       `floor`: what is smaller is left out of a logarithmic axis. */
    constructor({ title, log = false, across, height = 170, frame = [], hold = false, floor = FLOOR }) {
      Object.assign(this, { title, log, across, height, frame, hold, floor, layers: [], mark: null, band: null, held: null });
      this.legend = element("span", { class: "legend" });
      this.readout = element("span", { class: "legend readout", "aria-hidden": "true", hidden: "" });
      this.figure = element("figure", {},
        element("figcaption", {}, element("b", {}, title), " ", this.legend, this.readout));
      this.canvas = element("div", { class: "canvas" });
      this.figure.append(this.canvas);
      this.canvas.addEventListener("pointermove", (event) => this.read(event));
      this.canvas.addEventListener("pointerleave", () => this.read(null));
      new ResizeObserver(() => this.paint()).observe(this.canvas);
    }

    /* layers: {x, y, kind: "steps" | "line" | "dots", colour: 1 ... 4, label}, and if wished `look`, one more class;
       mark: {x, text} is a vertical line; band: {from, to} is shaded. */
    draw(layers, mark = null, band = null) {
      Object.assign(this, { layers, mark, band });
      const seen = new Set();
      this.legend.replaceChildren(
        ...layers.filter(({ label }) => label && !seen.has(label) && seen.add(label)).map((layer) =>
          element("span", { class: `key ${layer.kind} c${layer.colour} ${layer.look ?? ""}` }, layer.label)));
      this.paint();
    }

    /* Give the vertical axis the values that it has to hold, once and for all. */
    fix(values) {
      this.held = axis(values, this.log);
    }

    refit() {
      this.held = null;
      this.paint();
    }

    /* The vertical axis. What is only there for comparison, the run before, does not decide it. */
    scale() {
      if (this.held) return this.held;
      const values = this.layers.filter(({ look }) => look !== "ghost").flatMap((layer) => layer.y);
      const up = axis(values.concat(this.frame), this.log, this.floor);
      if (this.hold) this.held = up;
      return up;
    }

    /* Whether a curve leaves the axes. */
    get beyond() {
      if (!this.held) return false;
      const { low, high } = this.held;
      return this.layers.some(({ y, look }) =>
        look !== "ghost" && y.some((v) => v !== null && (v > high || (v < low && !(this.log && low <= this.floor)))));
    }

    paint() {
      const width = this.canvas.clientWidth;
      if (!width || !this.layers.length) return;
      const height = width < 260 ? this.height * 0.62 : this.height;
      const [left, right, top, bottom] = [46, width - 8, 8, height - 30];
      const up = this.scale();
      const bent = bend[up.kind];
      const [low, high] = [bent(up.low), bent(up.high)];
      const { from, to, name } = this.across;
      const X = (v) => left + ((v - from) / (to - from)) * (right - left);
      const Y = (v) => Math.min(Math.max(bottom - ((bent(v) - low) / (high - low)) * (bottom - top), -FAR), FAR);

      const view = { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": this.describe(), "data-axis": up.kind };
      const svg = shape("svg", view, element("div"));
      if (this.band) {
        const { from: first, to: last } = this.band;
        shape("rect", { class: "band", x: X(first), y: top, width: X(last) - X(first), height: bottom - top }, svg);
      }
      for (const tick of up.ticks) {
        shape("line", { class: "grid", x1: left, x2: right, y1: Y(tick), y2: Y(tick) }, svg);
        const text = up.kind === "log" ? power(tick) : short(tick);
        shape("text", { class: "tick up", x: left - 5, y: Y(tick) + 4, "data-value": tick }, svg, text);
      }
      for (const tick of even(from, to, width < 260 ? 3 : 5).ticks.filter((v) => v >= from && v <= to)) {
        shape("line", { class: "grid", x1: X(tick), x2: X(tick), y1: top, y2: bottom }, svg);
        shape("text", { class: "tick along", x: X(tick), y: bottom + 13, "data-value": tick }, svg, short(tick));
      }
      shape("text", { class: "name", x: right, y: height - 3 }, svg, name);
      // A picture in the picture cuts off what leaves the axes; its coordinates are those around it.
      const [x, y, w, h] = [left - 4, top - 4, right - left + 8, bottom - top + 8];
      const inner = shape("svg", { class: "plot", x, y, width: w, height: h, viewBox: `${x} ${y} ${w} ${h}` }, svg);
      for (const layer of this.layers) this.curve(inner, layer, X, Y);
      if (this.mark) {
        const at = X(this.mark.x);
        const end = at > (left + right) / 2;
        shape("line", { class: "mark", x1: at, x2: at, y1: top, y2: bottom }, svg);
        shape("text", { class: end ? "note end" : "note", x: at + (end ? -4 : 4), y: top + 11 }, svg, this.mark.text);
      }
      this.hair = shape("line", { class: "hair", y1: top, y2: bottom, visibility: "hidden" }, svg);
      this.spot = { X, left, right };
      this.canvas.replaceChildren(svg);
      /* Which point of the chart a pointer is at, kept inside of the axes. */
      this.where = ({ clientX, clientY }) => {
        const box = svg.getBoundingClientRect();
        const within = (share) => Math.min(Math.max(share, 0), 1);
        const along = within(((clientX - box.left) * (width / box.width) - left) / (right - left));
        const upward = within((bottom - (clientY - box.top) * (height / box.height)) / (bottom - top));
        return { x: from + along * (to - from), y: unbend[up.kind](low + upward * (high - low)) };
      };
    }

    /* Show the values under the pointer in place of the legend. */
    read(event) {
      if (!this.hair) return;
      const layers = this.layers.filter(({ label }) => label);
      const along = event && this.spot ? this.along(event) : null;
      this.legend.hidden = along !== null;
      this.readout.hidden = along === null;
      this.hair.setAttribute("visibility", along === null ? "hidden" : "visible");
      if (along === null) return;
      for (const end of ["x1", "x2"]) this.hair.setAttribute(end, this.spot.X(along));
      const values = layers.map(({ x, y, label }) => [label, y[x.indexOf(along)]])
        .filter(([, value]) => value !== undefined && value !== null)
        .map(([label, value]) => `${label}: ${short(value)}`);
      this.readout.textContent = [`${this.across.name.replace("step ", "")} = ${short(along)}`, ...values].join("   ");
    }

    /* The place on the horizontal axis, of those where there is a value, that is next to the pointer. */
    along(event) {
      const { X } = this.spot;
      const at = event.clientX - this.canvas.getBoundingClientRect().left;
      const places = this.layers.filter(({ label }) => label).flatMap(({ x, y }) => x.filter((_, i) => (y[i] ?? null) !== null));
      if (!places.length) return null;
      return places.reduce((best, place) => (Math.abs(X(place) - at) < Math.abs(X(best) - at) ? place : best));
    }

    curve(svg, { x, y, kind, colour, look = "", size = 2.6 }, X, Y) {
      const seen = x.map((at, i) => [at, y[i]]).filter(([, value]) => value !== null && value !== undefined);
      if (kind === "dots") {
        const group = shape("g", { class: `dots c${colour} ${look}` }, svg);
        for (const [at, value] of seen) {
          shape("circle", { cx: X(at).toFixed(2), cy: Y(value).toFixed(2), r: size }, group);
        }
        return;
      }
      let path = "";
      let gap = true;
      x.forEach((at, i) => {
        if (y[i] === null || y[i] === undefined) { gap = true; return; }
        const [a, b] = [X(at).toFixed(2), Y(y[i]).toFixed(2)];
        path += gap ? `M${a} ${b}` : kind === "steps" ? `H${a}V${b}` : `L${a} ${b}`;
        gap = false;
      });
      shape("path", { class: look === "ghost" ? "ghost" : `curve c${colour} ${look}`.trim(), d: path }, svg);
    }

    describe() {
      const parts = this.layers.filter(({ kind, look }) => kind !== "dots" && !look).map(({ y, label }) => {
        const known = y.filter((value) => value !== null && value !== undefined);
        return known.length ? `${label ?? ""} from ${short(Math.min(...known))} to ${short(Math.max(...known))}` : "";
      });
      return `${this.title} over ${this.across.name}: ${parts.filter(Boolean).join(", ")}`;
    }
  }

  /* Put the explorer where the static picture is, once it can be used; until then, and if it cannot, the picture stays. */
  function install(name, build, file = name) {
    const host = document.querySelector(`[data-explore="${name}"]`);
    if (!host) return;
    load(file)
      .then((data) => {
        build(host, data);
        host.hidden = false;
        document.querySelector(`.tag_explore-${name}, .still-${name}`)?.classList.add("explored");
        host.dispatchEvent(new Event("ready"));
      })
      .catch((error) => {
        host.hidden = false;
        host.replaceChildren(element("p", { role: "status" }, `The sliders cannot be shown: ${error.message}.`));
      });
  }

  return { load, take, short, element, shape, slider, status, Chart, install };
})();
