// Unpacks the data and plays them. Scene, curves and controls show the same time.
(async () => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const trouble = (text) => { const note = document.createElement("p"); note.className = "trouble"; note.textContent = text; $("stage").append(note); };

  const unpack = async () => {
    const packed = Uint8Array.from(atob($("replay-data").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    // Lists of numbers become a Float32Array, and null becomes NaN.
    const array = (key, value) => Array.isArray(value) && value.every((v) => v === null || typeof v === "number") ? Float32Array.from(value, (v) => v ?? NaN) : value;
    return JSON.parse(await new Response(stream).text(), array);
  };

  let data;
  try { data = await unpack(); } catch (error) { trouble("This replay needs a browser of 2023 or later: " + error); throw error; }
  const first = data.times[0], last = data.times[data.times.length - 1];
  let time = first, playing = false, before = 0, asked = false, resized = true;

  let scene = null;
  try { scene = Scene($("scene"), data); } catch (error) { console.warn(String(error)); }
  if (!scene) trouble("The arm is not shown: this browser has no WebGL 2, or it is switched off. The curves below work.");

  const labels = data.runs.map((run) => {
    const box = document.createElement("div"), name = document.createElement("b"), note = document.createElement("span");
    name.textContent = run.name;
    box.append(name, note);
    $("labels").append(box);
    return { box, name, note };
  });

  const frame = (now) => {
    asked = false;
    if (playing) {
      time += Math.min(0.25, (now - before) / 1000) * Number($("speed").value);
      if (time >= last) { time = last; play(false); }
    }
    before = now;
    if (resized) {
      resized = false;
      plots.paint(dark.matches);
      if (scene) {
        const { views, rows } = scene.resize();
        $("labels").className = rows > 1 ? "rows" : "";
        labels.forEach(({ box }, k) => Object.assign(box.style, { left: views[k].x + "px", top: views[k].y + "px", width: views[k].w + "px", height: views[k].h + "px" }));
        if (!scene.seen) { scene.look("arm"); scene.seen = true; }
      }
    }
    if (scene) scene.draw(time, dark.matches);
    plots.cursor(time, dark.matches);
    labels.forEach(({ name, note }, k) => {
      const run = data.runs[k], over = time > run.end + 0.05;
      name.style.color = run.color[dark.matches ? "dark" : "light"];
      note.textContent = over && run.ended !== "completed" ? run.ended : "";
    });
    $("time").value = 1000 * (time - first) / (last - first);
    $("time").setAttribute("aria-valuetext", time.toFixed(2) + " seconds");
    $("clock").textContent = time.toFixed(2) + " / " + last.toFixed(2) + " s";
    if (playing) draw();
  };
  const draw = () => { if (!asked) { asked = true; requestAnimationFrame(frame); } };
  const seek = (to) => { time = Math.min(last, Math.max(first, to)); draw(); };
  const PLAY = "M3.5 2v12l10-6z", PAUSE = "M3 2h3.5v12H3zM9.5 2H13v12H9.5z";
  const play = (on) => {
    if (on && time >= last - 1e-6) time = first;
    playing = on;
    before = performance.now();
    $("play").querySelector("path").setAttribute("d", on ? PAUSE : PLAY);
    $("play").setAttribute("aria-label", on ? "Pause" : "Play");
    draw();
  };
  const plots = Plots($("plots"), data, seek);

  // --- controls ---
  $("play").addEventListener("click", () => play(!playing));
  $("time").addEventListener("input", (event) => seek(first + (last - first) * event.target.value / 1000));
  const show = (button) => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    if (scene) scene.shown[button.dataset.show] = on;
    draw();
  };
  const look = (name) => { if (scene) scene.look(name); draw(); };
  for (const button of document.querySelectorAll("[data-show]")) button.addEventListener("click", () => show(button));
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
  $("gain").addEventListener("change", (event) => { if (scene) scene.deviation(Number(event.target.value)); draw(); });
  const faster = (by) => { const list = $("speed"); list.selectedIndex = Math.min(list.options.length - 1, Math.max(0, list.selectedIndex + by)); };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const step = event.shiftKey ? 1 : 0.1, focused = event.target.tagName === "BUTTON" || event.target.tagName === "SUMMARY";
    const keys = {
      " ": () => play(!playing), ArrowLeft: () => seek(time - step), ArrowRight: () => seek(time + step), Home: () => seek(first), End: () => seek(last),
      "[": () => faster(-1), "]": () => faster(1), 1: () => look("arm"), 2: () => look("trocar"), 3: () => look("tip"),
      e: () => show(document.querySelector("[data-show=ellipsoid]")), w: () => show(document.querySelector("[data-show=wall]")), p: () => show(document.querySelector("[data-show=path]")),
    };
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || (focused && event.key === " ")) return;
    event.preventDefault();
    act();
  });

  // --- the camera, by mouse or fingers ---
  const fingers = new Map(), canvas = $("scene");
  const spread = () => { const [a, b] = [...fingers.values()]; return { far: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 }; };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, { x: event.clientX, y: event.clientY }); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger || !scene) return;
    const dx = event.clientX - finger.x, dy = event.clientY - finger.y, old = fingers.size === 2 ? spread() : null;
    Object.assign(finger, { x: event.clientX, y: event.clientY });
    if (old) { const now = spread(); scene.zoom(old.far / (now.far || 1)); scene.shift(now.x - old.x, now.y - old.y); }
    else if (fingers.size === 1) (event.buttons & 2 || event.shiftKey ? scene.shift : scene.turn)(dx, dy);
    draw();
  });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); if (scene) scene.zoom(Math.exp(0.0012 * event.deltaY)); draw(); }, { passive: false });
  canvas.addEventListener("dblclick", () => look("arm"));
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); scene = null; trouble("The graphics were lost: reload the page."); });

  const again = () => { resized = true; draw(); };
  dark.addEventListener("change", again);
  new ResizeObserver(again).observe($("stage"));
  window.addEventListener("beforeprint", () => { resized = true; frame(performance.now()); });
  const start = () => { const found = /^#t=([0-9.]+)$/.exec(location.hash); if (found) seek(Number(found[1])); };
  window.addEventListener("hashchange", start);
  window.replay = { seek, play, look, get time() { return time; }, get playing() { return playing; } };
  start();
  draw();
  requestAnimationFrame(() => requestAnimationFrame(() => { document.documentElement.dataset.drawn = "yes"; }));
})();
