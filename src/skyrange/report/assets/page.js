// Controls of the page: the clock, highlighting in all views, filters of the tables.
const buildClock = (scene) => {
  const play = $("play"), clock = $("clock"), pace = $("pace"), span = RUN.end - RUN.start;
  const icon = (d) => {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    svg.setAttribute("viewBox", "0 0 16 16");
    svg.setAttribute("aria-hidden", "true");
    path.setAttribute("d", d);
    svg.append(path);
    return svg;
  };
  const paces = [0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 200];
  const natural = paces.reduce((best, x) => (Math.abs(span / x - 24) < Math.abs(span / best - 24) ? x : best));
  for (const x of paces) pace.append(make("option", { value: String(x), textContent: "× " + x, selected: x === natural }));
  state.pace = natural;
  pace.addEventListener("change", () => { state.pace = Number(pace.value); });
  clock.min = RUN.start;
  clock.max = RUN.end;
  $("transport").hidden = false;
  const setPlaying = (on) => {
    state.playing = on;
    if (on && state.t >= RUN.end - 1e-6) setTime(RUN.start);
    play.replaceChildren(icon(on ? "M3 2h4v12H3zM9 2h4v12H9z" : "M4 2l10 6-10 6z"));
    play.setAttribute("aria-label", on ? "Pause" : "Play");
    changed();
  };
  play.addEventListener("click", () => setPlaying(!state.playing));
  clock.addEventListener("input", () => { setPlaying(false); setTime(Number(clock.value)); });
  onChange(() => {
    clock.value = state.t;
    clock.setAttribute("aria-valuetext", seconds(state.t));
    $("now").textContent = seconds(state.t);
  });
  let before = 0;
  const beat = (stamp) => {
    const dt = Math.min((stamp - before) / 1000, 0.5);
    before = stamp;
    if (state.playing) {
      if (!document.hidden) scene.beat(dt);
      setTime(state.t + dt * state.pace);
      if (state.t >= RUN.end) setPlaying(false);
    }
    requestAnimationFrame(beat);
  };
  requestAnimationFrame(beat);
  // `report.html#t=12.5` opens at that moment, so that a moment can be sent to a colleague.
  const linked = () => /^#t=(-?[\d.]+)$/.exec(location.hash);
  const jump = () => { setPlaying(false); setTime(Number(linked()[1])); };
  window.addEventListener("hashchange", () => { if (linked()) jump(); });
  if (linked()) jump();
  else {
    if (!stillness.matches) setTime(RUN.start);
    setPlaying(!stillness.matches);
  }
  window.addEventListener("beforeprint", () => setPlaying(false));
};

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

const buildFilter = (bar) => {
  const [words, kind] = [bar.querySelector("input"), bar.querySelector("select")], rows = [...$(bar.dataset.table).tBodies[0].rows];
  const texts = rows.map((row) => row.textContent.toLowerCase());
  const apply = () => {
    const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    rows.forEach((row, i) => {
      const keep = (!kind.value || row.dataset.k === kind.value) && wanted.every((word) => texts[i].includes(word));
      row.hidden = !keep;
      shown += keep;
    });
    bar.querySelector("output").textContent = shown + (shown === 1 ? " row" : " rows");
  };
  words.addEventListener("input", apply);
  kind.addEventListener("change", apply);
};

const highlighted = () => {
  const rows = [...document.querySelectorAll("tr[data-v],.lane[data-v]")];
  for (const row of rows) {
    row.addEventListener("pointerenter", () => setFocus(Number(row.dataset.v)));
    row.addEventListener("pointerleave", () => setFocus(-1));
  }
  let last = -1;
  onChange(() => {
    if (last === state.focus) return;
    last = state.focus;
    for (const row of rows) row.classList.toggle("focus", Number(row.dataset.v) === last);
  });
};

buildClock(buildScene());
for (const figure of document.querySelectorAll(".panel")) buildPanel(figure);
buildChart($("chart"));
buildPlan($("plan"));
if ($("lanes")) buildLanes($("lanes"));
for (const bar of document.querySelectorAll(".filter")) buildFilter(bar);
highlighted();
for (const row of document.querySelectorAll("tr[data-t] button"))
  row.addEventListener("click", () => setTime(Number(row.closest("tr").dataset.t)));
changed();
