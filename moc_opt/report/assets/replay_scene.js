// The three-dimensional scene: one view per run on one canvas. All views have the same camera.
const Scene = (canvas, data) => {
  "use strict";
  const { times, frame, unit, sub, cross, dot } = Gl;
  const gpu = Gl.open(canvas);
  if (!gpu) return null;
  const { gl } = gpu;
  const ELLIPSOID = 1 / 6, FIELD = 0.56;
  const shown = { ellipsoid: true, wall: true, path: true };
  const LIGHT = { back: "#f7f8f9", shell: "#d3d8dd", tool: "#6b737c", wall: "#d98f76", rim: "#a85b45", ground: "#9aa3ab", shadow: "#3a424a", asked: "#1f2328" };
  const DARK = { back: "#1b1f23", shell: "#aeb6be", tool: "#8d959d", wall: "#b5705a", rim: "#d9937c", ground: "#5d666f", shadow: "#000000", asked: "#e4e7ea" };
  const rgba = (hex, alpha = 1) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255).concat(alpha);

  const parts = data.parts.map((part) => ({ ...part, body: gpu.body(Gl.lathe(part.radii, part.heights)), local: frame(part.origin, part.axis) }));
  const arc = [...Array(25).keys()].map((k) => -Math.PI / 2 + Math.PI * k / 24);
  const ball = gpu.body(Gl.lathe(arc.map(Math.cos), arc.map(Math.sin)));
  // The body wall: a shallow dome with an opening, a ring around the dome, and a ring around the opening.
  const HOLE = 0.009, WALL = 0.13, DOME = 0.45;
  const across = [...Array(25).keys()].map((k) => HOLE + (WALL - HOLE) * k / 24);
  const sag = (r) => DOME - Math.sqrt(DOME * DOME - r * r);
  const wall = gpu.body(Gl.lathe(across, across.map((r) => -sag(r)), 72));
  const round = [...Array(17).keys()].map((k) => 2 * Math.PI * k / 16);
  const ringOf = (radius, thick, drop) => gpu.body(Gl.lathe(round.map((a) => radius - thick * Math.cos(a)), round.map((a) => thick * Math.sin(a) - drop), 72));
  const opening = ringOf(HOLE, 0.0022, 0), edge = ringOf(WALL, 0.0016, sag(WALL));

  const runs = data.runs.map((run) => {
    const asked = gpu.curve(run.course_asked), taken = gpu.curve(run.course);
    // The body wall is level. If the tool is more than 60 degrees off the vertical, the wall is across the tool.
    let normal = [0, 0, 1];
    if (run.trocar) {
      const up = unit(sub(run.trocar, run.tip));
      if (up[2] < 0.5) normal = up;
    }
    return { ...run, asked, taken, normal };
  });

  // --- poses and points at a time ---
  const first = data.times[0], step = (data.times[data.times.length - 1] - first) / (data.times.length - 1);
  const at = (array, size, time) => {
    const place = Math.min(Math.max((time - first) / step, 0), data.times.length - 1), k = Math.min(Math.floor(place), data.times.length - 2), w = place - k;
    const out = new Float32Array(size);
    for (let i = 0; i < size; i++) out[i] = (1 - w) * array[k * size + i] + w * array[(k + 1) * size + i];
    return out;
  };
  const joints = data.runs[0].poses.length / data.times.length / 12;
  const still = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
  const models = (run, time) => {
    const flat = at(run.poses, 12 * joints, time), links = [];
    for (let j = 0; j < joints; j++) {
      const m = flat.subarray(12 * j, 12 * j + 12);
      links.push(new Float32Array([m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0, m[3], m[7], m[11], 1]));
    }
    return parts.map((part) => times(part.link < 0 ? still : links[part.link], part.local));
  };

  // --- the camera ---
  const camera = { around: 0, above: 0, away: 1, target: [0, 0, 0] };
  const middle = (points) => {
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (let i = 0; i < points.length; i++) { low[i % 3] = Math.min(low[i % 3], points[i]); high[i % 3] = Math.max(high[i % 3], points[i]); }
    return { at: low.map((x, i) => (x + high[i]) / 2), size: Math.hypot(...sub(high, low)) };
  };
  const path = middle(runs[0].course_asked);
  const facing = Math.atan2(path.at[1], path.at[0]);
  const VIEWS = {
    arm: () => {
      const origins = [];
      for (const run of runs) for (let k = 0; k < run.poses.length; k += 12) origins.push(run.poses[k + 3], run.poses[k + 7], run.poses[k + 11]);
      const all = middle([0, 0, 0, ...path.at, ...[...Array(Math.min(origins.length / 3, 4000)).keys()].flatMap((k) => { const j = 3 * Math.floor(k * origins.length / 3 / Math.min(origins.length / 3, 4000)); return origins.slice(j, j + 3); })]);
      return { around: facing - 1.05, above: 0.3, target: all.at, size: all.size * 1.12 };
    },
    trocar: () => ({ around: facing - 1.05, above: 0.42, target: runs[0].trocar ? [...runs[0].trocar.slice(0, 3)] : path.at, size: 0.42 }),
    tip: () => ({ around: facing - 1.05, above: 0.3, target: path.at, size: Math.max(1.9 * path.size, 0.02) }),
  };
  const FIT = 0.5 / Math.tan(FIELD / 2);
  let views = [];
  const look = (name) => {
    const { size, ...rest } = VIEWS[name]();
    const box = views[0] || { w: 1, h: 1 };
    Object.assign(camera, rest, { away: size * FIT * Math.max(1, 0.92 * box.h / box.w) * 1.1 });
  };
  const eye = () => {
    const { around, above, away, target } = camera;
    return [target[0] + away * Math.cos(above) * Math.cos(around), target[1] + away * Math.cos(above) * Math.sin(around), target[2] + away * Math.sin(above)];
  };

  // --- layout: beside each other, or below each other where the canvas is tall ---
  const arrange = () => {
    const scale = Math.min(window.devicePixelRatio || 1, 2), width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    const count = runs.length, rows = width < 0.62 * count * height / 1.2 && width < height * 1.1 ? count : 1, columns = count / rows;
    views = runs.map((_, k) => ({ x: rows > 1 ? 0 : k * width / columns, y: rows > 1 ? k * height / rows : 0, w: width / columns, h: height / rows }));
    return { views, scale, rows };
  };

  const draw = (time, dark) => {
    const palette = dark ? DARK : LIGHT, { scale } = arrange.last, from = eye();
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...rgba(palette.back));
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    runs.forEach((run, k) => {
      const { x, y, w, h } = views[k], box = [x * scale, canvas.height - (y + h) * scale, w * scale, h * scale].map(Math.round);
      gl.viewport(...box);
      gl.scissor(...box);
      const view = times(Gl.perspective(FIELD, w / h, 0.02 * camera.away, camera.away * 4 + 6), Gl.lookAt(from, camera.target));
      const screen = [w * scale, h * scale], tint = run.color[dark ? "dark" : "light"], colors = { shell: rgba(palette.shell), tool: rgba(palette.tool), joint: rgba(tint) };
      const bodies = models(run, time);
      gl.disable(gl.BLEND);
      gl.depthMask(true);
      parts.forEach((part, i) => gpu.drawBody(part.body, view, bodies[i], from, colors[part.role], part.role === "tool" ? 0.5 : 0.18));
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gpu.drawGround(view, 1.6, rgba(palette.ground, 0.55));
      // The shadow: project all bodies onto the ground along the light. The stencil darkens every pixel only once.
      const press = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, -0.28, 0.34, 0, 0, 0, 0, 0.0008, 1]);
      gl.enable(gl.STENCIL_TEST);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      parts.forEach((part, i) => gpu.drawBody(part.body, view, times(press, bodies[i]), from, rgba(palette.shadow, dark ? 0.35 : 0.13), -1));
      gl.disable(gl.STENCIL_TEST);
      const tip = at(run.tip, 3, time), px = scale;
      if (shown.path) {
        let count = 0;
        while (count < run.course_t.length - 1 && run.course_t[count + 1] <= time) count++;
        gpu.drawCurve(run.asked, view, screen, rgba(palette.asked, 0.75), 1.3 * px);
        gpu.drawCurve(run.taken, view, screen, rgba(tint), 3.2 * px, count);
      }
      if (shown.wall && run.trocar) {
        const place = frame(at(run.trocar, 3, time), run.normal);
        gl.depthMask(true);
        gpu.drawBody(opening, view, place, from, rgba(palette.rim), 0.2);
        gpu.drawBody(edge, view, place, from, rgba(palette.rim, 0.8), 0.1);
        gl.depthMask(false);
        gpu.drawBody(wall, view, place, from, rgba(palette.wall, 0.42), 0.1);
      }
      if (shown.ellipsoid) {
        const s = at(run.ellipsoid, 9, time).map((v) => v * ELLIPSOID);
        const model = new Float32Array([s[0], s[1], s[2], 0, s[3], s[4], s[5], 0, s[6], s[7], s[8], 0, ...tip, 1]);
        gl.enable(gl.CULL_FACE);
        gl.cullFace(gl.FRONT);
        gpu.drawBody(ball, view, model, from, rgba(tint, 0.1), 0);
        gl.cullFace(gl.BACK);
        gpu.drawBody(ball, view, model, from, rgba(tint, 0.2), 0.3);
        gl.disable(gl.CULL_FACE);
      }
      const dotModel = new Float32Array(16), r = 0.0035 * Math.min(1, Math.max(camera.away, 0.12) / 0.5);
      dotModel.set([r, 0, 0, 0, 0, r, 0, 0, 0, 0, r, 0, ...tip, 1]);
      gl.depthMask(true);
      gpu.drawBody(ball, view, dotModel, from, rgba(tint), 0.3);
    });
    gl.depthMask(true);
  };

  return {
    shown, camera, look, draw,
    resize: () => { arrange.last = arrange(); return arrange.last; },
    deviation: (gain) => runs.forEach((run) => gpu.move(run.taken, run.course.map((x, i) => run.course_asked[i] + gain * (x - run.course_asked[i])))),
    turn: (dx, dy) => { camera.around -= 0.007 * dx; camera.above = Math.min(1.5, Math.max(-0.3, camera.above + 0.007 * dy)); },
    shift: (dx, dy) => {
      const h = (views[0] || { h: 600 }).h, unitLength = 2 * camera.away * Math.tan(FIELD / 2) / h, z = unit(sub(eye(), camera.target)), x = unit(cross([0, 0, 1], z)), y = cross(z, x);
      camera.target = camera.target.map((t, i) => t - unitLength * dx * x[i] + unitLength * dy * y[i]);
    },
    zoom: (factor) => { camera.away = Math.min(12, Math.max(0.02, camera.away * factor)); },
    lost: () => gl.isContextLost(),
  };
};
