// WebGL 2 for the replay: matrices, shader programs for bodies, wide lines and the ground, and bodies of revolution.
const Gl = (() => {
  "use strict";
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };

  // 4x4 matrices are stored by columns, as WebGL needs them.
  const times = (a, b) => {
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) {
      out[4 * c + r] = a[r] * b[4 * c] + a[4 + r] * b[4 * c + 1] + a[8 + r] * b[4 * c + 2] + a[12 + r] * b[4 * c + 3];
    }
    return out;
  };
  // The frame whose z axis is `axis`.
  const frame = (origin, axis) => {
    const z = unit(axis), x = unit(cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z)), y = cross(z, x);
    return new Float32Array([...x, 0, ...y, 0, ...z, 0, ...origin, 1]);
  };
  const perspective = (angle, aspect, near, far) => {
    const f = 1 / Math.tan(angle / 2), d = 1 / (near - far);
    return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) * d, -1, 0, 0, 2 * near * far * d, 0]);
  };
  const lookAt = (eye, target) => {
    const z = unit(sub(eye, target)), x = unit(cross([0, 0, 1], z)), y = cross(z, x);
    return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);
  };
  // The inverse transpose of the upper 3x3 block, up to a factor. It transforms normals.
  const normalMatrix = (m) => {
    const c = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
    return new Float32Array([...cross(c[1], c[2]), ...cross(c[2], c[0]), ...cross(c[0], c[1])]);
  };

  const MESH_V = `#version 300 es
    in vec3 place, normal; uniform mat4 view, model; uniform mat3 turn; out vec3 n, p;
    void main() { vec4 w = model * vec4(place, 1.0); p = w.xyz; n = turn * normal; gl_Position = view * w; }`;
  const MESH_F = `#version 300 es
    precision highp float; in vec3 n, p; uniform vec4 color; uniform vec3 eye; uniform float gloss; out vec4 result;
    void main() {
      vec3 m = normalize(n), v = normalize(eye - p); if (dot(m, v) < 0.0) m = -m;
      if (gloss < 0.0) { result = color; return; }
      vec3 key = normalize(vec3(0.45, -0.55, 0.9)), fill = normalize(vec3(-0.7, 0.5, 0.25));
      float light = 0.40 + 0.20 * m.z + 0.40 * max(dot(m, key), 0.0) + 0.10 * max(dot(m, fill), 0.0) + 0.24 * dot(m, v);
      float shine = gloss * pow(max(dot(m, normalize(key + v)), 0.0), 40.0);
      // The rim of a translucent body is more opaque.
      float rim = pow(1.0 - abs(dot(m, v)), 2.0), alpha = color.a < 1.0 ? min(1.0, color.a * (0.65 + 1.6 * rim)) : 1.0;
      result = vec4(color.rgb * light + shine, alpha);
    }`;
  const LINE_V = `#version 300 es
    in vec3 start, end; uniform mat4 view; uniform vec2 screen; uniform float width;
    void main() {
      vec4 a = view * vec4(start, 1.0), b = view * vec4(end, 1.0);
      float side = float(gl_VertexID & 1) * 2.0 - 1.0; bool far = gl_VertexID > 1;
      vec2 along = (b.xy / b.w - a.xy / a.w) * screen; float l = length(along);
      along = l > 1e-6 ? along / l : vec2(1.0, 0.0);
      vec4 c = far ? b : a;
      // Extend the segment a little, so that there are no gaps between segments.
      vec2 off = vec2(-along.y, along.x) * side + along * (far ? 0.5 : -0.5);
      c.xy += off * width / screen * c.w; c.z -= 2e-4 * c.w; gl_Position = c;
    }`;
  const LINE_F = `#version 300 es
    precision highp float; uniform vec4 color; out vec4 result; void main() { result = color; }`;
  const GROUND_V = `#version 300 es
    in vec3 place; uniform mat4 view; uniform float size; out vec2 p;
    void main() { p = place.xy * size; gl_Position = view * vec4(p, 0.0, 1.0); }`;
  const GROUND_F = `#version 300 es
    precision highp float; in vec2 p; uniform vec4 color; uniform float size; out vec4 result;
    float lines(float step) { vec2 g = abs(fract(p / step - 0.5) - 0.5) / fwidth(p / step); return 1.0 - min(min(g.x, g.y), 1.0); }
    void main() {
      float fade = 1.0 - smoothstep(0.35, 0.95, length(p) / size);
      result = vec4(color.rgb, color.a * fade * max(0.45 * lines(0.1), lines(0.5)));
    }`;

  const program = (gl, vertex, fragment) => {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(made);
    const at = { program: made };
    for (let i = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
      const { name } = gl.getActiveUniform(made, i);
      at[name] = gl.getUniformLocation(made, name);
    }
    for (let i = gl.getProgramParameter(made, gl.ACTIVE_ATTRIBUTES) - 1; i >= 0; i--) {
      const { name } = gl.getActiveAttrib(made, i);
      at[name] = gl.getAttribLocation(made, name);
    }
    return at;
  };

  // Turns a profile about z. At a sharp bend the two sides have separate normals, so that an edge is visible.
  const lathe = (radii, heights, around = 48) => {
    const places = [], normals = [], count = radii.length;
    const slope = (k) => { const r = radii[k + 1] - radii[k], h = heights[k + 1] - heights[k], l = Math.hypot(r, h) || 1; return [h / l, -r / l]; };
    const smooth = (k, other) => {
      const a = slope(k);
      if (other < 0 || other > count - 2) return a;
      const b = slope(other);
      if (a[0] * b[0] + a[1] * b[1] < 0.8) return a;
      const l = Math.hypot(a[0] + b[0], a[1] + b[1]);
      return [(a[0] + b[0]) / l, (a[1] + b[1]) / l];
    };
    for (let k = 0; k < count - 1; k++) {
      const lower = smooth(k, k - 1), upper = smooth(k, k + 1);
      for (let i = 0; i < around; i++) {
        const corner = (turn, j, n) => {
          const c = Math.cos(2 * Math.PI * turn / around), s = Math.sin(2 * Math.PI * turn / around);
          places.push(radii[j] * c, radii[j] * s, heights[j]);
          normals.push(n[0] * c, n[0] * s, n[1]);
        };
        corner(i, k, lower); corner(i + 1, k, lower); corner(i + 1, k + 1, upper);
        corner(i, k, lower); corner(i + 1, k + 1, upper); corner(i, k + 1, upper);
      }
    }
    return { places: new Float32Array(places), normals: new Float32Array(normals) };
  };

  const open = (canvas) => {
    const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, alpha: false, preserveDrawingBuffer: true });
    if (!gl) return null;
    const mesh = program(gl, MESH_V, MESH_F), line = program(gl, LINE_V, LINE_F), ground = program(gl, GROUND_V, GROUND_F);
    const buffer = (data) => { const made = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW); return made; };
    const point = (place, made, stride = 0, offset = 0, each = 0) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, made);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, stride, offset);
      gl.vertexAttribDivisor(place, each);
    };
    const body = ({ places, normals }) => {
      const vao = gl.createVertexArray();
      gl.bindVertexArray(vao);
      point(mesh.place, buffer(places));
      point(mesh.normal, buffer(normals));
      return { vao, count: places.length / 3 };
    };
    const curve = (points) => {
      const vao = gl.createVertexArray(), made = buffer(points);
      gl.bindVertexArray(vao);
      point(line.start, made, 12, 0, 1);
      point(line.end, made, 12, 12, 1);
      return { vao, buffer: made, count: points.length / 3 - 1 };
    };
    const square = gl.createVertexArray();
    gl.bindVertexArray(square);
    point(ground.place, buffer(new Float32Array([-1, -1, 0, 1, -1, 0, -1, 1, 0, 1, 1, 0])));
    return {
      gl, body, curve,
      move: (made, points) => { gl.bindBuffer(gl.ARRAY_BUFFER, made.buffer); gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW); },
      drawBody: (made, view, model, eye, color, gloss = 0.25) => {
        gl.useProgram(mesh.program);
        gl.bindVertexArray(made.vao);
        gl.uniformMatrix4fv(mesh.view, false, view);
        gl.uniformMatrix4fv(mesh.model, false, model);
        gl.uniformMatrix3fv(mesh.turn, false, normalMatrix(model));
        gl.uniform4fv(mesh.color, color);
        gl.uniform3fv(mesh.eye, eye);
        gl.uniform1f(mesh.gloss, gloss);
        gl.drawArrays(gl.TRIANGLES, 0, made.count);
      },
      drawCurve: (made, view, screen, color, width, count = made.count) => {
        if (count < 1) return;
        gl.useProgram(line.program);
        gl.bindVertexArray(made.vao);
        gl.uniformMatrix4fv(line.view, false, view);
        gl.uniform2fv(line.screen, screen);
        gl.uniform1f(line.width, width);
        gl.uniform4fv(line.color, color);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, Math.min(count, made.count));
      },
      drawGround: (view, size, color) => {
        gl.useProgram(ground.program);
        gl.bindVertexArray(square);
        gl.uniformMatrix4fv(ground.view, false, view);
        gl.uniform1f(ground.size, size);
        gl.uniform4fv(ground.color, color);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      },
    };
  };
  return { open, lathe, times, frame, perspective, lookAt, unit, sub, cross, dot };
})();
