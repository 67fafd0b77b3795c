// Attitude and numbers, in a corner of the plan.

import { h, num, put } from './dom.js';
import { t } from './words.js';

const SIZE = 84;

export function hud() {
  const ratio = window.devicePixelRatio || 1;
  const canvas = h('canvas', { width: SIZE * ratio, height: SIZE * ratio, 'aria-hidden': 'true' });
  const cells = {};
  const cell = (key) => [h('dt', t(key)), (cells[key] = h('dd')), (cells[`${key}2`] = h('dd.sub'))];
  const el = h('div.card-float.hud', canvas, h('dl', cell('height'), cell('speed'), cell('heading'), cell('position')));
  cells.position.classList.add('pair');
  const number = (dd, value, unit) => {
    if (dd.dataset.v === value) return;
    dd.dataset.v = value;
    dd.replaceChildren(value, h('small', unit));
  };

  function update(s, north) {
    number(cells.height, num(s.height, 2), 'm');
    put(cells.height2, `${s.vz >= 0 ? '↑' : '↓'} ${num(Math.abs(s.vz), 2)} m/s`);
    number(cells.speed, num(Math.hypot(s.vx, s.vy), 2), 'm/s');
    put(cells.speed2, `→ ${num(Math.hypot(s.want_vx, s.want_vy), 2)}`);
    const heading = (((north - s.yaw) * 180) / Math.PI + 720) % 360;
    number(cells.heading, num(heading, 0), '°');
    put(cells.heading2, `± ${num((s.std_yaw * 180) / Math.PI, 1)}°`);
    number(cells.position, `${num(s.x, 2)}  ${num(s.y, 2)}`, 'm');
    put(cells.position2, `± ${num(Math.max(s.std_n, s.std_e), 2)} m`);
    draw(s);
  }

  function draw(s) {
    const c = canvas.getContext('2d');
    const r = SIZE / 2;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, SIZE, SIZE);
    c.save();
    c.beginPath();
    c.arc(r, r, r, 0, 2 * Math.PI);
    c.clip();
    c.translate(r, r);
    c.rotate(-s.roll);
    // Ten degrees are a fifth of the disc.
    const dy = ((s.pitch * 180) / Math.PI) * (SIZE / 50);
    c.translate(0, dy);
    const sky = c.createLinearGradient(0, -r, 0, 0);
    sky.addColorStop(0, '#2c5f94');
    sky.addColorStop(1, '#5b9bd0');
    c.fillStyle = sky;
    c.fillRect(-2 * SIZE, -2 * SIZE, 4 * SIZE, 2 * SIZE);
    const ground = c.createLinearGradient(0, 0, 0, r);
    ground.addColorStop(0, '#9a6a3a');
    ground.addColorStop(1, '#5d3d1e');
    c.fillStyle = ground;
    c.fillRect(-2 * SIZE, 0, 4 * SIZE, 2 * SIZE);
    c.strokeStyle = 'rgba(255,255,255,.85)';
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(-SIZE, 0);
    c.lineTo(SIZE, 0);
    for (const deg of [-20, -10, 10, 20]) {
      const y = -deg * (SIZE / 50);
      const w = deg % 20 ? 9 : 14;
      c.moveTo(-w, y);
      c.lineTo(w, y);
    }
    c.stroke();
    c.restore();
    c.strokeStyle = '#ffd08a';
    c.lineWidth = 2.5;
    c.lineCap = 'round';
    c.beginPath();
    c.moveTo(r - 24, r);
    c.lineTo(r - 10, r);
    c.lineTo(r - 5, r + 5);
    c.moveTo(r + 24, r);
    c.lineTo(r + 10, r);
    c.lineTo(r + 5, r + 5);
    c.stroke();
  }
  return { el, update };
}
