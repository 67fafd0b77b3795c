// The first tab: who has control, arm, take off, modes, camera, health.

import { h, icon, num, put, toggle } from './dom.js';
import { sticksCard } from './sticks.js';
import { videoCard } from './video.js';
import { t } from './words.js';

const MANUAL = ['Position', 'Altitude', 'Stabilized'];
const AUTOMATIC = [['VFH_ENABLE', 'avoid'], ['AVOID_EVADE', 'evade'], ['LOC_SEARCH', 'search_place']];

/** Runs a command and tells how it ended if it did not work. */
export function ask(app, what, promise) {
  return promise.then((r) => {
    if (!r.ok && r.words !== 'replaced') app.tell('bad', t('failed', { what, why: r.words }));
    return r;
  });
}

export function flyPane(app) {
  const { station, vehicle } = app;
  const canFly = () => app.role !== 'viewer';

  // ---- control
  const [line, small] = [h('span'), h('small')];
  const owner = h('div.owner', h('span.avatar', icon('user')), h('div', line, small));
  const control = h('button.button.small');
  const asking = h('div.asking.hidden', h('span'), h('div.row',
    h('button.button.small.primary', { onclick: () => ask(app, t('hand'), station.handOver()) }, t('hand')),
    h('button.button.small.quiet', { onclick: () => { app.kept = vehicle.control?.asking?.system; toggle(asking, 'hidden', true); } }, t('keep'))));
  control.addEventListener('click', () => {
    const who = vehicle.control?.owner;
    if (who?.you) ask(app, t('release'), station.releaseControl());
    else ask(app, t('take'), station.takeControl()).then((r) => { if (!r.ok && r.result === 4) app.tell('info', t('asked')); });
  });

  // ---- slide to arm
  const slide = slider(t('slide_arm'), () => ask(app, t('armed'), station.arm()));
  const disarm = h('button.button.wide.hidden', { onclick: () => ask(app, t('disarm'), station.disarm()) }, t('disarm'));

  const action = (name, glyph, run, key) => h('button.button.action', { onclick: run, title: key ? `${t(name)} (${key})` : t(name), 'data-action': name }, icon(glyph, 20), t(name));
  const actions = {
    takeoff: action('takeoff', 'up', () => ask(app, t('takeoff'), station.takeOff()), 'T'),
    land: action('land', 'down', () => ask(app, t('land'), station.land()), 'L'),
    return: action('return', 'home', () => ask(app, t('return'), station.returnHome()), 'R'),
    hold: action('hold', 'hold', () => ask(app, t('hold'), station.setMode('Hold')), 'H'),
    patrol: action('patrol', 'route', () => ask(app, t('patrol'), vehicle.state?.mission === 2 ? station.setMode('Hold') : vehicle.state?.mission === 3 ? station.setMode('Mission') : station.startMission()), 'P'),
    sticks: action('sticks', 'pad', () => app.sticks?.toggle(), 'G'),
  };
  const modes = h('div.segments', { role: 'group', 'aria-label': t('manual') }, MANUAL.map((m) => h('button', { 'data-mode': m, title: t(`d_${m}`), onclick: () => ask(app, t(`m_${m}`), station.setMode(m)) }, t(`m_${m}`))));

  // Automatic mechanisms that are parameters: whoever may set those switches them, the others see them.
  const switches = h('div.switches', AUTOMATIC.map(([param, key]) => h('button.switch', {
    'data-param': param, title: t(`${key}_why`), disabled: true,
    onclick: () => station.setParam(param, station.params.get(param).value ? 0 : 1),
  }, h('i'), t(key))));
  app.onOpened = () => station.read(AUTOMATIC.map(([param]) => param));

  const facts = {};
  const fact = (key) => { facts[key] = [h('dt', t(key)), h('dd')]; return facts[key]; };
  const health = h('dl.facts', ['localization', 'rangers', 'fc', 'loop', 'link', 'battery'].map(fact));

  const camera = videoCard(app);
  const pane = h('div.pane', { role: 'tabpanel' },
    h('section.card', h('div.row', owner, control), asking),
    h('section.card.stack', h('div', slide.el, disarm), h('div.grid3', Object.values(actions)), modes, switches),
    h('section.card.full.hidden', { 'data-card': 'sticks' }),
    camera.el,
    h('section.card', h('h2', icon('eye', 15), t('health')), health));
  const pad = sticksCard(app, pane.querySelector('[data-card=sticks]'));

  const set = (key, level, text) => {
    const [dt, dd] = facts[key];
    if (dt.className !== level) dt.className = level;
    put(dd, text);
    dd.title = text;
  };

  function update() {
    pad.update();
    camera.update();
    const s = vehicle.state;
    const c = vehicle.control;
    const who = c?.owner;
    const isMine = !!who?.you;
    owner.dataset.who = isMine ? 'you' : who ? 'other' : 'nobody';
    const name = (o) => o.name ?? t('station', { n: o.system });
    put(line, isMine ? t('you') : who ? t('other', { who: name(who) }) : t('nobody'));
    put(small, canFly() ? `${app.session.user} · ${app.session.role}` : t('viewer'));
    put(control, isMine ? t('release') : who && !who.open ? t('ask') : t('take'));
    toggle(control, 'primary', !who);
    toggle(control, 'hidden', !canFly());
    const isAsked = isMine && c.asking && c.asking.system !== app.kept;
    toggle(asking, 'hidden', !isAsked);
    if (isAsked) put(asking.querySelector('span'), t('asks', { who: name(c.asking) }));
    if (!c?.asking) app.kept = null;

    const armed = !!s?.armed;
    toggle(slide.el, 'hidden', armed);
    toggle(disarm, 'hidden', !armed || s.landed !== 0);
    toggle(slide.el.parentElement, 'hidden', armed && s.landed !== 0);
    slide.enable(isMine && !!s && !vehicle.blocked);
    slide.say(t(vehicle.blocked ? 'not_ready' : 'slide_arm'), vehicle.blocked ?? '');
    const flying = armed && s.landed === 1;
    const mode = s ? app.modes[s.mode] : '';
    for (const [key, button] of Object.entries(actions)) {
      const may = { takeoff: isMine && armed && s.landed === 0, land: isMine && armed, return: isMine && flying, hold: isMine && armed, patrol: isMine && (s?.items ?? 0) > 0, sticks: canFly() }[key];
      button.disabled = !may;
    }
    const pressed = { Hold: 'hold', Mission: 'patrol', Return: 'return', Land: 'land', Takeoff: 'takeoff' }[mode];
    for (const [key, button] of Object.entries(actions)) button.setAttribute('aria-pressed', key === 'sticks' ? !!app.sticks?.live : armed && key === pressed);
    for (const b of modes.children) { b.disabled = !isMine; b.setAttribute('aria-pressed', b.dataset.mode === mode); }

    for (const b of switches.children) {
      const known = station.params.get(b.dataset.param);
      b.disabled = !known || !app.isAtLeast('engineer');
      b.setAttribute('aria-pressed', !!known?.value);
    }
    if (!s) return;
    const loc = s.loc_state;
    set('localization', loc === 2 ? 'good' : loc === 1 ? 'warn' : 'bad', `${t(`loc_${loc}`)} · ${t('fit', { n: num(s.loc_fit * 100, 0) })} · ${num(s.particles, 0)}`);
    set('rangers', s.rangers ? 'good' : 'bad', t(s.rangers ? 'speaking' : 'silent'));
    set('fc', s.fc ? 'good' : 'bad', s.fc ? `${num(s.fc_hz, 0)}/s · ${num(s.fc_ms, 1)} ms` : t('silent'));
    set('loop', s.missed > (app.missedBefore ?? s.missed) ? 'warn' : 'good', t('missed', { n: num(s.missed, 0) }));
    app.missedBefore = s.missed;
    const ms = app.link.latency;
    set('link', !app.link.isOpen ? 'bad' : ms > 150 ? 'warn' : 'good', `${num(ms, 0)} ms · ${num(app.rate, 0)} kB/s`);
    set('battery', s.battery < 0.15 ? 'bad' : s.battery < 0.3 ? 'warn' : 'good', `${num(s.volts, 1)} V · ${num(s.amps, 1)} A · ${num(s.battery * 100, 0)} %`);
  }
  return { el: pane, update, actions, draw: pad.draw, show: camera.show, hide: camera.hide };
}

/** A knob that must be pulled all the way; by keys: three times right. */
function slider(label, done) {
  const text = h('span', label);
  const el = h('div.slide', { role: 'slider', tabIndex: 0, 'aria-label': label, 'aria-valuemin': 0, 'aria-valuemax': 100 }, text, h('i', icon('wing', 20)));
  let enabled = true;
  let at = 0;
  let from = null;
  const set = (v) => {
    at = Math.max(0, Math.min(1, v));
    el.style.setProperty('--at', at);
    el.setAttribute('aria-valuenow', Math.round(at * 100));
  };
  const release = () => {
    if (from === null) return;
    from = null;
    const isDone = at > 0.96;
    toggle(el, 'back', true);
    set(0);
    if (isDone) done();
  };
  el.addEventListener('pointerdown', (e) => {
    if (!enabled || e.offsetX > 62) return;
    el.setPointerCapture(e.pointerId);
    toggle(el, 'back', false);
    from = e.clientX;
  });
  el.addEventListener('pointermove', (e) => { if (from !== null) set((e.clientX - from) / (el.clientWidth - 50)); });
  el.addEventListener('pointerup', release);
  el.addEventListener('pointercancel', () => { from = null; set(0); });
  el.addEventListener('keydown', (e) => {
    if (!enabled || e.repeat || (e.key !== 'ArrowRight' && e.key !== 'ArrowLeft')) return;
    e.preventDefault();
    toggle(el, 'back', true);
    set(at + (e.key === 'ArrowRight' ? 0.34 : -0.34));
    if (at > 0.96) { set(0); done(); }
  });
  el.addEventListener('blur', () => set(0));
  return {
    el,
    enable: (on) => { if (on === enabled) return; enabled = on; el.setAttribute('aria-disabled', !on); if (!on) { from = null; set(0); } },
    say: (words, why) => { put(text, words); el.title = why; },
  };
}
