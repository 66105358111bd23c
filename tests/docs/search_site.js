// Put into a page of the built site by tests/docs/test_site.py: types WORD into the search, and sends the pages that
// are found to PLACE.
window.addEventListener("load", () => {
  const field = document.querySelector("input.md-search__input");
  document.querySelector("#__search").click();
  field.focus();
  field.value = "WORD";
  field.dispatchEvent(new KeyboardEvent("keyup", { bubbles: true }));
  const look = setInterval(() => {
    const links = [...document.querySelectorAll(".md-search-result__list a")];
    if (!links.length) return;
    clearInterval(look);
    const body = links.map((link) => link.getAttribute("href")).join("\n");
    fetch("PLACE", { method: "POST", mode: "no-cors", body });
  }, 100);
});
