// The page on what rests on what: show one result with all that it rests on, and keep the choice in the address.
"use strict";

(() => {
  const root = document.querySelector(".rhl-chain");
  if (!root) return;
  const nodes = [...root.querySelectorAll(".node")];
  const arrows = [...root.querySelectorAll(".arrow")];
  const rows = [...document.querySelectorAll(".chain-table tbody tr")];
  const name = new Map(rows.map((row) => [row.dataset.id, row.querySelector("td a").textContent]));
  const uses = new Map(
    rows.map((row) => [
      row.dataset.id,
      [...row.querySelectorAll("td:last-child a")].map((link) => link.hash.replace("#row-", "")),
    ]),
  );

  const below = (id, found = new Set()) => {
    if (!found.has(id)) {
      found.add(id);
      for (const used of uses.get(id) ?? []) below(used, found);
    }
    return found;
  };

  const select = document.createElement("select");
  const label = document.createElement("label");
  const status = document.createElement("p");
  select.id = "chain-of";
  label.htmlFor = select.id;
  label.textContent = "Show ";
  status.setAttribute("role", "status");
  select.add(new Option("everything", ""));
  for (const [id, used] of uses) if (used.length) select.add(new Option(`${name.get(id)} and what it rests on`, id));
  root.querySelector(".chain-choice").append(label, select, status);

  const show = () => {
    const id = select.value;
    const kept = id ? below(id) : new Set(uses.keys());
    for (const node of nodes) node.classList.toggle("away", !kept.has(node.dataset.id));
    for (const arrow of arrows) {
      arrow.classList.toggle("away", !kept.has(arrow.dataset.from) || !kept.has(arrow.dataset.to));
    }
    for (const row of rows) row.hidden = !kept.has(row.dataset.id);
    const failing = nodes.filter((node) => kept.has(node.dataset.id) && node.classList.contains("fails"));
    const names = failing.map((node) => name.get(node.dataset.id)).join(", ");
    status.textContent = id
      ? `${name.get(id)} rests on ${kept.size - 1} of the others. ${names ? `What fails: ${names}.` : "None of them fails."}`
      : `All ${uses.size} results. ${names ? `What fails: ${names}.` : ""}`;
    root.querySelector(`.node[data-id="${CSS.escape(id)}"]`)?.scrollIntoView({ block: "nearest", inline: "center" });
  };
  const read = () => {
    const asked = location.hash.match(/^#of=(.+)$/)?.[1] ?? ""; // ids of claims need no decoding
    // A link from row to row must find its row.
    if (!asked && location.hash && !location.hash.startsWith("#row-")) return;
    select.value = [...select.options].some((option) => option.value === asked) ? asked : "";
    show();
    if (location.hash.startsWith("#row-")) document.getElementById(location.hash.slice(1))?.scrollIntoView();
  };
  select.addEventListener("change", () => {
    history.replaceState(null, "", select.value ? `#of=${select.value}` : location.pathname);
    show();
  });
  addEventListener("hashchange", read);
  show();
  read();
})();
