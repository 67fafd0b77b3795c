// Strip charts: a minute of what is drawn most often. Our own: one canvas each, nothing kept but a ring of numbers.

import { h, icon, num } from './dom.js';
import { t } from './words.js';

const SECONDS = 60;
const HZ = 10;
const SIZE = SECONDS * HZ;

const CHARTS = [
  ['c_height', [['c_z', 'good', (s) => s.z]], 0.5],
  ['c_speed', [['', 'accent', (s) => Math.hypot(s.vx, s.vy)], ['', 'ink-faint', (s) => Math.hypot(s.want_vx, s.want_vy)]], 0.4],
  ['c_tilt', [['c_roll', 'info', (s) => (s.roll * 180) / Math.PI], ['c_pitch', 'warn', (s) => (s.pitch * 180) / Math.PI]], 6],
  ['c_sigma', [['', 'waypoint', (s) => Math.max(s.std_n, s.std_e)]], 0.1],
  ['c_battery', [['', 'good', (s) => s.volts]], 0.6],
  ['c_link', [['', 'info', (_, app) => app.link.latency]], 20],
];

export function chartsPane(app) {
  const rings = CHARTS.map(([, lines]) => lines.map(() => new Float32Array(SIZE).fill(NaN)));
  let at = 0;
  let frozen = false;
  let cursor = null;
  const ratio = window.devicePixelRatio || 1;
  const freeze = h('button.button.small', { 'aria-pressed': 'false', onclick: () => { frozen = !frozen; freeze.setAttribute('aria-pressed', frozen); } }, icon('hold', 14), t('freeze'));
  const cards = CHARTS.map(([name, lines]) => {
    const canvas = h('canvas.chart');
    const legend = h('span', { className: 'faint' });
    canvas.addEventListener('pointermove', (e) => { cursor = e.offsetX / canvas.clientWidth; });
    canvas.addEventListener('pointerleave', () => { cursor = null; });
    return { canvas, legend, el: h('section.card', h('h2', t(name), h('span.spread'), legend), canvas), lines };
  });
  const el = h('div.pane', { role: 'tabpanel' }, h('div.row.full', h('span.spread'), freeze), cards.map((c) => c.el));

  setInterval(() => {
    const s = app.vehicle.state;
    if (!s || frozen || !app.link.isOpen) return;
    CHARTS.forEach(([, lines], i) => lines.forEach(([, , read], k) => { rings[i][k][at] = read(s, app); }));
    at = (at + 1) % SIZE;
  }, 1000 / HZ);

  function draw() {
    const css = getComputedStyle(document.documentElement);
    const colour = (name) => css.getPropertyValue(`--${name}`);
    cards.forEach(({ canvas, legend, lines }, i) => {
      const [w, height] = [canvas.clientWidth, canvas.clientHeight];
      if (!w) return;
      if (canvas.width !== Math.round(w * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(height * ratio); }
      const c = canvas.getContext('2d');
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.clearRect(0, 0, w, height);
      let [low, high] = [Infinity, -Infinity];
      for (const ring of rings[i]) for (const v of ring) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
      if (low > high) return;
      const least = CHARTS[i][2];
      if (high - low < least) { const m = (high + low) / 2; low = m - least / 2; high = m + least / 2; }
      const step = nice((high - low) / 2);
      low = Math.floor(low / step) * step;
      high = Math.ceil(high / step) * step;
      const y = (v) => height - 6 - ((v - low) / (high - low)) * (height - 12);
      const left = 34;
      c.font = '10px system-ui, sans-serif';
      c.textAlign = 'right';
      c.textBaseline = 'middle';
      c.fillStyle = colour('ink-faint');
      c.strokeStyle = colour('line');
      c.lineWidth = 1;
      c.beginPath();
      for (let v = low; v <= high + step / 2; v += step) {
        c.fillText(num(v, step < 0.1 ? 2 : step < 1 ? 1 : 0), left - 6, y(v));
        c.moveTo(left, Math.round(y(v)) + 0.5);
        c.lineTo(w, Math.round(y(v)) + 0.5);
      }
      c.stroke();
      const read = cursor === null ? SIZE - 1 : Math.max(0, Math.min(SIZE - 1, Math.round(((cursor * w - left) / (w - left)) * (SIZE - 1))));
      const words = [];
      lines.forEach(([label, tone], k) => {
        const ring = rings[i][k];
        c.strokeStyle = colour(tone);
        c.lineWidth = 1.7;
        c.lineJoin = 'round';
        c.beginPath();
        let pen = false;
        for (let n = 0; n < SIZE; n++) {
          const v = ring[(at + n) % SIZE];
          if (!Number.isFinite(v)) { pen = false; continue; }
          const x = left + (n / (SIZE - 1)) * (w - left);
          if (pen) c.lineTo(x, y(v)); else c.moveTo(x, y(v));
          pen = true;
        }
        c.stroke();
        const v = ring[(at + read) % SIZE];
        if (label || k === 0) words.push(`${label && lines.length > 1 ? `${t(label)} ` : ''}${num(v, 2)}`);
      });
      if (cursor !== null) {
        const x = left + (read / (SIZE - 1)) * (w - left);
        c.strokeStyle = colour('ink-faint');
        c.beginPath();
        c.moveTo(x, 0);
        c.lineTo(x, height);
        c.stroke();
      }
      const text = words.join('   ');
      if (legend.textContent !== text) legend.textContent = text;
    });
  }
  let last = 0;
  return { el, draw: (now) => { if (now - last > 90) { last = now; draw(); } } };
}

function nice(v) {
  const p = 10 ** Math.floor(Math.log10(v));
  return [1, 2, 5, 10].find((k) => k * p >= v * 0.999) * p;
}
