// Elements without a framework.

/** An element: h('button.primary', {onclick}, 'Text', child ...). Properties starting with `on` are listeners. */
export function h(kind, props = {}, ...children) {
  const [tag, ...classes] = kind.split('.');
  const el = document.createElement(tag || 'div');
  if (classes.length) el.className = classes.join(' ');
  if (props === null || typeof props !== 'object' || props instanceof Node || Array.isArray(props)) {
    children.unshift(props);
    props = {};
  }
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null || (value === false && !name.startsWith('aria-'))) continue;
    if (name.startsWith('on')) el.addEventListener(name.slice(2), value);
    else if (name === 'style') for (const [k, v] of Object.entries(value)) el.style.setProperty(k, v);
    else if (name in el && !name.includes('-') && name !== 'list') el[name] = value;
    else el.setAttribute(name, value === true && !name.startsWith('aria-') ? '' : value);
  }
  for (const child of children.flat(9)) if (child !== null && child !== undefined && child !== false) el.append(child);
  return el;
}

const SVG = 'http://www.w3.org/2000/svg';

/** Drawings of the buttons: paths of a 24 by 24 box, drawn as lines. */
const ICONS = {
  stop: 'M8 3h8l5 5v8l-5 5H8l-5-5V8z',
  up: 'M12 20V5M6 11l6-6 6 6M4 22h16',
  down: 'M12 3v14M6 11l6 6 6-6M4 21h16',
  home: 'M4 11l8-7 8 7M6 10v10h12V10M10 20v-6h4v6',
  hold: 'M9 5v14M15 5v14',
  route: 'M6 19a2 2 0 1 0 0-4 2 2 0 0 0 0 4zM18 9a2 2 0 1 0 0-4 2 2 0 0 0 0 4zM8 17h6a3 3 0 0 0 0-6h-4a3 3 0 0 1 0-6h6',
  pad: 'M7 8h10a5 5 0 0 1 4.6 6.8l-.8 2a2 2 0 0 1-3.4.6L15.5 15h-7l-1.9 2.4a2 2 0 0 1-3.4-.6l-.8-2A5 5 0 0 1 7 8zM8 11v3M6.5 12.5h3M16 11.5h.01M18 13.5h.01',
  plus: 'M12 5v14M5 12h14',
  minus: 'M5 12h14',
  fit: 'M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5',
  follow: 'M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v4M12 18v4M2 12h4M18 12h4',
  layers: 'M12 3l9 5-9 5-9-5zM3 13l9 5 9-5',
  sun: 'M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.4 1.4M17.6 17.6L19 19M5 19l1.4-1.4M17.6 6.4L19 5',
  moon: 'M20 14.5A8.5 8.5 0 0 1 9.5 4a8.5 8.5 0 1 0 10.5 10.5z',
  user: 'M12 12a4 4 0 1 0 0-8 4 4 0 0 0 0 8zM4 21c1-4 4-6 8-6s7 2 8 6',
  trash: 'M4 7h16M9 7V4h6v3M6 7l1 13h10l1-13',
  play: 'M7 4l13 8-13 8z',
  upload: 'M12 16V4M7 9l5-5 5 5M4 20h16',
  check: 'M4 12l6 6L20 6',
  warn: 'M12 3l10 18H2zM12 10v5M12 18h.01',
  info: 'M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 11v6M12 7.5h.01',
  cross: 'M6 6l12 12M18 6L6 18',
  eye: 'M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z',
  chart: 'M4 4v16h16M7 15l4-5 3 3 5-7',
  sliders: 'M5 4v9M5 17v3M12 4v3M12 11v9M19 4v11M19 19v1M3 15h4M10 9h4M17 17h4',
  list: 'M8 6h12M8 12h12M8 18h12M4 6h.01M4 12h.01M4 18h.01',
  wing: 'M3 6c6 0 9 2 9 6 0-4 3-6 9-6-1 5-4 8-9 8S4 11 3 6zM12 14v5M9 19h6',
  record: 'M12 5a7 7 0 1 0 0 14 7 7 0 0 0 0-14zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z',
  camera: 'M3 7h11v10H3zM14 11l7-4v10l-7-4z',
};

export function icon(name, size = 18) {
  const svg = document.createElementNS(SVG, 'svg');
  for (const [k, v] of Object.entries({ viewBox: '0 0 24 24', width: size, height: size, class: 'icon', 'aria-hidden': 'true' })) svg.setAttribute(k, v);
  const path = document.createElementNS(SVG, 'path');
  path.setAttribute('d', ICONS[name] || '');
  svg.append(path);
  return svg;
}

/** Sets a text only if it differs: what has not changed is not laid out again. */
export function put(el, text) {
  if (el.textContent !== text) el.textContent = text;
}

export function toggle(el, name, on) {
  if (el.classList.contains(name) !== on) el.classList.toggle(name, on);
}

export function clear(el) {
  while (el.firstChild) el.firstChild.remove();
  return el;
}

/** A number for people: a thin minus, no "-0", a dash for what is not known. */
export function num(v, digits = 1) {
  if (!Number.isFinite(v)) return '–';
  const text = v.toFixed(digits);
  return Number(text) === 0 ? (0).toFixed(digits) : text.replace('-', '−');
}
