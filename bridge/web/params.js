// Parameters: all of them, with search, range, unit and words.

import { h, num, put, toggle } from './dom.js';
import { below, get } from './login.js';
import { t } from './words.js';

export async function paramsPane(app) {
  const { station } = app;
  const about = await get(below('/api/parameters')).catch(() => []);
  const may = app.isAtLeast('engineer');
  const search = h('input.input', { type: 'search', placeholder: t('search'), 'aria-label': t('search'), oninput: () => filter() });
  const progress = h('span.faint');
  const rows = new Map();
  const list = h('div');
  let section = null;
  for (const p of about) {
    if (p.section !== section) { section = p.section; list.append(h('h2', { style: { margin: '16px 0 4px' }, 'data-section': section }, section)); }
    const input = p.choices
      ? h('select.input.small', { disabled: !may }, p.choices.map(([name, code]) => h('option', { value: code }, name)))
      : h('input.input.small', { type: 'number', step: 'any', min: p.range?.[0], max: p.range?.[1], disabled: !may });
    input.setAttribute('aria-label', p.name);
    input.addEventListener('change', () => {
      if (input.value === '' || !station.params.has(p.name)) return show(p.name);
      const wanted = Number(input.value);
      station.setParam(p.name, wanted);
      input.disabled = true;
      // What the drone says is what counts.
      setTimeout(() => { input.disabled = !may; show(p.name); if (Math.abs((station.params.get(p.name)?.value ?? NaN) - wanted) > 1e-4 * Math.max(1, Math.abs(wanted))) app.tell('warn', `${p.name}: ${t('refused_param')}`); }, 700);
    });
    const unit = p.unit === '1' ? '' : p.unit;
    const range = p.range ? `${num(p.range[0], 0 + (p.range[0] % 1 !== 0))} … ${num(p.range[1], 0 + (p.range[1] % 1 !== 0))} ${unit}` : '';
    const el = h('div.param', h('b', p.name), input, h('small', p.doc, ' ', h('span.faint', `${range ? `${range}, ` : ''}${t('default', { v: `${p.default}${unit ? ` ${unit}` : ''}` })}`)));
    rows.set(p.name, { el, input, p });
    list.append(el);
  }
  const el = h('div.pane', { role: 'tabpanel' }, h('div.full', search, h('div.row', { style: { 'margin-top': '6px' } }, progress)), h('div.full', list));

  function show(name) {
    const row = rows.get(name);
    const known = station.params.get(name);
    if (!row || !known || document.activeElement === row.input) return;
    row.input.value = Number.isInteger(known.value) ? known.value : Number(known.value.toPrecision(7));
    toggle(row.el, 'changed', Math.abs(known.value - Number(row.p.default)) > 1e-6 * Math.max(1, Math.abs(known.value)) && Number.isFinite(Number(row.p.default)));
  }
  function filter() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const seen = new Set();
    for (const { el: row, p } of rows.values()) {
      const text = `${p.name} ${p.doc} ${p.section}`.toLowerCase();
      const fits = words.every((w) => text.includes(w));
      toggle(row, 'hidden', !fits);
      if (fits) seen.add(p.section);
    }
    for (const head of list.querySelectorAll('[data-section]')) toggle(head, 'hidden', !seen.has(head.dataset.section));
  }
  station.addEventListener('param', (e) => { show(e.detail); put(progress, station.params.size < station.paramCount ? t('loading', { n: station.params.size, m: station.paramCount }) : ''); });
  for (const name of station.params.keys()) show(name);
  return { el, show() { if (station.params.size < (station.paramCount || 1)) station.loadParams(); } };
}
