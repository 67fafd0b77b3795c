// Sticks: a gamepad or a transmitter as a joystick, mapped, shown, and let go of whenever anything is doubtful.
//
// Frames go out only while the page is visible and has focus, the pad is there and fresh, and we have control. Everything else is
// one release: centred sticks, then silence. The bridge centres them too if we cannot say so any more.

import { h, icon, put, toggle } from './dom.js';
import { ask } from './fly.js';
import { t } from './words.js';

const HZ = 50;
/** A pad that reports nothing new for this long while deflected has frozen. */
const FROZEN_MS = 2000;

/** Axis of the pad for forward, right, up, turn; negative sign: turned round. Standard pads: 0/1 left x/y, 2/3 right x/y. */
const PRESETS = {
  'Mode 2': { x: [3, -1], y: [2, 1], z: [1, -1], r: [0, 1] },
  'Mode 1': { x: [1, -1], y: [2, 1], z: [3, -1], r: [0, 1] },
  'Mode 3': { x: [1, -1], y: [0, 1], z: [3, -1], r: [2, 1] },
  // A transmitter over USB: throttle, aileron, elevator, rudder, then the arm switch.
  'TAER': { x: [2, 1], y: [1, 1], z: [0, 1], r: [3, 1], arm: 4 },
  'AETR': { x: [1, 1], y: [0, 1], z: [2, 1], r: [3, 1], arm: 4 },
};
/** Buttons of a standard pad. */
const BUTTONS = { stop: 1, land: 0, takeoff: 3, hold: 2 };
const KEYS = ['x', 'y', 'z', 'r'];

export function shape(v, deadZone, expo) {
  const a = Math.abs(v);
  if (!(a > deadZone)) return 0;
  const u = Math.min(1, (a - deadZone) / (1 - deadZone));
  return Math.sign(v) * ((1 - expo) * u + expo * u ** 3);
}

export class Sticks {
  constructor(app) {
    this.app = app;
    this.live = false;
    this.index = null;
    this.values = { x: 0, y: 0, z: 0, r: 0 };
    this.saw = { stamp: -1, at: 0, text: '' };
    this.pressed = new Set();
    const kept = JSON.parse(localStorage.getItem('sticks') || '{}');
    this.preset = PRESETS[kept.preset] ? kept.preset : 'Mode 2';
    this.deadZone = kept.deadZone ?? 0.06;
    this.expo = kept.expo ?? 0.35;
    addEventListener('gamepadconnected', (e) => { this.index = e.gamepad.index; this.#arm(); });
    addEventListener('gamepaddisconnected', (e) => { if (this.index === null || e.gamepad.index === this.index) { this.release('pad_lost'); this.index = null; } });
    addEventListener('blur', () => this.release('unfocused'));
    document.addEventListener('visibilitychange', () => { if (document.visibilityState !== 'visible') this.release('unfocused'); });
    addEventListener('pagehide', () => this.release());
    app.link.addEventListener('control', (e) => { if (!e.detail.owner?.you) this.release(); });
    setInterval(() => this.#step(), 1000 / HZ);
  }

  keep() {
    localStorage.setItem('sticks', JSON.stringify({ preset: this.preset, deadZone: this.deadZone, expo: this.expo }));
    this.#arm();
  }

  get pad() {
    return this.index === null ? null : navigator.getGamepads()[this.index];
  }

  /** Throttle is believed only after it was seen centred. */
  #arm() {
    this.trusted = false;
  }

  toggle() {
    if (this.live) return this.release();
    this.app.showSticks?.(true);
    if (!this.pad) return this.app.tell('info', t('no_pad'));
    if (!this.app.vehicle.control?.owner?.you) return this.app.tell('warn', t('need_control'));
    this.live = true;
    this.#arm();
    const mode = this.app.modes[this.app.vehicle.state?.mode];
    if (!['Position', 'Altitude', 'Stabilized'].includes(mode)) ask(this.app, t('m_Position'), this.app.station.setMode('Position'));
  }

  /** One centred frame, then nothing. */
  release(why) {
    if (!this.live) return;
    this.live = false;
    this.app.station.sticks(0, 0, 0.5, 0);
    if (why) this.app.tell('warn', t(why));
  }

  #step() {
    const pad = this.pad;
    if (!pad?.connected) { if (this.live) this.release('pad_lost'); return; }
    const map = PRESETS[this.preset];
    for (const key of KEYS) {
      const [axis, sign] = map[key];
      this.values[key] = shape(sign * (pad.axes[axis] ?? 0), this.deadZone, this.expo);
    }
    this.#buttons(pad);
    if (!this.live) return;
    if (document.visibilityState !== 'visible' || !document.hasFocus()) return this.release('unfocused');
    // Fresh: the stamp or anything in it has changed.
    const now = performance.now();
    const text = pad.axes.join();
    if (pad.timestamp !== this.saw.stamp || text !== this.saw.text) this.saw = { stamp: pad.timestamp, text, at: now };
    const deflected = KEYS.some((k) => this.values[k] !== 0);
    if (deflected && now - this.saw.at > FROZEN_MS) return this.release('pad_frozen');
    if (!this.trusted) this.trusted = this.values.z === 0;
    const { x, y, z, r } = this.values;
    this.app.station.sticks(x, y, this.trusted ? (z + 1) / 2 : 0.5, r);
  }

  /** A button acts when it goes down, never because it was held while nobody looked. */
  #buttons(pad) {
    const watched = document.visibilityState === 'visible' && document.hasFocus();
    for (const [name, i] of Object.entries(BUTTONS)) {
      const down = !!pad.buttons[i]?.pressed;
      const was = this.pressed.has(name);
      if (down) this.pressed.add(name); else this.pressed.delete(name);
      if (!down || was || !watched) continue;
      if (name === 'stop') this.app.halt();
      else if (this.live) ask(this.app, t(name), { land: () => this.app.station.land(), takeoff: () => this.app.station.takeOff(), hold: () => { this.release(); return this.app.station.setMode('Hold'); } }[name]());
    }
  }
}

/** The card under the buttons: which pad, which mapping, where the sticks are. */
export function sticksCard(app, el) {
  const sticks = (app.sticks = new Sticks(app));
  const ratio = window.devicePixelRatio || 1;
  const canvases = [h('canvas'), h('canvas')];
  const name = h('span.soft', { style: { overflow: 'hidden', 'text-overflow': 'ellipsis', 'white-space': 'nowrap', flex: 1 } });
  const live = h('button.button.small', { onclick: () => sticks.toggle() });
  const preset = h('select.input.small', { 'aria-label': t('preset'), onchange: () => { sticks.preset = preset.value; sticks.keep(); } }, Object.keys(PRESETS).map((p) => h('option', { selected: p === sticks.preset }, p)));
  const range = (key, max) => h('label.field', t(key === 'deadZone' ? 'dead_zone' : key), h('input', { type: 'range', min: 0, max, step: 0.01, value: sticks[key], oninput: (e) => { sticks[key] = Number(e.target.value); sticks.keep(); } }));
  const hint = h('div.warn');
  el.replaceChildren(h('h2', icon('pad', 15), t('sticks'), h('span.spread'), live), h('div.row', name, preset),
    h('div.stickbox', { style: { margin: '10px 0' } }, canvases), hint, h('div.grid2', range('deadZone', 0.3), range('expo', 0.9)));
  let shown = false;
  app.showSticks = (on) => { shown = on; };

  return {
    update() {
      toggle(el, 'hidden', !shown && !sticks.pad);
      const pad = sticks.pad;
      put(name, pad ? pad.id.replace(/\(.*\)/, '').trim() : t('no_pad'));
      put(live, t(sticks.live ? 'pad_on' : 'use_pad'));
      toggle(live, 'primary', sticks.live);
      live.disabled = !pad;
      put(hint, sticks.live && !sticks.trusted ? t('throttle_first') : '');
    },
    draw() {
      if (!el.isConnected || el.classList.contains('hidden')) return;
      const css = getComputedStyle(document.documentElement);
      const v = sticks.values;
      const pairs = { 'Mode 1': [[v.r, v.x], [v.y, v.z]], 'Mode 3': [[v.y, v.x], [v.r, v.z]] }[sticks.preset] ?? [[v.r, v.z], [v.y, v.x]];
      canvases.forEach((canvas, i) => {
        const size = canvas.clientWidth;
        if (!size) return;
        if (canvas.width !== Math.round(size * ratio)) canvas.width = canvas.height = Math.round(size * ratio);
        const c = canvas.getContext('2d');
        c.setTransform(ratio, 0, 0, ratio, 0, 0);
        c.clearRect(0, 0, size, size);
        const [m, r] = [size / 2, size / 2 - 16];
        c.strokeStyle = css.getPropertyValue('--line');
        c.beginPath();
        c.moveTo(m, 10); c.lineTo(m, size - 10); c.moveTo(10, m); c.lineTo(size - 10, m);
        c.stroke();
        c.fillStyle = css.getPropertyValue(sticks.live ? '--accent' : '--ink-faint');
        c.beginPath();
        c.arc(m + pairs[i][0] * r, m - pairs[i][1] * r, 10, 0, 2 * Math.PI);
        c.fill();
      });
    },
  };
}
