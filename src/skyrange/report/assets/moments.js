// The viewer of the page: where it opens, and links that lead to a moment in it.
const viewer = window.skyrangeViewer ?? null;
const stage = document.getElementById("scene");
const stillness = matchMedia("(prefers-reduced-motion: reduce)");
const OPENING_S = 24;
const SPEEDS = [1, 2, 4, 8, 16];

const openViewer = () => {
  const { store } = viewer;
  let opened = /[#?&]t=/.test(location.hash + location.search);
  store.subscribe(() => {
    if (opened || !store.scene) return;
    opened = true;
    const { start, end } = store.span(), from = Number(document.getElementById("viewer").dataset.from || NaN);
    if (stillness.matches) store.show({ time: Number.isFinite(from) ? from : (start + end) / 2 });
    else {
      const pace = (end - start) / OPENING_S, natural = SPEEDS.reduce((best, x) => (Math.abs(Math.log(x / pace)) < Math.abs(Math.log(best / pace)) ? x : best));
      store.show({ time: Math.max(Number.isFinite(from) ? from : start, start), speed: Number.isFinite(from) ? 1 : natural, playing: true });
    }
  });
};
if (viewer) openViewer();

document.addEventListener("click", (event) => {
  const link = event.target.closest?.('a[href^="#t="]'), href = link?.getAttribute("href");
  if (!link || event.defaultPrevented || event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
  // the address may be the same already
  if (location.hash === href) dispatchEvent(new HashChangeEvent("hashchange"));
  const elsewhere = document.getElementById("elsewhere"), moment = new URLSearchParams(href.slice(1));
  if (elsewhere) elsewhere.textContent = `: at ${moment.get("t")} s${moment.has("select") ? ", " + moment.get("select") : ""}`;
  stage.scrollIntoView({ block: "start" });
});
addEventListener("beforeprint", () => viewer?.store.show({ playing: false }));
