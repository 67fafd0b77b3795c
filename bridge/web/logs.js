// What was said, who did what, and the flight logs on board.

import { h, icon } from './dom.js';
import { below, get } from './login.js';
import { t } from './words.js';

const AUDIT = ['actions', 'logins', 'intrusions'];

export function logsPane(app) {
  let shown;
  const list = h('ul.list');
  // Off the drone and before a vehicle is chosen there are no messages and no files.
  const kinds = [...(app.link ? ['messages'] : []), ...(app.isAtLeast('admin') ? AUDIT : []), ...(app.link && app.isAtLeast('engineer') ? ['files'] : [])];
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
        const files = await get(below('/api/logs'));
        if (!files.length) return empty();
        list.replaceChildren(...files.sort((a, b) => b.name.localeCompare(a.name)).map((f) => h('li', h('span', { style: { flex: 1 } }, f.name), h('span.faint', `${(f.bytes / 1e6).toFixed(1)} MB`), f.name.endsWith('.mcap') && !/-\d+\.mcap$/.test(f.name) ? h('button.link', { onclick: () => look(f.name) }, t('look_again')) : null, h('a', { href: below(`/api/logs/${encodeURIComponent(f.name)}`), download: f.name }, t('save')))));
        return;
      }
      const rows = await get(`/api/audit/${kind}`);
      if (!rows.length) return empty();
      list.replaceChildren(...rows.map((r) => h('li', time(new Date(r.at_us / 1000)), h('b', r.user || '–'), h('span', { style: { flex: 1 } }, r.what), h('span.faint', r.place))));
    } catch (e) { list.replaceChildren(h('li.bad', e.message)); }
  }

  /** The log as a recording of this page: the drone flies it again. */
  async function look(name) {
    app.tell('info', t('looking'));
    try {
      const answer = await fetch(below(`/api/logs/${encodeURIComponent(name)}/recording`));
      if (!answer.ok) throw new Error((await answer.json()).detail);
      await app.time.open(await answer.blob());
    } catch (e) { app.tell('bad', e.message); }
  }

  function update() {
    if (shown !== 'messages' || count === app.texts.length) return;
    count = app.texts.length;
    if (!count) return empty();
    const tone = (s) => (s <= 3 ? 'bad' : s === 4 ? 'warn' : s === 5 ? 'info' : 'faint');
    list.replaceChildren(...[...app.texts].reverse().map((m) => h('li', time(m.at), h(`span.${tone(m.severity)}`, { style: { 'align-self': 'center' } }, icon(m.severity <= 4 ? 'warn' : 'info', 13)), h('span', m.text))));
  }
  select(kinds[0]);
  return { el, update, show: () => { if (shown !== 'messages') select(shown); } };
}
