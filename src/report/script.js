// What a point says when it is pointed at or touched: the SVG's own titles appear late, and not by touch.
(() => {
  const tip = document.getElementById("tip");
  for (const point of document.querySelectorAll("g.tt")) {
    const title = point.querySelector("title");
    if (title) {
      point.dataset.says = title.textContent;
      title.remove();
    }
  }
  const show = (event) => {
    const point = event.target.closest && event.target.closest("g.tt");
    tip.hidden = !point;
    if (!point) return;
    tip.textContent = point.dataset.says;
    const box = tip.getBoundingClientRect();
    const x = Math.min(event.clientX + 14, innerWidth - box.width - 4);
    const y = event.clientY - box.height - 12;
    tip.style.left = Math.max(4, x) + "px";
    tip.style.top = (y < 4 ? event.clientY + 16 : y) + "px";
  };
  document.addEventListener("pointerover", show);
  document.addEventListener("click", show);
  document.addEventListener("touchmove", () => { tip.hidden = true; }, { passive: true });
})();
