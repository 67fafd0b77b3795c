// Users, for administrators.

import { h, icon } from './dom.js';
import { get, post } from './login.js';
import { t } from './words.js';

const ROLES = ['viewer', 'pilot', 'engineer', 'admin'];

export function peoplePane(app) {
  const list = h('ul.list');
  const name = h('input.input', { required: true, maxLength: 32, autocomplete: 'off', pattern: '[A-Za-z0-9._@\\-]+' });
  const password = h('input.input', { type: 'password', required: true, minLength: 10, maxLength: 256, autocomplete: 'new-password' });
  const role = h('select.input', ROLES.map((r) => h('option', { value: r }, r)));
  const form = h('form', { onsubmit: add, style: { display: 'grid', gap: '10px' } }, h('label.field', t('name'), name), h('label.field', t('new_password'), password), h('label.field', t('role'), role), h('button.button.primary', icon('plus', 16), t('add_user')));
  const el = h('div.pane', { role: 'tabpanel' }, h('section.card', h('h2', icon('user', 15), t('people')), list), h('section.card', form));

  const attempt = async (job) => { try { await job(); await load(); app.onPeople?.(); } catch (e) { app.tell('bad', e.message); } };
  function add(e) {
    e.preventDefault();
    attempt(async () => { await post('/api/users', { name: name.value, password: password.value, role: role.value }); form.reset(); });
  }
  async function load() {
    const users = await get('/api/users');
    list.replaceChildren(...(users.length ? users : []).map((u) => h('li', { style: { 'align-items': 'center' } },
      h('b', { style: { flex: 1 } }, u.name),
      h('select.input.small', { style: { width: '110px' }, 'aria-label': t('role'), onchange: (e) => attempt(() => post('/api/users', { name: u.name, role: e.target.value })) }, ROLES.map((r) => h('option', { value: r, selected: r === u.role }, r))),
      h('button.tool', { title: t('remove'), 'aria-label': t('remove'), onclick: () => { if (confirm(t('sure_remove', { who: u.name }))) attempt(() => post('/api/users/remove', { name: u.name })); } }, icon('trash', 15)))));
    if (!users.length) list.append(h('li.faint', t('nothing')));
  }
  return { el, show: () => load().catch((e) => app.tell('bad', e.message)) };
}
