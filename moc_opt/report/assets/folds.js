// Folded sections: a link into a section opens it. The search field hides all table rows without the searched text.
(() => {
  "use strict";
  const sections = [...document.querySelectorAll("details.section")];
  const find = document.getElementById("find"), unfold = document.getElementById("unfold");
  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (let block = target && target.closest("details"); block; block = block.parentElement.closest("details")) {
      block.hidden = false;
      block.open = true;
    }
    if (target) target.scrollIntoView();
  };
  window.addEventListener("hashchange", reveal);
  // A second click on the same link does not change the URL, and so causes no hashchange.
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    if (link && link.getAttribute("href") === location.hash) reveal();
  });
  if (location.hash) reveal();
  if (!find) return;

  const search = () => {
    const wanted = find.value.trim().toLowerCase();
    let count = 0;
    for (const section of sections) {
      let mine = 0;
      for (const row of section.querySelectorAll("tbody tr")) {
        row.hidden = wanted !== "" && !row.textContent.toLowerCase().includes(wanted);
        mine += wanted !== "" && !row.hidden;
      }
      section.hidden = wanted !== "" && mine === 0;
      section.open = mine > 0;
      count += mine;
    }
    document.getElementById("found").value = wanted === "" ? "" : `${count} rows`;
  };
  let resting;
  find.addEventListener("input", () => { clearTimeout(resting); resting = setTimeout(search, 120); });
  unfold.addEventListener("click", () => {
    const open = sections.some((section) => !section.open);
    for (const section of sections) section.open = open;
    unfold.textContent = open ? "Fold all" : "Unfold all";
  });
})();
