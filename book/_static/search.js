// The search page: results in an order that knows titles and phrases, each with a piece of its prose.
// Sphinx's own search tools come before this file, and begin after it.
"use strict";

(() => {
  const asked = (new URLSearchParams(location.search).get("q") ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  const phrase = asked.join(" ");
  const whole = new RegExp(`(^|[^\\p{L}\\p{N}])${RegExp.escape?.(phrase) ?? phrase.replace(/[^\p{L}\p{N} ]/gu, "\\$&")}` +
    "($|[^\\p{L}\\p{N}])", "giu");
  const times = (text) => (phrase ? [...text.matchAll(whole)].length : 0);
  const titled = (title) => title.toLowerCase().replace(/^(the|a|an) /, "").startsWith(phrase) && times(title) > 0;
  const textOf = (docname, anchor) => {
    const texts = rhlTexts[docname] ?? {};
    return anchor ? texts[anchor.slice(1)] ?? "" : Object.values(texts).join(" ");
  };
  // Pages that list everything hold every word; those that treat a thing come first.
  const LISTS = /^book\/(api|checks|ledger|artifact|api-claims)$/;

  Scorer.score = ([docname, title, anchor, description, score]) => {
    const section = title.split(" > ").at(-1);
    const better = score + 4 * Math.log2(1 + times(textOf(docname, anchor)));
    if (description) return better - 15;
    if (titled(section)) return better + (anchor ? 40 : 100);
    if (times(section)) return better + (anchor ? 10 : 30);
    return LISTS.test(docname) ? better - 20 : better;
  };

  // Snippets come from the texts at hand; Sphinx would fetch every page for them.
  DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;
  const piece = (text) => {
    const lower = text.toLowerCase();
    const exact = text.search(whole);
    const first = Math.min(...asked.map((word) => lower.indexOf(word)).filter((place) => place >= 0));
    const found = exact >= 0 ? exact : Number.isFinite(first) ? first : 0;
    const start = found < 120 ? 0 : text.lastIndexOf(" ", found - 80) + 1;
    const end = start + 240 < text.length ? text.lastIndexOf(" ", start + 240) : text.length;
    return `${start ? "… " : ""}${text.slice(start, end)}${end < text.length ? " …" : ""}`;
  };
  const explain = (item) => {
    const link = item.querySelector("a");
    if (!link || item.querySelector(".context, span")) return;
    const [page, anchor] = link.getAttribute("href").split("#");
    const text = textOf(page.replace(/\.html$/, ""), anchor && `#${anchor}`);
    if (!text) return;
    const shown = document.createElement("p");
    shown.className = "context";
    shown.textContent = piece(text);
    item.append(shown);
  };
  new MutationObserver((changes) => {
    for (const change of changes) for (const node of change.addedNodes) if (node.nodeName === "LI") explain(node);
  }).observe(document.getElementById("search-results"), { childList: true, subtree: true });
})();
