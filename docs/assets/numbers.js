// Keeps on one line: 14 553, 15 %, 2.5 mT, 2e-7, Table 3-8, and options of commands such as --set.
const spaces = /(?<=\d) (?=\d{3}(?!\d)|(?:%|[kmµnu]?(?:[msATVNgBHW]|Hz))(?![\w/]))/g;
const hyphens = /\d[\d.]*e?-\d+|(?<![\w-])--?[a-z][\w-]*/gi;

document.addEventListener("DOMContentLoaded", () => {
  for (const block of document.querySelectorAll(".md-typeset :is(td, p, li)")) {
    for (const text of textsOf(block)) {
      text.data = text.data.replace(spaces, "\u00a0");
      for (const found of [...text.data.matchAll(hyphens)].reverse()) {
        keepTogether(text.splitText(found.index), found[0].length);
      }
    }
  }
});

// The texts of a block that are neither listings nor formulas.
function textsOf(block) {
  const walker = document.createTreeWalker(block, NodeFilter.SHOW_TEXT);
  const found = [];
  while (walker.nextNode()) {
    if (!walker.currentNode.parentElement.closest("pre, .arithmatex, .unbroken")) found.push(walker.currentNode);
  }
  return found;
}

function keepTogether(text, length) {
  text.splitText(length);
  const span = document.createElement("span");
  span.className = "unbroken";
  text.replaceWith(span);
  span.append(text);
}
