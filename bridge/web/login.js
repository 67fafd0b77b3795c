// The door: name and password, the link of the terminal, or the code that makes the first user.

import { h, put } from './dom.js';
import { t } from './words.js';

let vehicle = '';

/** Off the drone: the vehicle that everything about a vehicle is asked of from now on. */
export function choose(name) { vehicle = name; }

/** The path of what is about the vehicle: its own console's, or the one of several. */
export const below = (path) => (vehicle ? `/api/vehicles/${encodeURIComponent(vehicle)}/${path.replace(/^\/(api\/)?/, '')}` : path);

export async function post(path, body = {}) {
  const answer = await fetch(path, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) });
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw Object.assign(new Error(said.detail || answer.statusText), { status: answer.status });
  return said;
}

export async function get(path) {
  const answer = await fetch(path);
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw Object.assign(new Error(said.detail || answer.statusText), { status: answer.status });
  return said;
}

/** The session: the one there is, the one the link opens, or the one the user logs in to. */
export async function session(app, why = '') {
  const [, kind, key] = location.hash.match(/^#(enter|setup)=([0-9a-f]+)$/) ?? [];
  // The key is used once and must not stay in the history.
  if (kind === 'enter') history.replaceState(null, '', '/');
  let problem = why;
  if (kind === 'enter') {
    try { return await post('/api/enter', { key }); } catch (e) { problem = e.message; }
  }
  try { return await get('/api/session'); } catch (e) { if (e.status !== 401) problem = e.message; }
  return form(app, kind === 'setup' ? key : null, problem);
}

function form(app, code, problem) {
  return new Promise((resolve) => {
    const said = h('div.problem', { role: 'alert' }, problem);
    const user = h('input.input', { name: 'username', autocomplete: 'username', required: true, maxLength: 32, autofocus: true });
    const password = h('input.input', { name: 'password', type: 'password', autocomplete: code ? 'new-password' : 'current-password', required: true, maxLength: 256, minLength: code ? 10 : 1 });
    const button = h('button.button.primary', t(code ? 'create' : 'enter'));
    const submit = async (e) => {
      e.preventDefault();
      button.disabled = true;
      try {
        const body = { user: user.value, password: password.value };
        resolve(await post(code ? '/api/setup' : '/api/login', code ? { ...body, code } : body));
        history.replaceState(null, '', '/');
      } catch (error) {
        put(said, error.message);
        password.value = '';
        password.focus();
      }
      button.disabled = false;
    };
    app.replaceChildren(h('main.door', h('form', { onsubmit: submit },
      h('img', { src: '/icon.svg', alt: '' }),
      h('h1', t(code ? 'setup' : 'title')),
      h('p', t(code ? 'setup_why' : 'login_why')),
      h('label.field', t('user'), user),
      h('label.field', t(code ? 'new_password' : 'password'), password),
      button, said)));
    user.focus();
  });
}
