// The ledger: show only the claims with a word or a status, and open the card that an address names.
"use strict";

(() => {
  const root = document.querySelector(".rhl-filter");
  if (!root) return;
  const cards = [...document.querySelectorAll(".claims .claim")];
  const texts = new Map(cards.map((card) => [card, `${card.textContent} ${card.dataset.words}`.toLowerCase()]));
  const results = new Set(cards.map((card) => card.closest("section:not(.claim)")));
  const statuses = [...new Set(cards.map((card) => card.dataset.status))];

  const labelled = (id, words, control) => {
    const label = document.createElement("label");
    label.htmlFor = control.id = id;
    label.textContent = words;
    root.append(label, control);
    return control;
  };
  const word = labelled("ledger-word", "Words", document.createElement("input"));
  word.type = "search";
  const select = labelled("ledger-status", "Status", document.createElement("select"));
  select.add(new Option("any", ""));
  for (const status of statuses) select.add(new Option(status, status));
  const counted = document.createElement("p");
  counted.setAttribute("role", "status");
  root.append(counted);
  root.hidden = false;

  const show = () => {
    const words = word.value.toLowerCase().split(/\s+/).filter(Boolean);
    let left = 0;
    for (const card of cards) {
      const fits = (!select.value || card.dataset.status === select.value) &&
        words.every((one) => texts.get(card).includes(one));
      card.hidden = !fits;
      left += fits;
    }
    for (const result of results) result.hidden = !result.querySelector(".claim:not([hidden])");
    counted.textContent = `${left} of ${cards.length} claims are shown below.`;
  };
  const reach = () => {
    const card = document.getElementById(location.hash.slice(1)); // ids of claims need no decoding
    if (!card?.classList.contains("claim")) return;
    if (card.hidden) {
      word.value = select.value = "";
      show();
    }
    card.querySelector("details").open = true;
    card.scrollIntoView();
  };
  word.addEventListener("input", show);
  select.addEventListener("change", show);
  addEventListener("hashchange", reach);
  show();
  reach();
})();
