// Views of the page that follow the clock: the plan, the lanes of the timeline, rows of tables.
const buildPlan = (box) => {
  const drawing = box.querySelector("svg");
  let before = "";
  onChange(() => {
    const now = [state.focus, ...state.shown].join();
    if (now === before) return;
    before = now;
    for (const v of RUN.vehicles)
      for (const node of drawing.getElementsByClassName("ink-" + v.index)) {
        node.classList.toggle("off", !visible(v));
        node.style.opacity = state.focus < 0 || state.focus === v.index ? "" : "0.25";
      }
  });
};

const buildLanes = (lanes) => {
  const now = lanes.querySelector(".now"), marks = lanes.querySelector(".lane-marks");
  const place = () => {
    const box = lanes.getBoundingClientRect(), axis = marks.getBoundingClientRect();
    return { left: axis.left - box.left, wide: axis.width, x: axis.left };
  };
  now.hidden = false;
  onChange(() => {
    const { left, wide } = place();
    now.style.left = left + (state.t - RUN.start) / (RUN.end - RUN.start) * wide + "px";
  }, lanes);
  new ResizeObserver(changed).observe(lanes);
  lanes.addEventListener("click", (e) => {
    const { x, wide } = place();
    if (e.clientX >= x) setTime(RUN.start + (e.clientX - x) / wide * (RUN.end - RUN.start));
  });
  lanes.addEventListener("pointermove", (e) => {
    const said = e.target.closest?.("g, rect")?.querySelector("title");
    if (said) showTip(e.clientX, e.clientY, said.textContent, []); else hideTip();
  });
  lanes.addEventListener("pointerleave", hideTip);
};

const highlighted = () => {
  const rowOf = (event) => Number(event.target.closest?.("[data-v]")?.dataset.v ?? -1);
  const main = document.querySelector("main");
  main.addEventListener("pointerover", (event) => { if (!event.target.closest?.("canvas")) setFocus(rowOf(event)); });
  main.addEventListener("pointerleave", () => setFocus(-1));
  let last = -1;
  onChange(() => {
    if (last === state.focus) return;
    for (const row of document.querySelectorAll(`[data-v="${last}"]`)) row.classList.remove("focus");
    last = state.focus;
    for (const row of document.querySelectorAll(`[data-v="${last}"]`)) row.classList.add("focus");
  });
};

for (const figure of document.querySelectorAll(".panel")) buildPanel(figure);
if (RUN.vehicles.length) buildChart($("chart"));
buildPlan($("plan"));
if ($("lanes")) buildLanes($("lanes"));
highlighted();
changed();
