// The floor plan and everything the drone knows, on one canvas. World: plan metres, x right, y up.

const TAU = 2 * Math.PI;
const PATH_STEP = 0.04;
const PATH_MAX = 4000;

/** Colours of the canvas come from the style sheet, so that light and dark are said in one place. */
function palette() {
  const css = getComputedStyle(document.documentElement);
  const get = (name) => css.getPropertyValue(`--${name}`).trim();
  const names = ['floor', 'floor-edge', 'wall', 'wall-top', 'grid', 'ink', 'ink-soft', 'path', 'route', 'goal', 'drone', 'drone-body', 'particle', 'cone', 'hit', 'blocked', 'chosen', 'person', 'fence', 'home', 'waypoint', 'sigma', 'label', 'panel'];
  return Object.fromEntries(names.map((n) => [n.replace(/-(\w)/g, (_, c) => c.toUpperCase()), get(n)]));
}

export class PlanView extends EventTarget {
  constructor(canvas, vehicle) {
    super();
    this.canvas = canvas;
    this.ctx = canvas.getContext('2d');
    this.vehicle = vehicle;
    this.view = { x: 0, y: 0, scale: 40 };
    this.layers = { cones: true, particles: true, histogram: true, path: true, names: true, fence: true };
    this.follow = false;
    this.path = [];
    this.waypoints = [];
    this.fence = [];
    this.editing = false;
    this.pointer = null;
    this.drag = null;
    this.pulses = [];
    this.reached = -1;
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#listen();
    this.recolour();
  }

  recolour() {
    this.colour = palette();
    this.base = null;
  }

  /** The plan as `/api/plan` tells it. */
  setPlan(plan) {
    this.plan = plan;
    this.base = null;
    this.fit();
  }

  fit() {
    if (!this.plan || !this.width) return;
    const { width, height, cell, origin } = this.plan;
    const [w, h] = [width * cell, height * cell];
    const [left, right, top, bottom] = this.insets();
    this.view.scale = Math.min((this.width - left - right) / w, (this.height - top - bottom) / h);
    this.view.x = origin[0] + w / 2 - (left - right) / 2 / this.view.scale;
    this.view.y = origin[1] + h / 2 + (top - bottom) / 2 / this.view.scale;
    this.follow = false;
  }

  /** Room kept for what floats over the plan: left, right, top, bottom. */
  insets() {
    return this.width > 620 ? [142, 16, 62, 56] : [10, 10, 10, 56];
  }

  zoom(factor, at = [this.width / 2, this.height / 2]) {
    const before = this.toWorld(...at);
    this.view.scale = Math.max(8, Math.min(400, this.view.scale * factor));
    const after = this.toWorld(...at);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.view.x) * this.view.scale, this.height / 2 - (y - this.view.y) * this.view.scale];
  }

  toWorld(px, py) {
    return [this.view.x + (px - this.width / 2) / this.view.scale, this.view.y - (py - this.height / 2) / this.view.scale];
  }

  /** Plan metres as metres north and east of home. */
  toNed(x, y) {
    const { home, north } = this.plan;
    const [dx, dy, s, c] = [x - home[0], y - home[1], Math.sin(north), Math.cos(north)];
    return [dx * c + dy * s, dx * s - dy * c];
  }

  fromNed(n, e) {
    const { home, north } = this.plan;
    const [s, c] = [Math.sin(north), Math.cos(north)];
    return [home[0] + n * c + e * s, home[1] + n * s - e * c];
  }

  isFree(x, y) {
    if (!this.plan) return false;
    const { cell, origin, height } = this.plan;
    const [c, r] = [Math.floor((x - origin[0]) / cell), Math.floor((y - origin[1]) / cell)];
    if (r < 0 || r >= height) return false;
    const runs = this.plan.rows[r];
    for (let i = 0, at = 0; i < runs.length; i += 2) {
      at += runs[i + 1];
      if (c < at) return c >= 0 && runs[i] === 0;
    }
    return false;
  }

  #resize() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: w, clientHeight: h } = this.canvas;
    if (!w || !h) return;
    const first = !this.width;
    const wasFit = this.width && !this.moved;
    [this.width, this.height, this.ratio] = [w, h, ratio];
    this.canvas.width = Math.round(w * ratio);
    this.canvas.height = Math.round(h * ratio);
    if (first || wasFit) this.fit();
  }

  #listen() {
    const c = this.canvas;
    const touches = new Map();
    const place = (e) => { const r = c.getBoundingClientRect(); return [e.clientX - r.left, e.clientY - r.top]; };
    c.addEventListener('pointerdown', (e) => {
      c.setPointerCapture(e.pointerId);
      touches.set(e.pointerId, place(e));
      const at = place(e);
      const hit = this.editing ? this.waypoints.findIndex((w) => { const p = this.toScreen(w.x, w.y); return Math.hypot(p[0] - at[0], p[1] - at[1]) < 16; }) : -1;
      this.drag = { from: at, view: { ...this.view }, moved: false, waypoint: hit };
    });
    c.addEventListener('pointermove', (e) => {
      const at = place(e);
      this.pointer = at;
      if (!touches.has(e.pointerId)) return;
      const before = touches.get(e.pointerId);
      touches.set(e.pointerId, at);
      if (touches.size === 2) {
        const [a, b] = [...touches.values()];
        const other = a === at ? b : a;
        const [d0, d1] = [Math.hypot(before[0] - other[0], before[1] - other[1]), Math.hypot(at[0] - other[0], at[1] - other[1])];
        if (d0 > 1) this.zoom(d1 / d0, [(at[0] + other[0]) / 2, (at[1] + other[1]) / 2]);
        this.drag.moved = this.moved = true;
        return;
      }
      const [dx, dy] = [at[0] - this.drag.from[0], at[1] - this.drag.from[1]];
      if (!this.drag.moved && Math.hypot(dx, dy) < 5) return;
      this.drag.moved = true;
      if (this.drag.waypoint >= 0) {
        const [x, y] = this.toWorld(...at);
        Object.assign(this.waypoints[this.drag.waypoint], { x, y });
        this.dispatchEvent(new Event('edited'));
      } else {
        this.moved = true;
        this.follow = false;
        this.view.x = this.drag.view.x - dx / this.view.scale;
        this.view.y = this.drag.view.y + dy / this.view.scale;
      }
    });
    const up = (e) => {
      if (!touches.delete(e.pointerId) || !this.drag) return;
      if (!this.drag.moved && e.type === 'pointerup' && e.button === 0 && touches.size === 0) {
        const [x, y] = this.toWorld(...place(e));
        const name = this.editing ? 'add' : 'goto';
        if (this.drag.waypoint >= 0) this.dispatchEvent(new CustomEvent('pick', { detail: this.drag.waypoint }));
        else this.dispatchEvent(new CustomEvent(name, { detail: { x, y, free: this.isFree(x, y) } }));
      }
      if (touches.size === 0) this.drag = null;
    };
    c.addEventListener('pointerup', up);
    c.addEventListener('pointercancel', up);
    c.addEventListener('pointerleave', () => { this.pointer = null; });
    c.addEventListener('wheel', (e) => {
      e.preventDefault();
      this.moved = true;
      this.zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), place(e));
    }, { passive: false });
    c.addEventListener('keydown', (e) => {
      const step = 60 / this.view.scale;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
      if (moves[e.key]) { this.view.x += moves[e.key][0]; this.view.y += moves[e.key][1]; this.moved = true; this.follow = false; }
      else if (e.key === '+' || e.key === '=') this.zoom(1.25);
      else if (e.key === '-') this.zoom(0.8);
      else if (e.key === '0') { this.moved = false; this.fit(); }
      else return;
      e.preventDefault();
    });
  }

  /** A ring that spreads where something was asked for. */
  pulse(x, y, refused = false) {
    this.pulses.push({ x, y, refused, at: performance.now() });
  }

  /** Remembers where it has been; a jump of the estimate begins a new line. */
  observe(s) {
    if (!s.knows_position || !s.armed) { this.jump = true; return; }
    const last = this.path[this.path.length - 1];
    if (last && Math.hypot(s.x - last.x, s.y - last.y) < PATH_STEP && last.jumps === s.jumps) return;
    this.path.push({ x: s.x, y: s.y, jumps: s.jumps, gap: this.jump || (last && last.jumps !== s.jumps) });
    this.jump = false;
    if (this.path.length > PATH_MAX) this.path.splice(0, 400);
  }

  // ---- drawing

  draw(now) {
    if (!this.width || !this.plan) return;
    const { ctx } = this;
    const s = this.vehicle.state;
    if (this.follow && s) {
      this.view.x += (s.x - this.view.x) * 0.15;
      this.view.y += (s.y - this.view.y) * 0.15;
    }
    ctx.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    ctx.clearRect(0, 0, this.width, this.height);
    this.#floor();
    if (this.layers.fence) this.#fence();
    this.#home();
    if (this.layers.names) this.#names();
    if (this.layers.path) this.#path();
    this.#mission(now);
    if (s) {
      if (this.layers.cones) this.#cones(s);
      if (this.layers.particles) this.#particles();
      this.#people();
      this.#route(s, now);
      this.#sigma(s);
      if (this.layers.histogram) this.#histogram(s);
      this.#drone(s, now);
    }
    this.#pulses(now);
    this.#hover();
    this.#scale();
  }

  /** The plan drawn once per zoom into a picture of its own. */
  #floor() {
    const { plan, ctx } = this;
    const { cell, origin, width, height } = plan;
    if (!this.base) {
      const px = Math.max(2, Math.min(10, Math.floor(3200 / Math.max(width, height))));
      const base = new OffscreenCanvas(width * px, height * px);
      const b = base.getContext('2d');
      const rows = (kind, colour, grow = 0) => {
        b.fillStyle = colour;
        b.beginPath();
        plan.rows.forEach((runs, r) => {
          for (let i = 0, at = 0; i < runs.length; i += 2) {
            if (runs[i] === kind) b.rect(at * px - grow, (height - 1 - r) * px - grow, runs[i + 1] * px + 2 * grow, px + 2 * grow);
            at += runs[i + 1];
          }
        });
        b.fill();
      };
      // Floor, a soft shadow at the foot of the walls, the walls, their edge.
      rows(0, this.colour.floor);
      b.save();
      b.globalCompositeOperation = 'source-atop';
      b.shadowColor = this.colour.floorEdge;
      b.shadowBlur = 5.5 * px;
      b.shadowOffsetX = 1.2 * px;
      b.shadowOffsetY = 1.6 * px;
      rows(1, this.colour.wall);
      b.restore();
      rows(1, this.colour.wall, 0.25);
      b.strokeStyle = this.colour.wallTop;
      b.lineWidth = Math.max(1, px * 0.42);
      b.lineCap = 'square';
      b.beginPath();
      for (const [x0, y0, x1, y1] of plan.walls) {
        b.moveTo(((x0 - origin[0]) / cell) * px, (height - (y0 - origin[1]) / cell) * px);
        b.lineTo(((x1 - origin[0]) / cell) * px, (height - (y1 - origin[1]) / cell) * px);
      }
      b.stroke();
      this.base = base;
    }
    const [x, y] = this.toScreen(origin[0], origin[1] + height * cell);
    const k = this.view.scale;
    ctx.imageSmoothingQuality = 'high';
    ctx.drawImage(this.base, x, y, width * cell * k, height * cell * k);
    this.#grid();
  }

  #grid() {
    const { ctx, plan } = this;
    const { cell, origin, width, height } = plan;
    const step = this.view.scale > 90 ? 0.5 : this.view.scale > 22 ? 1 : 5;
    ctx.strokeStyle = this.colour.grid;
    ctx.lineWidth = 1;
    ctx.beginPath();
    const [x1, y1] = [origin[0] + width * cell, origin[1] + height * cell];
    for (let x = Math.ceil(origin[0] / step) * step; x <= x1; x += step) {
      const [a, b] = [this.toScreen(x, origin[1]), this.toScreen(x, y1)];
      ctx.moveTo(Math.round(a[0]) + 0.5, a[1]);
      ctx.lineTo(Math.round(b[0]) + 0.5, b[1]);
    }
    for (let y = Math.ceil(origin[1] / step) * step; y <= y1; y += step) {
      const [a, b] = [this.toScreen(origin[0], y), this.toScreen(x1, y)];
      ctx.moveTo(a[0], Math.round(a[1]) + 0.5);
      ctx.lineTo(b[0], Math.round(b[1]) + 0.5);
    }
    ctx.stroke();
  }

  #fence() {
    const { ctx } = this;
    for (const area of this.fence) {
      ctx.beginPath();
      if (area.radius) {
        const p = this.toScreen(area.x, area.y);
        ctx.arc(p[0], p[1], area.radius * this.view.scale, 0, TAU);
      } else {
        area.points.forEach(([x, y], i) => { const p = this.toScreen(x, y); if (i) ctx.lineTo(...p); else ctx.moveTo(...p); });
        ctx.closePath();
      }
      ctx.strokeStyle = this.colour.fence;
      ctx.lineWidth = 1.5;
      ctx.setLineDash([7, 5]);
      ctx.stroke();
      ctx.setLineDash([]);
      if (area.keepOut) { ctx.globalAlpha = 0.14; ctx.fillStyle = this.colour.fence; ctx.fill(); ctx.globalAlpha = 1; }
    }
  }

  #names() {
    const { ctx } = this;
    const size = Math.max(10, Math.min(14, this.view.scale * 0.24));
    ctx.font = `600 ${size}px system-ui, sans-serif`;
    ctx.textAlign = 'center';
    ctx.textBaseline = 'middle';
    ctx.fillStyle = this.colour.label;
    if ('letterSpacing' in ctx) ctx.letterSpacing = '0.09em';
    for (const room of this.plan.rooms) {
      const p = this.toScreen(room.x, room.y);
      ctx.fillText(room.name.replace(/[_-]/g, ' ').toUpperCase(), p[0], p[1] + size * 1.2);
    }
    if ('letterSpacing' in ctx) ctx.letterSpacing = '0px';
  }

  #home() {
    const { ctx } = this;
    const s = this.vehicle.state;
    const [x, y] = s ? [s.home_x, s.home_y] : this.plan.home;
    const p = this.toScreen(x, y);
    const r = Math.max(9, 0.2 * this.view.scale);
    ctx.strokeStyle = this.colour.home;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.arc(p[0], p[1], r, 0, TAU);
    ctx.stroke();
    ctx.font = `700 ${r}px system-ui, sans-serif`;
    ctx.textAlign = 'center';
    ctx.textBaseline = 'middle';
    ctx.fillStyle = this.colour.home;
    ctx.fillText('H', p[0], p[1] + 0.5);
  }

  #path() {
    const { ctx, path } = this;
    if (path.length < 2) return;
    ctx.strokeStyle = this.colour.path;
    ctx.lineWidth = Math.max(2, Math.min(4, 0.045 * this.view.scale));
    ctx.lineJoin = 'round';
    ctx.lineCap = 'butt';
    // Older pieces fade.
    const pieces = 24;
    const per = Math.ceil(path.length / pieces);
    for (let k = 0; k < pieces; k++) {
      const [from, to] = [k * per, Math.min(path.length - 1, (k + 1) * per)];
      if (from >= to) break;
      ctx.globalAlpha = 0.16 + 0.74 * ((k + 1) / pieces) ** 1.6;
      ctx.beginPath();
      for (let i = from; i <= to; i++) {
        const p = this.toScreen(path[i].x, path[i].y);
        if (i === from || path[i].gap) ctx.moveTo(...p);
        else ctx.lineTo(...p);
      }
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
  }

  #mission(now) {
    const { ctx, waypoints } = this;
    if (!waypoints.length) return;
    ctx.strokeStyle = this.colour.waypoint;
    ctx.lineWidth = 1.5;
    ctx.globalAlpha = 0.75;
    ctx.setLineDash([2, 5]);
    ctx.lineCap = 'round';
    ctx.beginPath();
    waypoints.forEach((w, i) => { const p = this.toScreen(w.x, w.y); if (i) ctx.lineTo(...p); else ctx.moveTo(...p); });
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    ctx.textAlign = 'center';
    ctx.textBaseline = 'middle';
    waypoints.forEach((w, i) => {
      const p = this.toScreen(w.x, w.y);
      const isNext = this.current === w.seq && w.seq !== undefined;
      const r = isNext ? 12.5 + Math.sin(now / 220) : 11;
      ctx.beginPath();
      ctx.arc(p[0], p[1], r, 0, TAU);
      ctx.fillStyle = w.done ? this.colour.floor : this.colour.waypoint;
      ctx.fill();
      ctx.strokeStyle = this.picked === i ? this.colour.ink : w.done ? this.colour.waypoint : this.colour.floor;
      ctx.lineWidth = 2;
      ctx.stroke();
      ctx.fillStyle = w.done ? this.colour.waypoint : this.colour.panel;
      ctx.font = '700 11px system-ui, sans-serif';
      ctx.fillText(w.done ? '✓' : String(i + 1), p[0], p[1] + 0.5);
    });
  }

  #cones(s) {
    const { ctx, vehicle: { scan } } = this;
    if (!scan) return;
    const k = this.view.scale;
    for (let i = 0; i + 5 < scan.length; i += 6) {
      const [bearing, half, distance, longest, ox, oy] = scan.subarray(i, i + 6);
      const yaw = s.yaw - bearing;
      const [c, n] = [Math.cos(s.yaw), Math.sin(s.yaw)];
      const p = this.toScreen(s.x + ox * c + oy * n, s.y + ox * n - oy * c);
      const isHit = Number.isFinite(distance);
      const r = (isHit ? distance : longest) * k;
      const w = Math.max(half, 0.012);
      ctx.beginPath();
      ctx.moveTo(...p);
      ctx.arc(p[0], p[1], r, -yaw - w, -yaw + w);
      ctx.closePath();
      // Into nothing it fades: nothing was seen there, which is not that nothing is there.
      if (isHit) ctx.fillStyle = this.colour.cone;
      else {
        const fade = ctx.createRadialGradient(p[0], p[1], 0, p[0], p[1], r * 0.8);
        fade.addColorStop(0, this.colour.cone);
        fade.addColorStop(1, `${this.colour.cone}00`);
        ctx.fillStyle = fade;
      }
      ctx.globalAlpha = isHit ? 0.2 : 0.16;
      ctx.fill();
      if (isHit) {
        ctx.globalAlpha = 0.95;
        ctx.strokeStyle = this.colour.hit;
        ctx.lineWidth = 2;
        ctx.lineCap = 'round';
        ctx.beginPath();
        ctx.arc(p[0], p[1], r, -yaw - w, -yaw + w);
        ctx.stroke();
      }
    }
    ctx.globalAlpha = 1;
  }

  #particles() {
    const { ctx, vehicle: { particles } } = this;
    if (!particles) return;
    ctx.fillStyle = this.colour.particle;
    ctx.globalAlpha = 0.5;
    const size = Math.max(1.6, Math.min(3.2, this.view.scale * 0.028));
    for (let i = 0; i + 2 < particles.length; i += 3) {
      const p = this.toScreen(particles[i] / 100, particles[i + 1] / 100);
      ctx.fillRect(p[0] - size / 2, p[1] - size / 2, size, size);
    }
    ctx.globalAlpha = 1;
  }

  #people() {
    const { ctx } = this;
    for (const [x, y, vx, vy] of this.vehicle.people ?? []) {
      const p = this.toScreen(x, y);
      const q = this.toScreen(x + vx, y + vy);
      ctx.strokeStyle = ctx.fillStyle = this.colour.person;
      ctx.lineWidth = 2.5;
      ctx.beginPath();
      ctx.moveTo(...p);
      ctx.lineTo(...q);
      ctx.stroke();
      ctx.beginPath();
      ctx.arc(p[0], p[1], Math.max(6, 0.22 * this.view.scale), 0, TAU);
      ctx.globalAlpha = 0.35;
      ctx.fill();
      ctx.globalAlpha = 1;
      ctx.stroke();
    }
  }

  #route(s, now) {
    const { ctx } = this;
    const { route, goal } = this.vehicle;
    if (!goal || !s.armed) return;
    const corners = route?.length > 1 ? route : [[s.x, s.y], goal];
    // Of the way only what lies ahead.
    let nearest = 0;
    let best = Infinity;
    for (let i = 0; i + 1 < corners.length; i++) {
      const d = toSegment([s.x, s.y], corners[i], corners[i + 1]);
      if (d < best) { best = d; nearest = i; }
    }
    const ahead = [[s.x, s.y], ...corners.slice(nearest + 1)];
    if (Math.hypot(goal[0] - s.x, goal[1] - s.y) < 0.3) return;
    ctx.strokeStyle = this.colour.route;
    ctx.lineWidth = 2.5;
    ctx.lineCap = ctx.lineJoin = 'round';
    ctx.setLineDash([9, 7]);
    ctx.lineDashOffset = -now / 40;
    ctx.beginPath();
    ahead.forEach((c, i) => { const p = this.toScreen(...c); if (i) ctx.lineTo(...p); else ctx.moveTo(...p); });
    ctx.stroke();
    ctx.setLineDash([]);
    const p = this.toScreen(...goal);
    const r = 7 + 1.5 * Math.sin(now / 260);
    ctx.fillStyle = this.colour.goal;
    ctx.beginPath();
    ctx.arc(p[0], p[1], 3.5, 0, TAU);
    ctx.fill();
    ctx.strokeStyle = this.colour.goal;
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.arc(p[0], p[1], r + 3, 0, TAU);
    ctx.stroke();
  }

  /** Two standard deviations of the position. */
  #sigma(s) {
    const { ctx } = this;
    const north = this.plan.north;
    const p = this.toScreen(s.x, s.y);
    const k = 2 * this.view.scale;
    ctx.beginPath();
    ctx.ellipse(p[0], p[1], Math.max(2, s.std_n * k), Math.max(2, s.std_e * k), -north, 0, TAU);
    ctx.fillStyle = ctx.strokeStyle = this.colour.sigma;
    ctx.globalAlpha = 0.14;
    ctx.fill();
    ctx.globalAlpha = 0.8;
    ctx.lineWidth = 1;
    ctx.stroke();
    ctx.globalAlpha = 1;
  }

  #histogram(s) {
    const { ctx, vehicle: { histogram: h } } = this;
    if (!h || !s.armed) return;
    const p = this.toScreen(s.x, s.y);
    const inner = Math.max(30, 0.42 * this.view.scale);
    const depth = Math.max(16, 0.34 * this.view.scale);
    const n = h.density.length;
    const full = Math.max(h.threshold * 2.5, 0.001);
    const gap = 0.012;
    for (let i = 0; i < n; i++) {
      const [a, b] = [(i / n) * TAU + gap, ((i + 1) / n) * TAU - gap];
      const v = Math.min(1, h.density[i] / full);
      ctx.beginPath();
      ctx.arc(p[0], p[1], inner, -a, -b, true);
      ctx.arc(p[0], p[1], inner + 2 + depth * v, -b, -a);
      ctx.closePath();
      ctx.fillStyle = h.blocked[i] ? this.colour.blocked : this.colour.chosen;
      ctx.globalAlpha = h.blocked[i] ? 0.85 : 0.3;
      ctx.fill();
    }
    ctx.globalAlpha = 1;
    if (Number.isFinite(h.chosen)) {
      const r = inner + depth + 9;
      const at = [p[0] + r * Math.cos(h.chosen), p[1] - r * Math.sin(h.chosen)];
      ctx.save();
      ctx.translate(...at);
      ctx.rotate(-h.chosen);
      ctx.beginPath();
      ctx.moveTo(9, 0);
      ctx.lineTo(-6, 7);
      ctx.lineTo(-2, 0);
      ctx.lineTo(-6, -7);
      ctx.closePath();
      ctx.fillStyle = this.colour.chosen;
      ctx.fill();
      ctx.restore();
    }
  }

  #drone(s, now) {
    const { ctx } = this;
    const p = this.toScreen(s.x, s.y);
    const r = Math.max(13, 0.17 * this.view.scale);
    ctx.save();
    ctx.translate(...p);
    // The higher it flies, the farther its shadow.
    ctx.fillStyle = 'rgba(0,0,0,.28)';
    const lift = 2 + Math.max(0, Math.min(2.5, s.height || 0)) * 0.1 * this.view.scale * 0.5;
    for (const [ax, ay] of arms(s.yaw)) {
      ctx.beginPath();
      ctx.arc(ax * r + lift, ay * r + lift, r * 0.52, 0, TAU);
      ctx.fill();
    }
    ctx.rotate(-s.yaw);
    ctx.strokeStyle = this.colour.droneBody;
    ctx.lineWidth = Math.max(3, r * 0.2);
    ctx.lineCap = 'round';
    ctx.beginPath();
    for (const [x, y] of [[1, 1], [1, -1]]) {
      ctx.moveTo(-x * r * 0.72, -y * r * 0.72);
      ctx.lineTo(x * r * 0.72, y * r * 0.72);
    }
    ctx.stroke();
    const turn = now / 60;
    for (const [i, [x, y]] of [[0.72, 0.72], [0.72, -0.72], [-0.72, 0.72], [-0.72, -0.72]].entries()) {
      ctx.save();
      ctx.translate(x * r, y * r);
      ctx.beginPath();
      ctx.arc(0, 0, r * 0.5, 0, TAU);
      ctx.fillStyle = ctx.strokeStyle = this.colour.drone;
      ctx.globalAlpha = s.armed ? 0.26 : 0.1;
      ctx.fill();
      ctx.globalAlpha = s.armed ? 0.85 : 0.5;
      ctx.lineWidth = 1.3;
      ctx.stroke();
      if (s.armed) {
        // Blades too fast to see: two bright arcs.
        ctx.rotate(i % 2 ? turn : -turn);
        ctx.globalAlpha = 0.75;
        ctx.lineWidth = r * 0.13;
        ctx.lineCap = 'butt';
        for (const from of [0, Math.PI]) {
          ctx.beginPath();
          ctx.arc(0, 0, r * 0.33, from, from + 0.9);
          ctx.stroke();
        }
      } else {
        ctx.rotate(i % 2 ? 0.7 : -0.5);
        ctx.lineWidth = r * 0.1;
        ctx.beginPath();
        ctx.moveTo(-r * 0.42, 0);
        ctx.lineTo(r * 0.42, 0);
        ctx.stroke();
      }
      ctx.restore();
    }
    // The nose.
    ctx.beginPath();
    ctx.moveTo(r * 1.35, 0);
    ctx.lineTo(r * 0.1, r * 0.36);
    ctx.lineTo(r * 0.34, 0);
    ctx.lineTo(r * 0.1, -r * 0.36);
    ctx.closePath();
    ctx.fillStyle = this.colour.drone;
    ctx.fill();
    ctx.beginPath();
    ctx.arc(0, 0, r * 0.26, 0, TAU);
    ctx.fillStyle = this.colour.droneBody;
    ctx.fill();
    ctx.restore();
    if (!s.knows_position) {
      ctx.font = '800 15px system-ui, sans-serif';
      ctx.textAlign = 'center';
      ctx.fillStyle = this.colour.blocked;
      ctx.fillText('?', p[0], p[1] - r * 1.5);
    }
  }

  #pulses(now) {
    const { ctx } = this;
    this.pulses = this.pulses.filter((p) => now - p.at < 900);
    for (const pulse of this.pulses) {
      const t = (now - pulse.at) / 900;
      const p = this.toScreen(pulse.x, pulse.y);
      ctx.strokeStyle = pulse.refused ? this.colour.blocked : this.colour.goal;
      ctx.globalAlpha = 1 - t;
      ctx.lineWidth = 2.5;
      ctx.beginPath();
      ctx.arc(p[0], p[1], 6 + 34 * t, 0, TAU);
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
  }

  /** Where a click would go. */
  #hover() {
    const { ctx } = this;
    if (!this.pointer || this.drag?.moved || !this.clickable) return;
    const [x, y] = this.toWorld(...this.pointer);
    const free = this.isFree(x, y);
    const p = this.pointer;
    ctx.strokeStyle = free ? this.colour.goal : this.colour.blocked;
    ctx.lineWidth = 1.5;
    ctx.globalAlpha = 0.9;
    ctx.beginPath();
    if (free) {
      ctx.arc(p[0], p[1], 9, 0, TAU);
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        ctx.moveTo(p[0] + dx * 5, p[1] + dy * 5);
        ctx.lineTo(p[0] + dx * 14, p[1] + dy * 14);
      }
    } else {
      ctx.moveTo(p[0] - 6, p[1] - 6);
      ctx.lineTo(p[0] + 6, p[1] + 6);
      ctx.moveTo(p[0] + 6, p[1] - 6);
      ctx.lineTo(p[0] - 6, p[1] + 6);
    }
    ctx.stroke();
    ctx.globalAlpha = 1;
  }

  #scale() {
    const { ctx } = this;
    const metres = [0.5, 1, 2, 5, 10, 20].find((m) => m * this.view.scale > 55) ?? 50;
    const w = metres * this.view.scale;
    const [x, y] = [this.width - 20 - w, this.height - 20];
    ctx.strokeStyle = ctx.fillStyle = this.colour.inkSoft;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.moveTo(x, y - 5);
    ctx.lineTo(x, y);
    ctx.lineTo(x + w, y);
    ctx.lineTo(x + w, y - 5);
    ctx.stroke();
    ctx.font = '500 11px system-ui, sans-serif';
    ctx.textAlign = 'center';
    ctx.textBaseline = 'alphabetic';
    ctx.fillText(`${metres} m`, x + w / 2, y - 6);
  }
}

function arms(yaw) {
  return [0.25, 0.75, 1.25, 1.75].map((q) => [Math.cos(-yaw + q * Math.PI) * 1.02, Math.sin(-yaw + q * Math.PI) * 1.02]);
}

function toSegment([px, py], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const t = Math.max(0, Math.min(1, ((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(px - ax - t * dx, py - ay - t * dy);
}
