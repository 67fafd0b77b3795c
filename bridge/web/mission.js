// Missions: points on the plan, a list to order them, up to the drone and down from it; the fence that is on board.

import { h, icon, num, put } from './dom.js';
import { ask } from './fly.js';
import { CMD } from './mavlink.js';
import { t } from './words.js';

const LOCAL = 1;
const HOME_RELATIVE = 3;
const MISSION_FRAME = 2;
const MIN_HEIGHT = 0.3;

export function missionPane(app) {
  const { view, station, vehicle } = app;
  const list = h('div', { className: 'list' });
  const summary = h('div.soft');
  const homeAtEnd = h('input', { type: 'checkbox', checked: true });
  const height = h('input.input.small', { type: 'number', min: MIN_HEIGHT, max: 10, step: 0.1, value: 1, style: { width: '84px' } });
  const edit = h('button.button.small', { onclick: () => { view.editing = !view.editing; draw(); } });
  const start = h('button.button.primary.wide', { onclick: () => ask(app, t('start'), station.startMission()) }, icon('play', 16), t('start'));
  const send = h('button.button.wide', { onclick: upload }, icon('upload', 16), t('upload'));
  const may = app.role !== 'viewer';

  const el = h('div.pane', { role: 'tabpanel' },
    h('section.card', h('h2', icon('route', 15), t('mission'), h('span.spread'), edit), summary, list,
      h('div.grid2', { style: { 'margin-top': '10px' } },
        h('button.button.small', { onclick: everyRoom, disabled: !may }, t('all_rooms')),
        h('button.button.small.quiet', { onclick: () => { view.waypoints = []; draw(); } }, icon('trash', 15), t('clear')))),
    h('section.card',
      h('div.row', h('span.soft', t('height')), h('span.spread'), height, h('span.faint', 'm')),
      h('label.row', { style: { margin: '10px 0' } }, homeAtEnd, t('then_home')),
      h('div.grid2', send, start),
      h('button.button.small.quiet.wide', { style: { 'margin-top': '8px' }, onclick: download }, t('download'))));

  function draw() {
    edit.replaceChildren(t(view.editing ? 'done' : 'edit'));
    edit.setAttribute('aria-pressed', view.editing);
    edit.disabled = !may;
    list.replaceChildren(...view.waypoints.map((w, i) => h(`div.point${view.picked === i ? '.picked' : ''}`, { onclick: () => { view.picked = i; draw(); } },
      h('span.n', w.done ? '✓' : i + 1),
      h('span', { style: { flex: 1 } }, w.name ?? `${num(w.x, 1)}, ${num(w.y, 1)}`),
      h('input.input.small', { type: 'number', min: 0, max: 600, value: w.wait ?? 0, title: t('wait'), 'aria-label': t('wait'), style: { width: '62px' }, onchange: (e) => { w.wait = Math.max(0, Number(e.target.value) || 0); } }),
      h('span.faint', 's'),
      h('button.tool', { title: t('remove'), 'aria-label': t('remove'), onclick: (e) => { e.stopPropagation(); view.waypoints.splice(i, 1); draw(); } }, icon('cross', 15)))));
    put(summary, view.waypoints.length ? (view.editing ? t('mission_hint') : '') : view.editing ? t('mission_hint') : t('empty'));
  }

  /** Every named room once, each time the nearest one next. */
  function everyRoom() {
    const rest = [...app.plan.rooms];
    let at = vehicle.state ? [vehicle.state.x, vehicle.state.y] : app.plan.home;
    view.waypoints = [];
    while (rest.length) {
      rest.sort((a, b) => Math.hypot(a.x - at[0], a.y - at[1]) - Math.hypot(b.x - at[0], b.y - at[1]));
      const room = rest.shift();
      view.waypoints.push({ x: room.x, y: room.y, name: room.name.replace(/[_-]/g, ' '), wait: 2 });
      at = [room.x, room.y];
    }
    view.editing = true;
    draw();
  }

  async function upload() {
    const z = Math.max(MIN_HEIGHT, Number(height.value) || 1);
    const items = [{ command: CMD.TAKEOFF, frame: HOME_RELATIVE, z, param4: NaN }];
    for (const w of view.waypoints) {
      const [n, e] = view.toNed(w.x, w.y);
      w.seq = items.length;
      w.done = false;
      items.push({ command: CMD.WAYPOINT, frame: LOCAL, param1: w.wait ?? 0, param4: NaN, x: Math.round(n * 1e4), y: Math.round(e * 1e4), z: -z });
    }
    if (homeAtEnd.checked) items.push({ command: CMD.RETURN, frame: MISSION_FRAME, param4: NaN });
    view.editing = false;
    draw();
    const r = await station.upload(items);
    app.tell(r.ok ? 'good' : 'bad', r.ok ? t('sent') : t('not_sent', { why: r.words }));
    return r;
  }

  async function download() {
    const r = await station.download();
    if (!r.ok) return app.tell('bad', t('failed', { what: t('download'), why: r.words }));
    view.waypoints = [];
    for (const item of r.items) {
      if (item.command === CMD.TAKEOFF) height.value = num(Math.abs(item.z), 1);
      if (item.command !== CMD.WAYPOINT || item.frame !== LOCAL) continue;
      const [x, y] = view.fromNed(item.x / 1e4, item.y / 1e4);
      view.waypoints.push({ x, y, wait: item.param1, seq: item.seq });
      height.value = num(-item.z, 1);
    }
    if (r.items.length) homeAtEnd.checked = r.items.some((i) => i.command === CMD.RETURN);
    draw();
    return r;
  }

  view.addEventListener('add', (e) => {
    if (!e.detail.free) return app.tell('warn', t('goto_wall'));
    view.waypoints.push({ x: e.detail.x, y: e.detail.y, wait: 0 });
    draw();
  });
  view.addEventListener('pick', (e) => { view.picked = e.detail; draw(); });
  view.addEventListener('edited', () => draw());
  draw();
  let known = false;
  return {
    el,
    show() { if (!known && !view.waypoints.length && app.link.isOpen) { known = true; download(); } },
    hide() { view.editing = false; draw(); },
    update() {
      const s = vehicle.state;
      const mine = !!vehicle.control?.owner?.you;
      send.disabled = !mine || !view.waypoints.length;
      start.disabled = !mine || !s?.items;
      if (s?.mission === 2) put(summary, t('mission_state', { n: s.item + 1, m: s.items }));
    },
    upload, everyRoom,
  };
}
