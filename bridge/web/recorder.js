// The last minutes of everything the plan shows, to look at again, to save and to open later.
//
// A recording is what the socket sent: the compact telemetry, message by message. File: `KREC1`, a line of JSON (names of the state's
// numbers, modes, plan), then each message with its u32 length.

import { h, icon, put, toggle } from './dom.js';
import { take } from './telemetry.js';
import { t } from './words.js';

const MAGIC = 'KREC1\n';
const BYTES = 24e6;
const TOPICS = 6;
const STATE = 1;

const timeOf = (buffer) => Number(new DataView(buffer).getBigUint64(1, true)) * 1e-6;

export class Recording {
  constructor(about) {
    this.about = about;
    this.topics = Array.from({ length: TOPICS + 1 }, () => ({ times: [], buffers: [] }));
    this.bytes = 0;
  }

  add(buffer) {
    const topic = new Uint8Array(buffer, 0, 1)[0];
    if (topic < 1 || topic > TOPICS) return;
    const { times, buffers } = this.topics[topic];
    const at = timeOf(buffer);
    // The drone was started anew: another recording.
    if (times.length && at < times[times.length - 1] - 1) this.clear();
    times.push(at);
    buffers.push(buffer);
    this.bytes += buffer.byteLength;
    if (this.bytes > BYTES) this.#forget();
  }

  clear() {
    for (const topic of this.topics) { topic.times.length = 0; topic.buffers.length = 0; }
    this.bytes = 0;
  }

  #forget() {
    const until = this.from + (this.to - this.from) * 0.1;
    for (const topic of this.topics) {
      const n = after(topic.times, until);
      for (const gone of topic.buffers.splice(0, n)) this.bytes -= gone.byteLength;
      topic.times.splice(0, n);
    }
  }

  get from() { return this.topics[STATE].times[0] ?? 0; }
  get to() { return this.topics[STATE].times.at(-1) ?? 0; }

  /** Everything as it was. */
  at(time) {
    const vehicle = {};
    for (const { times, buffers } of this.topics) {
      const n = after(times, time);
      if (n > 0) take(buffers[n - 1], vehicle, this.about.state);
    }
    return vehicle;
  }

  /** Where it had flown by then. */
  path(time) {
    const { times, buffers } = this.topics[STATE];
    const field = (name) => 9 + 4 * this.about.state.indexOf(name);
    const [x, y, armed, jumps] = ['x', 'y', 'armed', 'jumps'].map(field);
    const out = [];
    let gap = true;
    for (let i = 0, n = after(times, time); i < n; i += 2) {
      const view = new DataView(buffers[i]);
      if (!view.getFloat32(armed, true)) { gap = true; continue; }
      const p = { x: view.getFloat32(x, true), y: view.getFloat32(y, true), jumps: view.getFloat32(jumps, true), gap };
      const last = out[out.length - 1];
      if (last && !gap && Math.hypot(p.x - last.x, p.y - last.y) < 0.04) continue;
      p.gap = gap || (last && last.jumps !== p.jumps);
      out.push(p);
      gap = false;
    }
    return out;
  }

  file() {
    const parts = [MAGIC, `${JSON.stringify(this.about)}\n`];
    const all = this.topics.flatMap(({ times, buffers }) => buffers.map((b, i) => [times[i], b])).sort((a, b) => a[0] - b[0]);
    for (const [, buffer] of all) parts.push(new Uint32Array([buffer.byteLength]), buffer);
    return new Blob(parts, { type: 'application/octet-stream' });
  }

  static async open(file) {
    const bytes = new Uint8Array(await file.arrayBuffer());
    const text = new TextDecoder();
    if (text.decode(bytes.subarray(0, MAGIC.length)) !== MAGIC) throw new Error(t('not_a_recording'));
    const end = bytes.indexOf(10, MAGIC.length);
    const recording = new Recording(JSON.parse(text.decode(bytes.subarray(MAGIC.length, end))));
    const view = new DataView(bytes.buffer);
    for (let at = end + 1; at + 4 <= bytes.length;) {
      const length = view.getUint32(at, true);
      at += 4;
      // A file that was cut off ends with its last whole message.
      if (length < 9 || at + length > bytes.length) break;
      recording.add(bytes.slice(at, at + length).buffer);
      at += length;
    }
    if (!recording.to) throw new Error(t('not_a_recording'));
    return recording;
  }
}

/** Number of times that are not later. */
function after(times, time) {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle + 1; else high = middle;
  }
  return low;
}

/** The bar below the plan: live, or some time ago. */
export function timeBar(app) {
  const { view, link, vehicle } = app;
  let live = new Recording({ state: [] });
  let shown = live;
  let at = null;
  let playing = false;
  let last = 0;
  const livePath = { path: view.path, plan: null };
  const slider = h('input', { type: 'range', min: 0, max: 1, step: 'any', value: 1, 'aria-label': t('replay'), oninput: () => seek(Number(slider.value)) });
  const label = h('span.clock');
  const liveButton = h('button.button.small.live', { onclick: goLive }, h('i'), t('live'));
  const play = h('button.tool', { title: t('play'), 'aria-label': t('play'), onclick: () => { playing = !playing; if (at === null) seek(shown.from); draw(); } });
  const file = h('input', { type: 'file', accept: '.krec', className: 'hidden', onchange: load });
  const el = h('div.card-float.timebar', liveButton, play, slider, label,
    h('button.tool', { title: t('save_recording'), 'aria-label': t('save_recording'), onclick: save }, icon('down', 16)),
    h('button.tool', { title: t('open_recording'), 'aria-label': t('open_recording'), onclick: () => file.click() }, icon('upload', 16)), file);

  link.addEventListener('opened', (e) => { live.about = { state: e.detail.state, modes: e.detail.modes, reasons: e.detail.reasons }; });
  link.addEventListener('raw', (e) => live.add(e.detail));

  function seek(time) {
    if (shown === live && time >= live.to - 0.3) return goLive();
    if (at === null) livePath.path = view.path;
    at = Math.max(shown.from, Math.min(shown.to, time));
    app.replay = shown.at(at);
    view.vehicle = app.replay;
    view.path = shown.path(at);
    draw();
  }

  function goLive() {
    playing = false;
    if (at !== null) {
      if (livePath.plan) { view.plan = livePath.plan; view.base = null; livePath.plan = null; }
      view.path = livePath.path;
    }
    [at, shown, app.replay, view.vehicle] = [null, live, null, vehicle];
    draw();
  }

  function save() {
    live.about.plan = app.plan;
    const a = h('a', { href: URL.createObjectURL(live.file()), download: `kestrel-${new Date().toISOString().slice(0, 19).replace(/:/g, '-')}.krec` });
    a.click();
    setTimeout(() => URL.revokeObjectURL(a.href), 10000);
  }

  async function load() {
    const [chosen] = file.files;
    file.value = '';
    if (!chosen) return;
    try { await openFile(chosen); } catch (e) { app.tell('bad', e.message); }
  }

  async function openFile(chosen) {
    const recording = await Recording.open(chosen);
    goLive();
    shown = recording;
    livePath.path = view.path;
    if (recording.about.plan) { livePath.plan = view.plan; view.plan = recording.about.plan; view.base = null; }
    seek(recording.from);
    playing = true;
    draw();
  }

  function draw() {
    const replaying = at !== null;
    toggle(el.parentElement ?? el, 'replay', replaying);
    toggle(liveButton, 'on', !replaying);
    play.replaceChildren(icon(playing ? 'hold' : 'play', 16));
    slider.min = shown.from;
    slider.max = Math.max(shown.to, shown.from + 0.1);
    if (document.activeElement !== slider || playing || !replaying) slider.value = replaying ? at : shown.to;
    const s = replaying ? at - (shown === live ? shown.to : shown.from) : 0;
    put(label, replaying ? `${s < 0 ? '−' : ''}${Math.floor(Math.abs(s) / 60)}:${String(Math.floor(Math.abs(s) % 60)).padStart(2, '0')}` : '');
  }

  return {
    el,
    tick(now) {
      if (playing && at !== null) {
        const next = at + Math.min(0.2, (now - last) / 1000);
        if (next >= shown.to) { playing = false; if (shown === live) goLive(); }
        if (at !== null) seek(Math.min(next, shown.to));
      } else draw();
      last = now;
    },
    recording: () => live,
    shown: () => shown,
    open: openFile,
    seek,
    goLive,
  };
}
