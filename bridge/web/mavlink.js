// MAVLink 2 in a page: framing, checksum, and the messages that a console needs.
//
// A message is its fields as the XML has them; order on the wire and the CRC_EXTRA follow from that, so that a field typed
// wrongly here is a frame that nobody takes.

const SIZES = { u8: 1, i8: 1, char: 1, u16: 2, i16: 2, u32: 4, i32: 4, f32: 4 };
const XML = { u8: 'uint8_t', i8: 'int8_t', char: 'char', u16: 'uint16_t', i16: 'int16_t', u32: 'uint32_t', i32: 'int32_t', f32: 'float' };

/** id, name, fields; what stands behind `|` are extensions. */
const TABLE = [
  [0, 'HEARTBEAT', 'u8 type, u8 autopilot, u8 base_mode, u32 custom_mode, u8 system_status, u8 mavlink_version'],
  [20, 'PARAM_REQUEST_READ', 'u8 target_system, u8 target_component, char[16] param_id, i16 param_index'],
  [21, 'PARAM_REQUEST_LIST', 'u8 target_system, u8 target_component'],
  [22, 'PARAM_VALUE', 'char[16] param_id, f32 param_value, u8 param_type, u16 param_count, u16 param_index'],
  [23, 'PARAM_SET', 'u8 target_system, u8 target_component, char[16] param_id, f32 param_value, u8 param_type'],
  [40, 'MISSION_REQUEST', 'u8 target_system, u8 target_component, u16 seq | u8 mission_type'],
  [42, 'MISSION_CURRENT', 'u16 seq | u16 total, u8 mission_state, u8 mission_mode'],
  [43, 'MISSION_REQUEST_LIST', 'u8 target_system, u8 target_component | u8 mission_type'],
  [44, 'MISSION_COUNT', 'u8 target_system, u8 target_component, u16 count | u8 mission_type'],
  [45, 'MISSION_CLEAR_ALL', 'u8 target_system, u8 target_component | u8 mission_type'],
  [46, 'MISSION_ITEM_REACHED', 'u16 seq'],
  [47, 'MISSION_ACK', 'u8 target_system, u8 target_component, u8 type | u8 mission_type'],
  [51, 'MISSION_REQUEST_INT', 'u8 target_system, u8 target_component, u16 seq | u8 mission_type'],
  [69, 'MANUAL_CONTROL', 'u8 target, i16 x, i16 y, i16 z, i16 r, u16 buttons'],
  [73, 'MISSION_ITEM_INT', 'u8 target_system, u8 target_component, u16 seq, u8 frame, u16 command, u8 current, u8 autocontinue, f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z | u8 mission_type'],
  [75, 'COMMAND_INT', 'u8 target_system, u8 target_component, u8 frame, u16 command, u8 current, u8 autocontinue, f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z'],
  [76, 'COMMAND_LONG', 'u8 target_system, u8 target_component, u16 command, u8 confirmation, f32 param1, f32 param2, f32 param3, f32 param4, f32 param5, f32 param6, f32 param7'],
  [77, 'COMMAND_ACK', 'u16 command, u8 result | u8 progress, i32 result_param2, u8 target_system, u8 target_component'],
  [253, 'STATUSTEXT', 'u8 severity, char[50] text | u16 id, u8 chunk_seq'],
];

function crcByte(crc, byte) {
  let t = (byte ^ (crc & 0xff)) & 0xff;
  t = (t ^ (t << 4)) & 0xff;
  return ((crc >> 8) ^ (t << 8) ^ (t << 3) ^ (t >> 4)) & 0xffff;
}

function crcText(crc, text) {
  for (const c of text) crc = crcByte(crc, c.charCodeAt(0));
  return crc;
}

function describe([id, name, text]) {
  const [plain, extra] = text.split('|');
  const read = (part) => (part ? part.split(',').map((f) => {
    const [, type, , count, field] = f.trim().match(/^(\w+?)(\[(\d+)\])? (\w+)$/);
    return { type, count: count ? Number(count) : 0, name: field };
  }) : []);
  // Wire order: larger types first, else as written; extensions stay behind.
  const fields = read(plain).map((f, i) => [f, i]).sort((a, b) => SIZES[b[0].type] - SIZES[a[0].type] || a[1] - b[1]).map(([f]) => f);
  let crc = crcText(0xffff, name + ' ');
  for (const f of fields) {
    crc = crcText(crc, `${XML[f.type]} ${f.name} `);
    if (f.count) crc = crcByte(crc, f.count);
  }
  let at = 0;
  for (const f of (fields.push(...read(extra)), fields)) {
    f.at = at;
    at += SIZES[f.type] * (f.count || 1);
  }
  return { id, name, fields, size: at, extra: (crc & 0xff) ^ (crc >> 8) };
}

const BY_ID = new Map();
const BY_NAME = new Map();
for (const row of TABLE) {
  const m = describe(row);
  BY_ID.set(m.id, m);
  BY_NAME.set(m.name, m);
}

const SET = { u8: 'setUint8', i8: 'setInt8', u16: 'setUint16', i16: 'setInt16', u32: 'setUint32', i32: 'setInt32', f32: 'setFloat32' };
const GET = { u8: 'getUint8', i8: 'getInt8', u16: 'getUint16', i16: 'getInt16', u32: 'getUint32', i32: 'getInt32', f32: 'getFloat32' };

/** Numbers frames of one sender. */
export class Encoder {
  constructor(system, component) {
    Object.assign(this, { system, component, sequence: 0 });
  }

  encode(name, values) {
    const m = BY_NAME.get(name);
    const payload = new DataView(new ArrayBuffer(m.size));
    for (const f of m.fields) {
      const v = values[f.name];
      if (v === undefined) continue;
      if (f.type === 'char') {
        for (let i = 0; i < Math.min(f.count, v.length); i++) payload.setUint8(f.at + i, v.charCodeAt(i));
      } else payload[SET[f.type]](f.at, v, true);
    }
    let length = m.size;
    while (length > 1 && payload.getUint8(length - 1) === 0) length--;
    const frame = new Uint8Array(12 + length);
    frame.set([0xfd, length, 0, 0, this.sequence++ & 0xff, this.system, this.component, m.id & 0xff, (m.id >> 8) & 0xff, m.id >> 16]);
    frame.set(new Uint8Array(payload.buffer, 0, length), 10);
    let crc = 0xffff;
    for (let i = 1; i < 10 + length; i++) crc = crcByte(crc, frame[i]);
    crc = crcByte(crc, m.extra);
    frame[10 + length] = crc & 0xff;
    frame[11 + length] = crc >> 8;
    return frame;
  }
}

/** Frames out of bytes that hold whole ones: {name, system, component, sequence, ...fields}. Unknown ids are passed over. */
export function* decode(bytes) {
  let at = 0;
  while (at + 12 <= bytes.length) {
    if (bytes[at] !== 0xfd) { at++; continue; }
    const length = bytes[at + 1];
    const end = at + 12 + length + (bytes[at + 2] & 1 ? 13 : 0);
    if (end > bytes.length) return;
    const id = bytes[at + 7] | (bytes[at + 8] << 8) | (bytes[at + 9] << 16);
    const m = BY_ID.get(id);
    if (m) {
      let crc = 0xffff;
      for (let i = at + 1; i < at + 10 + length; i++) crc = crcByte(crc, bytes[i]);
      crc = crcByte(crc, m.extra);
      if ((crc & 0xff) === bytes[at + 10 + length] && (crc >> 8) === bytes[at + 11 + length]) {
        // What was zero at the end was cut off.
        const full = new Uint8Array(m.size);
        full.set(bytes.subarray(at + 10, at + 10 + Math.min(length, m.size)));
        const view = new DataView(full.buffer);
        const out = { name: m.name, system: bytes[at + 5], component: bytes[at + 6], sequence: bytes[at + 4] };
        for (const f of m.fields) {
          if (f.type === 'char') {
            let text = '';
            for (let i = 0; i < f.count && full[f.at + i]; i++) text += String.fromCharCode(full[f.at + i]);
            out[f.name] = text;
          } else out[f.name] = view[GET[f.type]](f.at, true);
        }
        yield out;
      }
    }
    at = end;
  }
}

export const CMD = {
  WAYPOINT: 16, RETURN: 20, LAND: 21, TAKEOFF: 22, DELAY: 93, SET_MODE: 176, REPOSITION: 192, PAUSE: 193,
  MISSION_START: 300, ARM: 400, PREARM: 401, SET_INTERVAL: 511, CONTROL: 32100,
};

/** Flight modes as PX4 numbers them: [main, sub]. */
export const PX4 = {
  Hold: [4, 3], Mission: [4, 4], Return: [4, 5], Land: [4, 6], Takeoff: [4, 2],
  Offboard: [6, 0], Position: [3, 0], Altitude: [2, 0], Stabilized: [7, 0],
};
