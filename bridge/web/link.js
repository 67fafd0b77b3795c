// The socket: envelopes out, telemetry and frames in, a new try when it is lost. Nothing is kept to be sent later.

import { decode, Encoder } from './mavlink.js';
import { below } from './login.js';
import { ACK, acknowledgement, MAVLINK, take } from './telemetry.js';

const RETRY = [300, 600, 1200, 2500, 4000];
const HEADER = 20;

export class Link extends EventTarget {
  constructor(vehicle) {
    super();
    this.vehicle = vehicle;
    this.seq = 0;
    this.tries = 0;
    this.lease = 0n;
    this.latency = NaN;
    this.heard = 0;
    this.isOpen = false;
    this.fields = [];
    this.bytes = 0;
  }

  open() {
    const socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${below('/api/socket')}`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onmessage = (e) => this.#take(e.data);
    socket.onclose = (e) => {
      if (this.socket !== socket) return;
      const wasOpen = this.isOpen;
      this.isOpen = false;
      this.lease = 0n;
      this.latency = NaN;
      this.dispatchEvent(new CustomEvent('closed', { detail: { code: e.code, reason: e.reason, wasOpen } }));
      if (e.code === 4001) return;
      const wait = RETRY[Math.min(this.tries++, RETRY.length - 1)];
      this.timer = setTimeout(() => this.open(), wait);
    };
  }

  close() {
    clearTimeout(this.timer);
    const socket = this.socket;
    this.socket = null;
    this.isOpen = false;
    socket?.close();
  }

  /** Sends one message in an envelope; false if there is nowhere to send it. */
  send(name, values) {
    if (!this.isOpen || this.socket.readyState !== WebSocket.OPEN) return false;
    // A link that does not drain is no place for sticks or commands.
    if (this.socket.bufferedAmount > 4096 && name === 'MANUAL_CONTROL') return false;
    const frame = this.encoder.encode(name, values);
    const out = new Uint8Array(HEADER + frame.length);
    const view = new DataView(out.buffer);
    view.setBigUint64(0, this.lease, true);
    view.setUint32(8, ++this.seq, true);
    view.setFloat64(12, performance.now(), true);
    out.set(frame, HEADER);
    this.socket.send(out);
    return true;
  }

  /** The user did something: his session goes on. */
  touch() {
    if (this.isOpen) this.socket.send('{"touch":true}');
  }

  #take(data) {
    this.heard = performance.now();
    if (typeof data === 'string') {
      const said = JSON.parse(data);
      if (said.hello) {
        this.isOpen = true;
        this.tries = 0;
        this.seq = 0;
        this.fields = said.hello.state;
        this.target = said.hello.vehicle;
        this.system = said.hello.system;
        this.encoder = new Encoder(said.hello.system, said.hello.component);
        this.dispatchEvent(new CustomEvent('opened', { detail: said.hello }));
      }
      if (said.control) {
        this.lease = BigInt(said.control.owner?.lease ?? 0);
        this.vehicle.control = said.control;
        this.dispatchEvent(new CustomEvent('control', { detail: said.control }));
      }
      if ('blocked' in said) this.vehicle.blocked = said.blocked;
      return;
    }
    this.bytes += data.byteLength;
    const topic = take(data, this.vehicle, this.fields);
    if (topic === MAVLINK) {
      for (const message of decode(new Uint8Array(data, 9))) this.dispatchEvent(new CustomEvent('message', { detail: message }));
    } else if (topic === ACK) {
      const ack = acknowledgement(data);
      if (ack.verdict === 0) {
        const took = performance.now() - ack.sent;
        this.latency = Number.isFinite(this.latency) ? this.latency + 0.2 * (took - this.latency) : took;
      } else this.dispatchEvent(new CustomEvent('refused', { detail: ack.verdict }));
    } else {
      this.dispatchEvent(new CustomEvent('raw', { detail: data }));
      if (topic === 1) this.dispatchEvent(new Event('state'));
    }
  }
}
