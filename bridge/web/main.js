// The page: puts the parts together and keeps them up to date.

import { h, icon, num, put, toggle } from './dom.js';
import { ask, flyPane } from './fly.js';
import { hud } from './hud.js';
import { Link } from './link.js';
import { below, choose, get, post, session } from './login.js';
import { PlanView } from './plan.js';
import { timeBar } from './recorder.js';
import { Station } from './station.js';
import { current, languages, speak, t } from './words.js';

const root = document.getElementById('app');
const TABS = [
  ['fly', 'wing', async (app) => flyPane(app)],
  ['mission', 'route', async (app) => (await import('./mission.js')).missionPane(app)],
  ['charts', 'chart', async (app) => (await import('./charts.js')).chartsPane(app)],
  ['parameters', 'sliders', async (app) => (await import('./params.js')).paramsPane(app)],
  ['log', 'list', async (app) => (await import('./logs.js')).logsPane(app)],
  ['people', 'user', async (app) => (await import('./people.js')).peoplePane(app), 'admin'],
];
const ROLES = ['viewer', 'pilot', 'engineer', 'admin'];
const LAYERS = [['cones', 'cone'], ['particles', 'particle'], ['histogram', 'chosen'], ['path', 'path'], ['names', 'label'], ['fence', 'fence']];

document.documentElement.lang = current();
document.title = t('title');
start();

async function start(why = '') {
  const who = await session(root, why);
  if (who.vehicles) {
    // Off the drone: one vehicle at a time.
    const { hangar } = await import('./hangar.js');
    who.vehicle = { name: await hangar(root, who, () => start(t('over'))) };
    choose(who.vehicle.name);
  }
  const app = { session: who, role: who.role, vehicle: {}, modes: [], reasons: [], texts: [], rate: 0 };
  app.link = new Link(app.vehicle);
  app.station = new Station(app.link);
  app.isAtLeast = (role) => ROLES.indexOf(who.role) >= ROLES.indexOf(role);
  build(app);
  app.link.open();
  try {
    app.plan = await get(below('/api/plan'));
    app.view.setPlan(app.plan);
  } catch (e) { app.tell('bad', e.message); }
}

function build(app) {
  const { link, station, vehicle } = app;

  // ---- top
  const status = h('div.status', { role: 'status' }, h('span.dot'), h('b'), h('small'));
  const gauge = (key, extra = '') => { const b = h('b'); return [h(`div.gauge${extra}`, h('small', t(key)), b), b]; };
  const [batteryGauge, battery] = gauge('battery');
  const [linkGauge, linkText] = gauge('latency', '.minor');
  const fill = h('i');
  battery.append(h('span.cell', fill), h('span'));
  const tool = (glyph, label, run) => h('button.tool', { title: label, 'aria-label': label, onclick: run }, icon(glyph));
  const theme = tool('sun', t('light'), () => {
    const next = document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark';
    document.documentElement.dataset.theme = next;
    localStorage.setItem('theme', next);
    app.view.recolour();
  });
  const language = h('button.tool', { title: t('language'), 'aria-label': t('language'), onclick: () => speak(languages[(languages.indexOf(current()) + 1) % languages.length]) }, current().toUpperCase());
  const logout = tool('cross', `${t('logout')} (${app.session.user})`, async () => { await post('/api/logout').catch(() => {}); link.close(); location.reload(); });
  const top = h('header.top',
    h('div.brand', h('img', { src: '/icon.svg', alt: '' }), h('span', 'Kestrel'), h('span', app.session.vehicle.name)),
    app.session.vehicles ? tool('layers', t('vehicles'), () => { location.hash = ''; location.reload(); }) : null,
    status, h('span.spread'), batteryGauge, linkGauge, language, theme, logout);

  // ---- map
  const canvas = h('canvas.plan', { tabIndex: 0, 'aria-label': t('position') });
  const view = (app.view = new PlanView(canvas, vehicle));
  const follow = tool('follow', t('follow'), () => { view.follow = !view.follow; view.moved = true; });
  const mapbar = h('div.card-float.mapbar', tool('plus', t('zoom_in'), () => { view.moved = true; view.zoom(1.3); }), tool('minus', t('zoom_out'), () => { view.moved = true; view.zoom(1 / 1.3); }), tool('fit', t('fit_view'), () => { view.moved = false; view.fit(); }), follow);
  const chips = h('div.card-float.chips', { role: 'group', 'aria-label': t('layers') }, LAYERS.map(([name, tone]) => h('button.chip', {
    'aria-pressed': view.layers[name], style: { '--tone': `var(--${tone})` },
    onclick: (e) => { view.layers[name] = !view.layers[name]; e.currentTarget.setAttribute('aria-pressed', view.layers[name]); },
  }, t(`l_${name}`))));
  const instruments = hud();
  const toasts = h('div.toasts', { 'aria-live': 'polite' });
  const veil = h('div.veil', h('div', h('span.spinner'), h('span', t('connecting'))));
  const bar = (app.time = timeBar(app));
  const map = h('main.map', canvas, mapbar, chips, instruments.el, bar.el, toasts, veil);

  app.tell = (level, text) => {
    const last = toasts.lastChild;
    if (last?.textContent === text) return;
    const toast = h(`div.toast.${level}`, text);
    toasts.append(toast);
    while (toasts.children.length > 3) toasts.firstChild.remove();
    setTimeout(() => toast.remove(), level === 'bad' ? 7000 : 4500);
  };

  // ---- rail
  const stopText = h('span', t('stop'));
  const stop = h('button.stop', { onclick: () => halt(), 'aria-label': t('stop') }, icon('stop', 24), stopText, h('kbd', 'Esc'));
  let stoppedAt = -Infinity;
  function halt() {
    stoppedAt = performance.now();
    app.sticks?.release();
    if (!station.stop()) app.tell('bad', t('lost'));
  }
  app.halt = halt;
  const tabs = TABS.filter(([, , , role]) => !role || app.isAtLeast(role));
  const holder = h('div.scroll');
  const buttons = tabs.map(([name, glyph, make]) => h('button', { role: 'tab', 'aria-selected': 'false', 'data-tab': name, onclick: () => select(name, make) }, icon(glyph, 19), t(name)));
  const panes = new Map();
  async function select(name, make) {
    for (const b of buttons) b.setAttribute('aria-selected', b.dataset.tab === name);
    if (!panes.has(name)) panes.set(name, await make(app));
    const before = app.pane;
    app.pane = panes.get(name);
    if (before !== app.pane) before?.hide?.();
    app.pane.show?.();
    holder.replaceChildren(app.pane.el);
    holder.scrollTop = 0;
    app.pane.update?.();
  }
  app.select = (name) => buttons.find((b) => b.dataset.tab === name)?.click();
  const rail = h('aside.rail', h('nav.tabs', { role: 'tablist' }, buttons), holder, h('footer', stop));

  root.replaceChildren(h('div.shell', top, map, rail));
  app.select('fly');

  // ---- what is said
  link.addEventListener('opened', (e) => {
    app.modes = e.detail.modes;
    app.reasons = e.detail.reasons;
    toggle(veil, 'hidden', true);
    app.onOpened?.();
    fence(app);
  });
  link.addEventListener('closed', (e) => {
    app.sticks?.release();
    if (e.detail.code === 4001) { link.close(); root.replaceChildren(); start(t('over')); return; }
    toggle(veil, 'hidden', false);
    put(veil.querySelector('div span + span'), e.detail.wasOpen ? t('lost') : t('connecting'));
  });
  link.addEventListener('state', () => { if (!app.replay) view.observe(vehicle.state); });
  link.addEventListener('refused', (e) => app.tell('warn', t(`v_${e.detail}`)));
  station.addEventListener('text', (e) => {
    const { severity, text } = e.detail;
    if (/fence/i.test(text)) fence(app);
    app.texts.push({ at: new Date(), severity, text });
    if (app.texts.length > 500) app.texts.shift();
    // A greeting is no news.
    if (!text.startsWith('Kestrel ')) app.tell(severity <= 3 ? 'bad' : severity === 4 ? 'warn' : severity === 5 ? 'info' : 'good', text);
  });
  station.addEventListener('reached', (e) => { const w = view.waypoints.find((p) => p.seq === e.detail); if (w) w.done = true; });

  // ---- click to go
  view.addEventListener('goto', (e) => {
    const { x, y, free } = e.detail;
    const s = vehicle.state;
    const why = !free ? 'goto_wall' : !vehicle.control?.owner?.you ? 'need_control' : !s?.armed || s.landed === 0 ? 'need_flight' : null;
    if (app.replay) return app.tell('warn', t('replay_click'));
    view.pulse(x, y, !!why);
    if (why) return app.tell('warn', t(why));
    ask(app, t('goto'), station.goTo(...view.toNed(x, y))).then((r) => { if (!r.ok) view.pulse(x, y, true); });
  });

  // ---- keys
  addEventListener('keydown', (e) => {
    if (e.key === 'Escape') { e.preventDefault(); return halt(); }
    if (e.target.matches('input, select, textarea') || e.ctrlKey || e.metaKey || e.altKey || e.repeat) return;
    const fly = panes.get('fly');
    const name = { t: 'takeoff', l: 'land', r: 'return', h: 'hold', p: 'patrol', g: 'sticks' }[e.key.toLowerCase()];
    if (name && fly && !fly.actions[name].disabled) fly.actions[name].click();
  });
  let touched = 0;
  for (const kind of ['pointerdown', 'keydown']) {
    addEventListener(kind, () => { if (performance.now() - touched > 30000) { touched = performance.now(); link.touch(); } }, true);
  }

  // ---- ever again
  let bytes = 0;
  setInterval(() => { app.rate = (link.bytes - bytes) / 1000; bytes = link.bytes; }, 1000);
  setInterval(() => {
    const s = vehicle.state;
    const quiet = performance.now() - link.heard > 2000;
    const [level, text, more] = app.replay ? ['replay', t('replay'), app.replay.state ? t(`m_${app.modes[app.replay.state.mode]}`) : ''] : describe(app, s, quiet);
    status.dataset.level = level;
    put(status.children[1], text);
    put(status.children[2], more);
    toggle(status.children[2], 'hidden', !more);
    const share = s?.battery;
    fill.style.width = `${Math.max(4, Math.min(100, (share || 0) * 100))}%`;
    battery.className = share < 0.15 ? 'bad' : share < 0.3 ? 'warn' : '';
    put(battery.lastChild, Number.isFinite(share) ? `${num(share * 100, 0)} %` : s ? `${num(s.volts, 1)} V` : '–');
    put(linkText, `${num(link.latency, 0)} ms`);
    put(stopText, performance.now() - stoppedAt < 3000 ? t('stop_again') : t('stop'));
    theme.replaceChildren(icon(document.documentElement.dataset.theme === 'dark' ? 'sun' : 'moon'));
    follow.setAttribute('aria-pressed', view.follow);
    view.clickable = vehicle.control?.owner?.you && s?.armed && s.landed !== 0 && !view.editing && !app.replay;
    toggle(canvas, 'click', !!view.clickable);
    view.current = s?.mission === 2 ? s.item : undefined;
    const seen = app.replay?.state ?? s;
    if (seen && app.plan) instruments.update(seen, view.plan.north);
    bar.tick(performance.now());
    app.pane?.update?.();
  }, 100);
  const frame = (now) => { if (!canvas.isConnected) return; view.draw(now); app.pane?.draw?.(now); requestAnimationFrame(frame); };
  requestAnimationFrame(frame);
  window.kestrel = app;
}

/** The fence on board, drawn on the plan. */
async function fence(app) {
  const { station, view } = app;
  const r = await station.download(1);
  if (!r.ok || !r.items.length) { view.fence = []; return; }
  await station.read(['KST_LAT0', 'KST_LON0']);
  const origin = ['KST_LAT0', 'KST_LON0'].map((n) => station.params.get(n)?.value ?? 0);
  view.fence = areas(r.items, (i) => view.fromNed(...(i.frame === 1 ? [i.x / 1e4, i.y / 1e4] : metres(i, origin))));
}

/** Items of a fence as areas: corners follow each other by their count, a circle is its radius. */
function areas(items, place) {
  const out = [];
  for (let i = 0; i < items.length;) {
    const item = items[i];
    const keepOut = item.command === 5002 || item.command === 5004;
    if (item.command >= 5003) {
      const [x, y] = place(item);
      out.push({ x, y, radius: item.param1, keepOut });
      i++;
    } else {
      const n = Math.max(1, item.param1);
      out.push({ points: items.slice(i, i + n).map(place), keepOut });
      i += n;
    }
  }
  return out;
}

/** A global place as metres north and east of the origin (the drone's own way: a sphere of 6,378,137 m). */
function metres(item, [lat0, lon0]) {
  const k = (1e-7 * Math.PI) / 180;
  return [(item.x - lat0) * k * 6378137, (item.y - lon0) * k * 6378137 * Math.cos(lat0 * k)];
}

/** The vehicle in three words. */
function describe(app, s, quiet) {
  if (!app.link.isOpen || quiet) return ['bad', t('connecting'), ''];
  if (!s) return ['warn', t('no_state'), ''];
  const mode = app.modes[s.mode];
  const reason = app.reasons[s.because];
  const why = s.because > 1 ? ` (${reason})` : '';
  if (!s.armed) return app.vehicle.blocked ? ['warn', t('disarmed'), app.vehicle.blocked] : ['good', t('ready'), ''];
  const phase = s.landed === 0 ? 'armed' : s.landed === 2 ? 'taking_off' : s.landed === 3 ? 'landing' : 'flying';
  return [s.because > 1 && s.because !== 12 ? 'bad' : 'live', t(phase), t(`m_${mode}`) + why];
}
