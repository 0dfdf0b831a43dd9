// The curves below the scene. They are drawn once, with a moving cursor. A click or touch sets the time.
const Plots = (root, data, seek) => {
  "use strict";
  const first = data.times[0], last = data.times[data.times.length - 1];
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const steps = (span, count) => {
    const rough = span / count, power = 10 ** Math.floor(Math.log10(rough));
    return power * [1, 2, 5, 10].find((k) => k * power >= rough);
  };
  const written = (value) => Number.isFinite(value) ? value.toPrecision(3) : "–";
  const PAD = { l: 44, r: 10, t: 6, b: 20 };

  const panels = data.panels.map((panel, p) => {
    const lines = data.runs.flatMap((run) => run.panels[p] ? [{ ...run.panels[p], run }] : []);
    if (!lines.length) return null;
    let low = panel.zero ? 0 : Infinity, high = -Infinity;
    for (const line of lines) for (const part of [line.y, line.bound || []]) for (const y of part) {
      if (Number.isFinite(y)) { low = Math.min(low, y); high = Math.max(high, y); }
    }
    if (!(high > low)) { high = (Number.isFinite(high) ? high : 0) + 1; low = Math.min(Number.isFinite(low) ? low : 0, high - 2); }
    const room = 0.06 * (high - low), box = document.createElement("div");
    box.className = "plot";
    box.innerHTML = "<p><b></b></p><canvas role=\"img\"></canvas>";
    box.querySelector("b").textContent = panel.title;
    const values = lines.map(() => box.querySelector("p").appendChild(document.createElement("span")));
    const canvas = box.querySelector("canvas");
    canvas.setAttribute("aria-label", panel.title + " over time");
    root.append(box);
    return { lines, low: panel.zero ? 0 : low - room, high: high + room, canvas, values, still: document.createElement("canvas") };
  }).filter(Boolean);

  const paint = (panel, dark) => {
    const { canvas, still } = panel, scale = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    for (const each of [canvas, still]) { each.width = Math.round(w * scale); each.height = Math.round(h * scale); }
    const pen = still.getContext("2d");
    pen.scale(scale, scale);
    panel.x = (t) => PAD.l + (w - PAD.l - PAD.r) * (t - first) / (last - first);
    panel.y = (v) => h - PAD.b - (h - PAD.t - PAD.b) * (v - panel.low) / (panel.high - panel.low);
    pen.font = "11px " + color("--sans");
    pen.lineWidth = 1;
    pen.fillStyle = color("--muted");
    pen.strokeStyle = color("--line");
    const dy = steps(panel.high - panel.low, 5.5), dx = steps(last - first, Math.max(3, w / 90));
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let v = dy * Math.ceil(panel.low / dy - 1e-9); v <= panel.high; v += dy) {
      const y = Math.round(panel.y(v)) + 0.5;
      pen.beginPath(); pen.moveTo(PAD.l, y); pen.lineTo(w - PAD.r, y); pen.stroke();
      pen.fillText(String(+v.toPrecision(6)), PAD.l - 6, y);
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const stop = last + 0.005 * (last - first); // the last tick of a run of 2 s is at 1.998 s
    for (let t = dx * Math.ceil(first / dx - 1e-9); t <= stop; t += dx) {
      const end = t + dx > stop;
      pen.fillText(String(+t.toPrecision(6)) + (end ? " s" : ""), Math.min(panel.x(t), w - 14), h - PAD.b + 5);
    }
    for (const line of panel.lines) {
      pen.strokeStyle = line.run.color[dark ? "dark" : "light"];
      const trail = (ts, ys) => {
        pen.beginPath();
        let down = false;
        ys.forEach((v, k) => {
          if (!Number.isFinite(v)) { down = false; return; }
          pen[down ? "lineTo" : "moveTo"](panel.x(ts[k]), panel.y(v));
          down = true;
        });
        pen.stroke();
      };
      pen.lineWidth = 1.4;
      pen.lineJoin = "round";
      trail(line.t, line.y);
      if (line.bound) { pen.setLineDash([2, 3]); pen.globalAlpha = 0.8; trail(line.bound_t, line.bound); pen.setLineDash([]); pen.globalAlpha = 1; }
    }
  };

  const cursor = (panel, time, dark) => {
    const pen = panel.canvas.getContext("2d"), scale = window.devicePixelRatio || 1, x = panel.x(time);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, panel.canvas.width, panel.canvas.height);
    pen.drawImage(panel.still, 0, 0);
    pen.scale(scale, scale);
    pen.strokeStyle = color("--ink");
    pen.lineWidth = 1;
    pen.beginPath(); pen.moveTo(x, PAD.t); pen.lineTo(x, panel.canvas.clientHeight - PAD.b); pen.stroke();
    const k = Math.round((time - first) / (last - first) * (data.times.length - 1));
    panel.lines.forEach((line, i) => {
      const value = line.at[k], tint = line.run.color[dark ? "dark" : "light"], over = time > line.run.end + 0.05;
      panel.values[i].textContent = over ? "ended" : written(value);
      panel.values[i].style.color = tint;
      if (over || !Number.isFinite(value)) return;
      pen.fillStyle = tint;
      pen.strokeStyle = color("--paper");
      pen.lineWidth = 1.5;
      pen.beginPath(); pen.arc(x, panel.y(value), 4, 0, 7); pen.fill(); pen.stroke();
    });
  };

  for (const panel of panels) {
    const go = (event) => {
      const box = panel.canvas.getBoundingClientRect();
      seek(first + (last - first) * (event.clientX - box.left - PAD.l) / (box.width - PAD.l - PAD.r));
    };
    panel.canvas.addEventListener("pointerdown", (event) => { panel.canvas.setPointerCapture(event.pointerId); go(event); });
    panel.canvas.addEventListener("pointermove", (event) => { if (event.buttons) go(event); });
  }
  return {
    paint: (dark) => panels.forEach((panel) => paint(panel, dark)),
    cursor: (time, dark) => panels.forEach((panel) => cursor(panel, time, dark)),
  };
};
