// The camera's picture: a WebRTC session agreed on by the words of MAVLink Camera Manager, only while somebody looks.

import { h, icon, num, put, toggle } from './dom.js';
import { below } from './login.js';
import { t } from './words.js';

const RETRY = [500, 1000, 2000, 4000];
/** Without a new picture for this long it is called old, ms. */
const STALE = 1000;
/** A connection that does not come (back) is made anew after this, ms. */
const PATIENCE = 4000;
/** Blocks of the clock that the simulator writes into the top row: 32 of milliseconds, 8 of a check. */
const BLOCKS = 40;
const ROW = 8;

/** When a picture was taken, by the clock in its top row; null if it has none. */
export function readStamp(data, width) {
  const block = Math.floor(width / BLOCKS);
  const bytes = [0, 0, 0, 0, 0];
  for (let i = 0; i < BLOCKS; i++) {
    const at = 4 * ((ROW / 2) * width + i * block + (block >> 1));
    if (data[at + 1] > 126) bytes[i >> 3] |= 0x80 >> (i & 7);
  }
  const turn = (b, n) => ((b << n) | (b >> (8 - n))) & 0xff;
  const check = bytes[0] ^ turn(bytes[1], 1) ^ turn(bytes[2], 2) ^ turn(bytes[3], 3) ^ 0xa5;
  return check === bytes[4] ? ((bytes[0] << 24) | (bytes[1] << 16) | (bytes[2] << 8) | bytes[3]) >>> 0 : null;
}

/** A stream shown in a video element. Events: 'change'. */
export class Viewer extends EventTarget {
  constructor(video) {
    super();
    this.video = video;
    this.wanted = false;
    this.state = 'off';
    this.tries = 0;
    this.frames = 0;
    this.seen = -Infinity;
    this.firstFrame = null;
    video.addEventListener('resize', () => this.#become(this.state));
    const count = () => { this.frames++; this.seen = performance.now(); this.firstFrame ??= this.seen; if (this.state !== 'live') this.#become('live'); video.requestVideoFrameCallback(count); };
    video.requestVideoFrameCallback(count);
  }

  /** Starts or stops looking. */
  want(on) {
    if (this.absent) return;
    if (on === this.wanted) return;
    this.wanted = on;
    this.tries = 0;
    if (on) this.#open();
    else this.#close('off');
  }

  #become(state, why = '') {
    this.state = state;
    this.why = why;
    this.dispatchEvent(new Event('change'));
  }

  #close(state, why) {
    clearTimeout(this.timer);
    const { socket, pc } = this;
    this.socket = this.pc = null;
    if (socket) socket.onclose = null;
    socket?.close();
    pc?.close();
    this.video.srcObject = null;
    this.#become(state, why);
  }

  #again(state, why) {
    this.#close(state, why);
    if (this.wanted) this.timer = setTimeout(() => { if (this.video.isConnected) this.#open(); }, RETRY[Math.min(this.tries++, RETRY.length - 1)]);
  }

  #open() {
    const socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${below('/signal')}`);
    this.socket = socket;
    if (this.state !== 'none') this.#become('connecting');
    let consumer = '';
    const say = (type, kind, content) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ type, content: content ? { type: kind, content } : { type: kind } })); };
    socket.onopen = () => say('question', 'peerId');
    socket.onclose = () => this.#again(this.state === 'none' ? 'none' : 'connecting', this.why);
    socket.onmessage = async (e) => {
      const { type, content: { type: kind, content } } = JSON.parse(e.data);
      if (type === 'answer' && kind === 'peerId') { consumer = content.id; say('question', 'availableStreams'); }
      else if (type === 'answer' && kind === 'availableStreams') {
        this.stream = content[0];
        if (this.stream) say('question', 'startSession', { consumer_id: consumer, producer_id: this.stream.id });
        else this.#again('none');
      } else if (type === 'negotiation' && kind === 'mediaNegotiation') await this.#answer(content, say);
      else if (type === 'negotiation' && kind === 'iceNegotiation' && content.ice.candidate) this.pc?.addIceCandidate(content.ice).catch(() => {});
      else if (type === 'question' && kind === 'endSession') this.#again('connecting', content.reason);
    };
    this.timer = setTimeout(() => { if (this.pc?.connectionState !== 'connected') this.#again('connecting'); }, PATIENCE);
  }

  async #answer({ consumer_id, producer_id, session_id, sdp }, say) {
    this.pc?.close();
    const pc = new RTCPeerConnection();
    this.pc = pc;
    const ids = { consumer_id, producer_id, session_id };
    pc.ontrack = ({ receiver, track }) => {
      if ('jitterBufferTarget' in receiver) receiver.jitterBufferTarget = 0;
      this.video.srcObject = new MediaStream([track]);
      this.video.play().catch(() => {});
    };
    pc.onicecandidate = ({ candidate }) => { if (candidate?.candidate) say('negotiation', 'iceNegotiation', { ...ids, ice: candidate.toJSON() }); };
    pc.onconnectionstatechange = () => {
      if (this.pc !== pc) return;
      clearTimeout(this.timer);
      if (pc.connectionState === 'connected') this.tries = 0;
      else if (pc.connectionState === 'failed') this.#again('connecting');
      else this.timer = setTimeout(() => { if (this.pc === pc && pc.connectionState !== 'connected') this.#again('connecting'); }, PATIENCE);
    };
    await pc.setRemoteDescription(sdp);
    await pc.setLocalDescription(await pc.createAnswer());
    say('negotiation', 'mediaNegotiation', { ...ids, sdp: { type: 'answer', sdp: pc.localDescription.sdp } });
  }

  /** Numbers of the last second: pictures, loss, delay. */
  async look() {
    if (!this.pc) return null;
    let stats = null;
    let rtt = 0;
    for (const s of (await this.pc.getStats()).values()) {
      if (s.type === 'inbound-rtp' && s.kind === 'video') stats = s;
      else if (s.type === 'candidate-pair' && s.nominated) rtt = s.currentRoundTripTime ?? 0;
    }
    if (!stats) return null;
    const before = this.before ?? stats;
    this.before = stats;
    const received = stats.packetsReceived - before.packetsReceived;
    const lost = Math.max(0, stats.packetsLost - before.packetsLost);
    const emitted = stats.jitterBufferEmittedCount - before.jitterBufferEmittedCount;
    const held = emitted > 0 ? (stats.jitterBufferDelay - before.jitterBufferDelay) / emitted : 0;
    const seconds = (stats.timestamp - before.timestamp) / 1000;
    return {
      fps: seconds > 0 ? (stats.framesDecoded - before.framesDecoded) / seconds : stats.framesPerSecond ?? 0,
      loss: received + lost > 0 ? lost / (received + lost) : 0,
      // From the picture itself if it says; else what the connection adds.
      latency: this.#stamped() ?? 1000 * (rtt / 2 + held),
    };
  }

  #stamped() {
    const { videoWidth: width } = this.video;
    if (!width) return null;
    this.canvas ??= new OffscreenCanvas(width, ROW);
    if (this.canvas.width !== width) this.canvas.width = width;
    const c = this.canvas.getContext('2d', { willReadFrequently: true });
    c.drawImage(this.video, 0, 0, width, ROW, 0, 0, width, ROW);
    const at = readStamp(c.getImageData(0, 0, width, ROW).data, width);
    if (at === null) return null;
    const age = ((Date.now() >>> 0) - at) >>> 0;
    return age < 5000 ? age : null;
  }
}

/** The card of the first tab. */
export function videoCard(app) {
  const video = h('video', { muted: true, autoplay: true, playsInline: true, disablePictureInPicture: true, 'aria-label': t('video') });
  const [title, why] = [h('b'), h('small')];
  const note = h('div.note', title, why);
  const badge = h('span.badge');
  const tool = (glyph, label, run) => h('button.tool', { title: label, 'aria-label': label, onclick: run }, icon(glyph, 16));
  // Large it lies over the plan, whichever tab is open.
  const large = tool('fit', t('video_large'), () => {
    const isLarge = !frame.classList.contains('large');
    toggle(frame, 'large', isLarge);
    (isLarge ? document.querySelector('.map') : el).append(frame);
    video.play().catch(() => {});
    watch();
  });
  const record = tool('record', t('video_record'), () => (recorder ? recorder.stop() : begin()));
  const frame = h('div.camera', video, note, badge, h('div.tools', record, large));
  const el = h('section.card', h('h2', icon('camera', 15), t('video')), frame);
  const viewer = (app.video = new Viewer(video));
  if (app.session.camera === false) { viewer.absent = true; viewer.state = 'none'; }
  let shown = true;
  let recorder = null;

  const watch = () => viewer.want(!document.hidden && (shown || frame.classList.contains('large') || !!recorder));
  document.addEventListener('visibilitychange', watch);
  addEventListener('keydown', (e) => { if (e.key === 'v' && !e.target.matches('input, select, textarea') && !e.ctrlKey && !e.metaKey) large.click(); });

  function begin() {
    const type = ['video/mp4;codecs=avc1', 'video/webm;codecs=h264', 'video/webm'].find((k) => MediaRecorder.isTypeSupported(k));
    if (!video.srcObject || !type) return app.tell('warn', t('no_recording'));
    const pieces = [];
    recorder = new MediaRecorder(video.srcObject, { mimeType: type });
    recorder.ondataavailable = (e) => pieces.push(e.data);
    recorder.onstop = () => {
      recorder = null;
      watch();
      record.setAttribute('aria-pressed', false);
      const url = URL.createObjectURL(new Blob(pieces, { type }));
      h('a', { href: url, download: `kestrel-${new Date().toISOString().slice(0, 19).replace(/:/g, '')}.${type.includes('mp4') ? 'mp4' : 'webm'}` }).click();
      setTimeout(() => URL.revokeObjectURL(url), 10000);
    };
    recorder.start(1000);
    record.setAttribute('aria-pressed', true);
  }

  let numbers = null;
  let asked = 0;
  function update() {
    if (!document.contains(frame)) return;
    const now = performance.now();
    if (viewer.state === 'live' && now - asked > 1000) { asked = now; viewer.look().then((n) => { numbers = n; }); }
    const isLive = viewer.state === 'live';
    const isStale = isLive && now - viewer.seen > STALE;
    toggle(frame, 'live', isLive);
    toggle(frame, 'stale', isStale);
    put(title, isStale ? t('video_stale') : viewer.state === 'none' ? t('no_video') : t('video_connecting'));
    put(why, isStale ? t('ago', { n: num((now - viewer.seen) / 1000, 0) }) : viewer.state === 'none' ? t('no_video_why') : viewer.why ?? '');
    put(badge, numbers && isLive ? `${num(numbers.latency, 0)} ms · ${num(numbers.fps, 0)}/s${numbers.loss > 0.001 ? ` · −${num(numbers.loss * 100, 1)} %` : ''}` : '');
  }
  watch();
  return { el, update, show: () => { shown = true; watch(); }, hide: () => { shown = false; watch(); } };
}
