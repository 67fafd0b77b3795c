// The compact telemetry, byte by byte: see `bridge/src/web/topics.rs`.

const STATE = 1, SCAN = 2, PARTICLES = 3, HISTOGRAM = 4, ROUTE = 5, PEOPLE = 6;
export const MAVLINK = 64;
export const ACK = 65;

/** Takes one binary message into `into`; returns the topic. */
export function take(buffer, into, fields) {
  const view = new DataView(buffer);
  const topic = view.getUint8(0);
  const at = Number(view.getBigUint64(1, true)) * 1e-6;
  const body = 9;
  const floats = (from) => {
    const out = new Float32Array((buffer.byteLength - from) >> 2);
    for (let i = 0; i < out.length; i++) out[i] = view.getFloat32(from + 4 * i, true);
    return out;
  };
  switch (topic) {
    case STATE: {
      const v = floats(body);
      const s = { at };
      for (let i = 0; i < fields.length && i < v.length; i++) s[fields[i]] = v[i];
      into.state = s;
      break;
    }
    case SCAN: into.scan = floats(body); break;
    case PARTICLES: into.particles = new Int16Array(buffer.slice(body)); break;
    case HISTOGRAM: {
      const n = 72;
      into.histogram = {
        threshold: view.getFloat32(body, true),
        chosen: view.getFloat32(body + 4, true),
        density: Array.from({ length: n }, (_, i) => view.getFloat32(body + 8 + 4 * i, true)),
        blocked: Array.from({ length: n }, (_, i) => view.getUint8(body + 8 + 4 * n + i) === 1),
      };
      break;
    }
    case ROUTE: {
      const v = floats(body + 1);
      const corners = [];
      for (let i = 2; i + 1 < v.length; i += 2) corners.push([v[i], v[i + 1]]);
      into.goal = view.getUint8(body) ? [v[0], v[1]] : null;
      into.route = corners;
      break;
    }
    case PEOPLE: {
      const v = floats(body);
      into.people = [];
      for (let i = 0; i + 3 < v.length; i += 4) into.people.push([v[i], v[i + 1], v[i + 2], v[i + 3]]);
      break;
    }
  }
  return topic;
}

/** Answer to one of our messages. */
export function acknowledgement(buffer) {
  const view = new DataView(buffer);
  return { seq: view.getUint32(9, true), sent: view.getFloat64(13, true), verdict: view.getUint8(21) };
}
