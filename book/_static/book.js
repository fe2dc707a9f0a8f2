// What the book adds to its theme: wide parts can be scrolled with the keyboard and say so, tables become cards on a
// phone, and a link to a result shows its statement under the pointer.
"use strict";

(() => {
  // Parts that scroll sideways take the keyboard's focus, but only while they are wider than the page.
  const WIDE = "div.math, .output.text_latex, .output.text_html, table, pre, mjx-container[display], span.math, .chain-picture";
  const mark = (part) => {
    const scrolls = part.scrollWidth > part.clientWidth && ["auto", "scroll"].includes(getComputedStyle(part).overflowX);
    if (scrolls) {
      // What a reader would otherwise not see: that there is more, and the formula's number at its far end.
      part.dataset.scrolls ??= `${part.querySelector("[data-number]")?.dataset.number ?? ""} scroll →`.trim();
      // The attribute: a browser may call a part that scrolls focusable by itself, and the theme may have set -1 too early.
      if (part.getAttribute("tabindex") !== "0") {
        part.tabIndex = 0;
        part.dataset.reached = "";
      }
    } else if ("scrolls" in part.dataset) {
      // Not at once: while the side bars move, a part may fit for some frames only.
      setTimeout(() => {
        if (part.scrollWidth > part.clientWidth) return;
        if ("reached" in part.dataset) part.removeAttribute("tabindex");
        delete part.dataset.reached;
        delete part.dataset.scrolls;
      }, 400);
    }
  };

  // A table that is wider than a phone becomes a card for each row, whose cells say what they are. A long one scrolls,
  // since its rows are there to be compared.
  const LONG = 12;
  const narrow = matchMedia("(max-width: 36rem)");
  const lay = (table) => {
    if (table.closest(".stacked, .rhl-explore") || table.matches(".stacked, .overview")) return;
    table.classList.remove("cards");
    if (!narrow.matches || table.scrollWidth <= table.clientWidth) return;
    const heads = [...table.querySelectorAll("thead tr:last-child th")].map((head) => head.textContent.trim());
    if (!heads.length || table.tBodies[0].rows.length > LONG) return;
    for (const row of table.querySelectorAll("tbody tr")) {
      [...row.cells].forEach((cell, i) => (cell.dataset.head = heads[i] ?? ""));
    }
    table.classList.add("cards");
  };
  const markAll = () => {
    document.querySelectorAll("article table").forEach(lay);
    document.querySelectorAll(WIDE).forEach(mark);
  };

  // Statements under the pointer.
  const previews = new URL("statements.json", document.currentScript.src);
  const pages = new URL("..", document.currentScript.src);
  let statements = null;
  let card = null;
  let timer = null;

  const close = () => {
    clearTimeout(timer);
    card?.remove();
    card = null;
  };
  const soon = (action) => {
    clearTimeout(timer);
    timer = setTimeout(action, 250);
  };
  const open = async (link) => {
    const page = new URL(link.href);
    if (page.pathname === location.pathname && !page.hash.startsWith("#stated-")) return;
    statements ??= fetch(previews).then((answer) => answer.json()).catch(() => ({}));
    const statement = (await statements)[page.pathname.slice(pages.pathname.length)];
    if (!statement || (page.hash && !page.hash.startsWith("#stated-"))) return;
    close();
    card = document.createElement("div");
    card.className = "statement-card";
    card.setAttribute("role", "note");
    card.innerHTML = statement;
    document.body.append(card);
    await window.MathJax?.typesetPromise?.([card]);
    if (!card) return;
    const place = link.getBoundingClientRect();
    const left = Math.min(place.left, document.documentElement.clientWidth - card.offsetWidth - 8);
    const below = place.bottom + 6;
    const above = place.top - card.offsetHeight - 6;
    card.style.left = `${Math.max(8, left) + scrollX}px`;
    card.style.top = `${(below + card.offsetHeight > innerHeight && above > 0 ? above : below) + scrollY}px`;
    card.addEventListener("pointerenter", () => clearTimeout(timer));
    card.addEventListener("pointerleave", () => soon(close));
  };

  addEventListener("DOMContentLoaded", () => {
    for (const link of document.querySelectorAll(".bd-article a.internal")) {
      link.addEventListener("pointerenter", (event) => event.pointerType === "mouse" && soon(() => open(link)));
      link.addEventListener("pointerleave", () => soon(close));
      link.addEventListener("focus", () => link.matches(":focus-visible") && soon(() => open(link)));
      link.addEventListener("blur", () => soon(close));
    }
  });
  addEventListener("keydown", (event) => event.key === "Escape" && close());
  addEventListener("load", () => {
    const typeset = window.MathJax?.startup?.promise ?? Promise.resolve();
    typeset.then(() => {
      // Not the window's own event: the side bars go on moving for a while after it.
      new ResizeObserver(markAll).observe(document.querySelector("article") ?? document.body);
    });
  });
})();
