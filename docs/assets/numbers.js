// Keeps numbers such as 14 553 on one line in the cells of tables.
document.addEventListener("DOMContentLoaded", () => {
  for (const cell of document.querySelectorAll(".md-typeset td")) {
    const texts = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
    while (texts.nextNode()) {
      texts.currentNode.data = texts.currentNode.data.replace(/(?<=\d) (?=\d{3}(?!\d))/g, "\u00a0");
    }
  }
});
