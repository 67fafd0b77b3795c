// What was said, who did what, and the flight logs on board.

import { h, icon } from './dom.js';
import { get } from './login.js';
import { t } from './words.js';

const AUDIT = ['actions', 'logins', 'intrusions'];

export function logsPane(app) {
  let shown = 'messages';
  const list = h('ul.list');
  const kinds = ['messages', ...(app.isAtLeast('admin') ? AUDIT : []), ...(app.isAtLeast('engineer') ? ['files'] : [])];
  const tabs = h('div.segments', { role: 'group' }, kinds.map((k) => h('button', { 'data-kind': k, onclick: () => select(k) }, t(k))));
  const el = h('div.pane', { role: 'tabpanel' }, h('div.full', tabs), h('section.card.full', list));
  let count = -1;

  const time = (at) => h('time', at.toLocaleTimeString([], { hour12: false }));
  const empty = () => list.replaceChildren(h('li.faint', t('nothing')));

  async function select(kind) {
    shown = kind;
    count = -1;
    for (const b of tabs.children) b.setAttribute('aria-pressed', b.dataset.kind === kind);
    if (kind === 'messages') return update();
    list.replaceChildren(h('li.faint', '…'));
    try {
      if (kind === 'files') {
        const files = await get('/api/logs');
        if (!files.length) return empty();
        list.replaceChildren(...files.sort((a, b) => b.name.localeCompare(a.name)).map((f) => h('li', h('span', { style: { flex: 1 } }, f.name), h('span.faint', `${(f.bytes / 1e6).toFixed(1)} MB`), h('a', { href: `/api/logs/${encodeURIComponent(f.name)}`, download: f.name }, t('save')))));
        return;
      }
      const rows = await get(`/api/audit/${kind}`);
      if (!rows.length) return empty();
      list.replaceChildren(...rows.map((r) => h('li', time(new Date(r.at_us / 1000)), h('b', r.user || '–'), h('span', { style: { flex: 1 } }, r.what), h('span.faint', r.place))));
    } catch (e) { list.replaceChildren(h('li.bad', e.message)); }
  }

  function update() {
    if (shown !== 'messages' || count === app.texts.length) return;
    count = app.texts.length;
    if (!count) return empty();
    const tone = (s) => (s <= 3 ? 'bad' : s === 4 ? 'warn' : s === 5 ? 'info' : 'faint');
    list.replaceChildren(...[...app.texts].reverse().map((m) => h('li', time(m.at), h(`span.${tone(m.severity)}`, { style: { 'align-self': 'center' } }, icon(m.severity <= 4 ? 'warn' : 'info', 13)), h('span', m.text))));
  }
  select('messages');
  return { el, update, show: () => { if (shown !== 'messages') select(shown); } };
}
