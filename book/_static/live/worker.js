/* The interpreter, beside the page's own thread: loads Pyodide and rhl's files once, then takes a run step by step.

   It gets {start: settings} or {stop: true}. It answers {ready}, {read}, {steps}, {ended}, {refused}, {stopped} or {broken}. */

const HERE = new URL(".", import.meta.url);
const SHARE = 60; // milliseconds of steps between two looks at what the page has sent

let asked = 0;
let booted = null;

const PATIENCE = 120; // seconds for the interpreter to start

/* Pyodide never settles where this file is missing or cut short, so it is looked at first. */
async function checkBinary(bytes) {
  const name = "engine/pyodide.asm.wasm";
  const answer = await fetch(new URL(name, HERE), { method: "HEAD" });
  if (!answer.ok) throw new Error(`${name} could not be loaded`);
  const length = answer.headers.get("Content-Encoding") ? null : answer.headers.get("Content-Length");
  if (length !== null && Number(length) !== bytes) {
    throw new Error(`${name} must have ${bytes} bytes, got ${length}`);
  }
}

async function boot(binary) {
  const began = performance.now();
  await checkBinary(binary);
  const { loadPyodide } = await import(new URL("engine/pyodide.mjs", HERE));
  const late = new Promise((_, reject) => {
    setTimeout(() => reject(new Error(`the interpreter did not start within ${PATIENCE} s`)), 1000 * PATIENCE);
  });
  const python = await Promise.race([loadPyodide({ indexURL: new URL("engine/", HERE).href }), late]);
  const library = await fetch(new URL("library.zip", HERE));
  if (!library.ok) throw new Error("library.zip could not be loaded");
  python.FS.writeFile("/library.zip", new Uint8Array(await library.arrayBuffer()));
  python.runPython("import sys; sys.path.insert(0, '/library.zip')");
  const driver = python.pyimport("driver");
  const bytes = performance.getEntriesByType("resource").reduce((sum, entry) => sum + entry.decodedBodySize, 0);
  postMessage({ ready: { bytes, seconds: (performance.now() - began) / 1000 } });
  return { python, driver };
}

const plain = (proxy) => {
  const found = proxy.toJs({ dict_converter: Object.fromEntries });
  proxy.destroy();
  return found;
};

async function run(settings, mine, binary) {
  booted ??= boot(binary).catch((error) => {
    booted = null; // so that the next run tries again
    throw error;
  });
  const { python, driver } = await booted;
  if (mine !== asked) return;
  const began = performance.now();
  const given = python.toPy(settings);
  const begun = driver.start(given);
  given.destroy();
  const [taken, sentence] = [begun.get(0), begun.get(1)];
  begun.destroy();
  if (sentence) {
    postMessage({ refused: sentence, mine });
    return;
  }
  const size = taken.size;
  postMessage({ read: { steps: taken.steps, at: taken.at, size: size.toJs() }, mine });
  size.destroy();
  for (let left = true, reason = ""; left; ) {
    const steps = [];
    const until = performance.now() + SHARE;
    while (left && performance.now() < until) {
      const [row, ended] = plain(driver.advance(taken));
      if (row) steps.push(row);
      reason = ended;
      left = Boolean(row) && !ended;
    }
    postMessage({ steps, mine });
    if (!left) postMessage({ ended: reason, seconds: (performance.now() - began) / 1000, mine });
    await new Promise((done) => { setTimeout(done); }); // messages of the page come in here
    if (mine !== asked) break;
  }
  taken.destroy();
}

onmessage = ({ data }) => {
  asked = data.mine;
  if (data.start) {
    run(data.start, data.mine, data.binary).catch((error) => {
      const lines = String(error.message ?? error).trim().split("\n");
      postMessage({ broken: lines.at(-1), mine: data.mine });
    });
  }
};
