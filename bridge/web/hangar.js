// Off the drone: which vehicle. For administrators also which there are, whose they are, users, and what was done.

import { h, icon, put, toggle } from './dom.js';
import { get, post } from './login.js';
import { logsPane } from './logs.js';
import { peoplePane } from './people.js';
import { current, languages, speak, t } from './words.js';

const POLL_MS = 3000;

/** Resolves with the name of the vehicle that is chosen. */
export async function hangar(root, who, over) {
  const isAdmin = who.role === 'admin';
  const [, named] = location.hash.match(/^#at=(.+)$/) ?? [];
  const wanted = named && decodeURIComponent(named);
  if (who.vehicles.includes(wanted)) return wanted;
  if (!isAdmin && who.vehicles.length === 1) return who.vehicles[0];
  return new Promise((resolve) => {
    const toasts = h('div.toasts', { 'aria-live': 'polite' });
    const app = {
      isAtLeast: () => isAdmin,
      texts: [],
      tell(level, text) {
        const toast = h(`div.toast.${level}`, text);
        toasts.append(toast);
        setTimeout(() => toast.remove(), 5000);
      },
    };
    const attempt = async (job) => { try { await job(); await load(); } catch (e) { app.tell('bad', e.message); } };
    const open = (name) => {
      clearInterval(timer);
      location.hash = `at=${encodeURIComponent(name)}`;
      resolve(name);
    };
    const tool = (glyph, label, run) => h('button.tool', { title: label, 'aria-label': label, onclick: run }, icon(glyph));
    const dark = () => document.documentElement.dataset.theme === 'dark';
    const theme = tool(dark() ? 'sun' : 'moon', t('light'), () => {
      const next = dark() ? 'light' : 'dark';
      document.documentElement.dataset.theme = next;
      localStorage.setItem('theme', next);
      theme.replaceChildren(icon(dark() ? 'sun' : 'moon'));
    });
    const top = h('header.top',
      h('div.brand', h('img', { src: '/icon.svg', alt: '' }), h('span', 'Kestrel'), h('span', t('vehicles'))), h('span.spread'),
      h('span.soft', `${who.user} · ${who.role}`),
      h('button.tool', { title: t('language'), 'aria-label': t('language'), onclick: () => speak(languages[(languages.indexOf(current()) + 1) % languages.length]) }, current().toUpperCase()),
      theme, tool('cross', `${t('logout')} (${who.user})`, async () => { await post('/api/logout').catch(() => {}); location.hash = ''; location.reload(); }));

    const cards = h('div.cards');
    const none = h('p.soft.hidden', t(isAdmin ? 'no_vehicles_admin' : 'no_vehicles'));
    const url = h('input.input', { required: true, placeholder: 'https://drone.local:8443/#key=…', autocomplete: 'off', spellcheck: false, 'aria-label': t('vehicle_url') });
    const name = h('input.input', { maxLength: 32, pattern: '[A-Za-z0-9][A-Za-z0-9._\\-]*', autocomplete: 'off', 'aria-label': t('name') });
    const add = h('form.card.adding', { onsubmit: (e) => { e.preventDefault(); attempt(async () => { await post('/api/fleet', { name: name.value || null, url: url.value }); add.reset(); }); } },
      h('h2', icon('plus', 15), t('add_vehicle')),
      h('label.field', t('vehicle_url'), url), h('label.field', t('vehicle_name'), name),
      h('small.soft', t('vehicle_url_why')), h('button.button.primary', t('add_vehicle')));
    const main = h('main.hangar', toasts, h('div.inner', h('h1', t('vehicles')), none, cards, isAdmin ? add : null));
    const shell = h('div.shell', top, main);
    toggle(shell, 'alone', !isAdmin);
    if (isAdmin) {
      const holder = h('div.scroll');
      const panes = { people: peoplePane({ ...app, onPeople: () => load() }), log: logsPane(app) };
      const buttons = [['people', 'user'], ['log', 'list']].map(([key, glyph]) => h('button', { role: 'tab', 'aria-selected': 'false', 'data-tab': key, onclick: () => select(key) }, icon(glyph, 19), t(key)));
      const select = (key) => {
        for (const b of buttons) b.setAttribute('aria-selected', b.dataset.tab === key);
        holder.replaceChildren(panes[key].el);
        panes[key].show?.();
      };
      shell.append(h('aside.rail', h('nav.tabs', { role: 'tablist' }, buttons), holder));
      select('people');
    }
    root.replaceChildren(shell);
    const timer = setInterval(() => load().catch(() => {}), POLL_MS);
    load().catch((e) => app.tell('bad', e.message));

    let users = [];
    async function load() {
      try {
        const own = await get('/api/vehicles');
        let all = Object.keys(own).sort().map((n) => ({ name: n, users: [who.user] }));
        if (isAdmin) [all, users] = await Promise.all([get('/api/fleet'), get('/api/users')]);
        if (main.isConnected) draw(own, all);
      } catch (e) {
        if (e.status !== 401) throw e;
        clearInterval(timer);
        over();
      }
    }
    function draw(own, all) {
      toggle(none, 'hidden', all.length > 0);
      const focus = document.activeElement?.dataset?.key;
      cards.replaceChildren(...all.map((v) => {
        const state = own[v.name];
        const level = state?.is_there ? 'good' : state ? 'bad' : '';
        const words = state?.is_there ? t('reachable') : state ? state.why : t('not_yours');
        return h('section.card.craft', { 'data-vehicle': v.name },
          h('div.row', h(`span.dot.${level || 'none'}`), h('b', v.name), h('span.spread'),
            isAdmin ? h('button.tool', { title: t('remove'), 'aria-label': `${t('remove')} ${v.name}`, 'data-key': `remove ${v.name}`, onclick: () => { if (confirm(t('sure_remove', { who: v.name }))) attempt(() => post('/api/fleet/remove', { name: v.name })); } }, icon('trash', 15)) : null),
          h('small.soft', words), v.url ? h('small.faint', v.url) : null,
          isAdmin ? h('small.soft.heading', t('assigned_to')) : null,
          isAdmin ? h('div.assigned', { role: 'group', 'aria-label': t('assigned_to') }, users.map((u) => {
            const on = v.users.includes(u.name);
            return h('button.chip', { 'aria-pressed': on, 'data-key': `${u.name} ${v.name}`, title: t(on ? 'take_away' : 'assign', { who: u.name }), onclick: () => attempt(() => post('/api/fleet/assign', { user: u.name, vehicle: v.name, on: !on })) }, u.name);
          })) : null,
          h('button.button.wide', { className: state?.is_there ? 'button wide primary' : 'button wide', 'data-key': `open ${v.name}`, disabled: !state?.is_there, onclick: () => open(v.name) }, icon('wing', 17), t('open')));
      }));
      if (focus) cards.querySelector(`[data-key="${CSS.escape(focus)}"]`)?.focus();
    }
  });
}
