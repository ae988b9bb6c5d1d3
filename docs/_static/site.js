// What scrolls by itself can be reached, and so scrolled, by keyboard.
for (const box of document.querySelectorAll(".table-wrapper, article pre, div.math")) {
  if (box.scrollWidth > box.clientWidth) {
    box.tabIndex = 0;
  }
}
