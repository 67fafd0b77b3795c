// The page as a ground station: heartbeat, commands that are repeated until answered, parameters, missions.

import { CMD, PX4 } from './mavlink.js';

const RESULTS = ['accepted', 'not now', 'denied', 'unsupported', 'failed', 'in progress', 'cancelled', 'long only', 'int only', 'frame', 'not in control'];
const REPEAT_MS = 700;
const TRIES = 3;

export class Station extends EventTarget {
  constructor(link) {
    super();
    this.link = link;
    this.waiting = new Map();
    this.params = new Map();
    this.paramCount = 0;
    this.partial = new Map();
    link.addEventListener('message', (e) => this.#hear(e.detail));
    link.addEventListener('opened', () => this.#opened());
    link.addEventListener('closed', () => this.#closed());
    setInterval(() => this.beat(), 1000);
  }

  get #to() {
    return { target_system: this.link.target.system, target_component: this.link.target.component };
  }

  beat() {
    this.link.send('HEARTBEAT', { type: 6, autopilot: 8, system_status: 4, mavlink_version: 3 });
  }

  /** Asks until answered; resolves with {ok, result, words}. Never across a lost link. */
  command(command, params = [], place = null) {
    this.waiting.get(command)?.done({ ok: false, result: 6, words: 'replaced' });
    return new Promise((resolve) => {
      let tries = 0;
      const fill = (i) => (params[i] === undefined ? NaN : params[i]);
      const attempt = () => {
        if (tries++ >= TRIES) return done({ ok: false, result: -1, words: 'no answer' });
        const sent = place
          ? this.link.send('COMMAND_INT', { ...this.#to, command, frame: place.frame, param1: fill(0), param2: fill(1), param3: fill(2), param4: fill(3), x: place.x, y: place.y, z: place.z })
          : this.link.send('COMMAND_LONG', { ...this.#to, command, confirmation: tries - 1, param1: fill(0), param2: fill(1), param3: fill(2), param4: fill(3), param5: fill(4), param6: fill(5), param7: fill(6) });
        if (!sent) return done({ ok: false, result: -1, words: 'no link' });
        entry.timer = setTimeout(attempt, REPEAT_MS);
      };
      const done = (outcome) => {
        clearTimeout(entry.timer);
        if (this.waiting.get(command) === entry) this.waiting.delete(command);
        resolve(outcome);
      };
      const entry = { done, timer: 0, later: () => { clearTimeout(entry.timer); entry.timer = setTimeout(() => done({ ok: false, result: -1, words: 'no answer' }), 11000); } };
      this.waiting.set(command, entry);
      attempt();
    });
  }

  arm() { return this.command(CMD.ARM, [1, 0]); }
  disarm() { return this.command(CMD.ARM, [0, 0]); }
  takeOff() { return this.command(CMD.TAKEOFF, [NaN, NaN, NaN, NaN, NaN, NaN, NaN]); }
  land() { return this.command(CMD.LAND, [NaN, NaN, NaN, NaN, NaN, NaN, NaN]); }
  returnHome() { return this.command(CMD.RETURN); }
  stop() {
    // Twice at once: one lost message must not matter.
    this.link.send('COMMAND_LONG', { ...this.#to, command: CMD.PAUSE, param1: 0 });
    return this.link.isOpen;
  }
  setMode(name) { return this.command(CMD.SET_MODE, [1, ...PX4[name]]); }
  goTo(north, east) {
    return this.command(CMD.REPOSITION, [-1, 1, NaN, NaN], { frame: 1, x: Math.round(north * 1e4), y: Math.round(east * 1e4), z: NaN });
  }
  takeControl(open = false) { return this.command(CMD.CONTROL, [1, open ? 1 : 0, 10, this.link.system]); }
  releaseControl() { return this.command(CMD.CONTROL, [0, 0, 10, this.link.system]); }
  /** Lets the one who asks have control. */
  handOver() { return this.command(CMD.CONTROL, [0, 0, 10, this.link.system]); }
  startMission() { return this.command(CMD.MISSION_START, [0, 0]); }

  sticks(x, y, z, r, buttons = 0) {
    const i = (v) => Math.round(Math.max(-1, Math.min(1, v)) * 1000);
    return this.link.send('MANUAL_CONTROL', { target: this.link.target.system, x: i(x), y: i(y), z: Math.round(Math.max(0, Math.min(1, z)) * 1000), r: i(r), buttons });
  }

  // ---- parameters

  loadParams() {
    this.link.send('PARAM_REQUEST_LIST', this.#to);
    clearTimeout(this.paramTimer);
    this.paramTimer = setTimeout(() => this.#missingParams(), 1500);
  }

  #missingParams(tries = 0) {
    if (!this.paramCount || this.params.size >= this.paramCount || tries > 8) return;
    const have = new Set([...this.params.values()].map((p) => p.index));
    let asked = 0;
    for (let i = 0; i < this.paramCount && asked < 24; i++) {
      if (have.has(i)) continue;
      asked++;
      this.link.send('PARAM_REQUEST_READ', { ...this.#to, param_id: '', param_index: i });
    }
    this.paramTimer = setTimeout(() => this.#missingParams(tries + 1), 500);
  }

  /** Reads some parameters by name; resolves when they are there, or after a second. */
  async read(names) {
    for (let tries = 0; tries < 5 && names.some((n) => !this.params.has(n)); tries++) {
      for (const n of names) if (!this.params.has(n)) this.link.send('PARAM_REQUEST_READ', { ...this.#to, param_id: n, param_index: -1 });
      await new Promise((r) => setTimeout(r, 200));
    }
  }

  setParam(name, value) {
    const p = this.params.get(name);
    this.link.send('PARAM_SET', { ...this.#to, param_id: name, param_value: encodeParam(value, p.type), param_type: p.type });
  }

  // ---- missions

  /** Uploads items [{command, ...}]; resolves with {ok, words}. */
  upload(items) {
    this.job?.done({ ok: false, words: 'replaced' });
    return new Promise((resolve) => {
      let tries = 0;
      const done = (outcome) => { clearTimeout(this.job?.timer); this.job = null; resolve(outcome); };
      const begin = () => {
        if (tries++ > 4) return done({ ok: false, words: 'no answer' });
        if (!this.link.send('MISSION_COUNT', { ...this.#to, count: items.length, mission_type: 0 })) return done({ ok: false, words: 'no link' });
        this.job.timer = setTimeout(begin, 1000);
      };
      this.job = { kind: 'up', items, done, timer: 0, alive: () => { clearTimeout(this.job.timer); this.job.timer = setTimeout(() => done({ ok: false, words: 'no answer' }), 3000); } };
      begin();
    });
  }

  /** The mission on board. */
  download(type = 0) {
    this.job?.done({ ok: false, words: 'replaced' });
    return new Promise((resolve) => {
      let tries = 0;
      const done = (outcome) => { clearTimeout(this.job?.timer); this.job = null; resolve(outcome); };
      const begin = () => {
        if (tries++ > 4) return done({ ok: false, words: 'no answer' });
        if (this.job.count !== undefined) this.link.send('MISSION_REQUEST_INT', { ...this.#to, seq: this.job.items.length, mission_type: type });
        else if (!this.link.send('MISSION_REQUEST_LIST', { ...this.#to, mission_type: type })) return done({ ok: false, words: 'no link' });
        this.job.timer = setTimeout(begin, 800);
      };
      this.job = { kind: 'down', type, items: [], done, begin, timer: 0, progress: () => { tries = 0; clearTimeout(this.job.timer); begin(); } };
      begin();
    });
  }

  #opened() {
    this.beat();
    // The compact telemetry says it better: what comes ten times a second is told to rest.
    for (const id of [30, 31, 32, 33, 85, 83, 74, 132, 331, 105, 36, 35, 65, 141, 230, 24, 116, 26, 106, 340]) {
      this.link.send('COMMAND_LONG', { ...this.#to, command: CMD.SET_INTERVAL, param1: id, param2: -1 });
    }
  }

  #closed() {
    for (const entry of [...this.waiting.values()]) entry.done({ ok: false, result: -1, words: 'no link' });
    this.job?.done({ ok: false, words: 'no link' });
  }

  #hear(m) {
    if (m.system !== this.link.target.system) return;
    switch (m.name) {
      case 'COMMAND_ACK': {
        if (m.target_system && m.target_system !== this.link.system) return;
        const entry = this.waiting.get(m.command);
        if (!entry) return;
        if (m.result === 5) entry.later();
        else entry.done({ ok: m.result === 0, result: m.result, words: RESULTS[m.result] ?? String(m.result) });
        return;
      }
      case 'COMMAND_LONG':
        if (m.command === CMD.CONTROL) this.dispatchEvent(new CustomEvent('asked', { detail: m.param4 }));
        return;
      case 'STATUSTEXT': return this.#text(m);
      case 'PARAM_VALUE': {
        this.paramCount = Math.max(this.paramCount, m.param_count);
        const index = m.param_index === 65535 ? this.params.get(m.param_id)?.index ?? 65535 : m.param_index;
        this.params.set(m.param_id, { name: m.param_id, type: m.param_type, index, value: decodeParam(m.param_value, m.param_type) });
        this.dispatchEvent(new CustomEvent('param', { detail: m.param_id }));
        return;
      }
      case 'MISSION_REQUEST_INT':
      case 'MISSION_REQUEST': {
        if (m.target_system !== this.link.system || this.job?.kind !== 'up') return;
        const item = this.job.items[m.seq];
        if (!item) return;
        this.job.alive();
        this.link.send('MISSION_ITEM_INT', { ...this.#to, seq: m.seq, autocontinue: 1, mission_type: 0, param1: 0, param2: 0, param3: 0, param4: NaN, x: 0, y: 0, z: 0, ...item });
        return;
      }
      case 'MISSION_ACK':
        if (m.target_system === this.link.system && this.job?.kind === 'up') this.job.done({ ok: m.type === 0, words: m.type === 0 ? 'accepted' : `refused (${m.type})` });
        return;
      case 'MISSION_COUNT':
        if (m.target_system !== this.link.system || this.job?.kind !== 'down' || m.mission_type !== this.job.type) return;
        this.job.count = m.count;
        if (m.count === 0) this.job.done({ ok: true, items: [] });
        else if (this.job.items.length === 0) this.job.progress();
        return;
      case 'MISSION_ITEM_INT': {
        const job = this.job;
        if (m.target_system !== this.link.system || job?.kind !== 'down' || m.seq !== job.items.length) return;
        job.items.push(m);
        if (job.items.length < job.count) job.progress();
        else {
          this.link.send('MISSION_ACK', { ...this.#to, type: 0, mission_type: job.type });
          job.done({ ok: true, items: job.items });
        }
        return;
      }
      case 'MISSION_ITEM_REACHED':
        this.dispatchEvent(new CustomEvent('reached', { detail: m.seq }));
    }
  }

  #text(m) {
    let text = m.text;
    if (m.id) {
      const parts = this.partial.get(m.id) ?? [];
      parts[m.chunk_seq] = m.text;
      this.partial.set(m.id, parts);
      if (m.text.length === 50) return;
      text = parts.join('');
      this.partial.delete(m.id);
    }
    this.dispatchEvent(new CustomEvent('text', { detail: { severity: m.severity, text } }));
  }
}

// Parameters are bytes in a float: whole numbers by their bits (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE).
const scratch = new DataView(new ArrayBuffer(4));
const WHOLE = { 1: ['Uint8'], 2: ['Int8'], 3: ['Uint16'], 4: ['Int16'], 5: ['Uint32'], 6: ['Int32'] };

function decodeParam(value, type) {
  if (!WHOLE[type]) return value;
  scratch.setFloat32(0, value, true);
  return scratch[`get${WHOLE[type][0]}`](0, true);
}

function encodeParam(value, type) {
  if (!WHOLE[type]) return value;
  scratch.setUint32(0, 0, true);
  scratch[`set${WHOLE[type][0]}`](0, Math.round(value), true);
  return scratch.getFloat32(0, true);
}
