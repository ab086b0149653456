/* All frames as pictures, some of them by choice, and the cameras of the scene from above. Only what is in sight has
elements. */

import {byId, calls, el, locals, send} from './core.mjs';
import {address, frames, told, want, watch} from './timeline.mjs';

const KINDS = {wrong: ['with failures', 'all correct'], open: ['open', 'settled']};
const WIDE = 264, HIGH = 218, UNKNOWN = 255;
const grid = byId('frame-grid'), top = el('div', 'grid-head'), shots = el('div', 'shots'), room = shots.appendChild(el('div', 'room')), host = el('div', 'plan');
let which = 'all', listed = [], at = 0, items = new Map(), waiting = 0, plan = null, back = null;

/* Numbers of the frames of the choice. */
const choose = () => {
  if (!KINDS[frames.kind]?.includes(which)) which = 'all';
  const bad = which === KINDS[frames.kind]?.[0], all = [...frames.shares.keys()];
  listed = which === 'all' ? all : all.filter(n => frames.shares[n] !== UNKNOWN && bad === frames.shares[n] > 0);
  at = Math.max(0, listed.indexOf(frames.at));
};

// ---- pictures in rows that scroll

const across = () => Math.max(1, Math.floor(room.clientWidth / WIDE));
const size = () => {
  const w = Math.floor(room.clientWidth / across());
  return {w, h: Math.round(HIGH * w / WIDE)};
};
const draw = () => {
  if (grid.hidden || !shots.clientWidth) return;
  const {w, h} = size(), n = across(), {scrollTop, clientHeight} = shots;
  room.style.height = Math.ceil(listed.length / n) * h + 'px';
  shots.dataset.empty = listed.length ? '' : `no frame is “${which}”`;
  const from = Math.floor(scrollTop / h) * n, to = Math.min(listed.length, Math.ceil((scrollTop + clientHeight) / h) * n);
  for (const [k, item] of items) if (k < from || k >= to) { item.remove(); items.delete(k); }
  for (let k = from; k < to; k++) {
    if (!items.has(k)) {
      const item = room.appendChild(el('div', 'shot'));
      item.id = `grid-${k}`;
      item.setAttribute('role', 'option');
      items.set(k, item);
    }
    dress(items.get(k), k, {w, h});
  }
  // Not while a hand is still scrolling.
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    want(listed.slice(from, to));
    for (const [k, item] of items) { const image = item.querySelector('img'); if (!image.getAttribute('src')) image.src = address(listed[k]); }
  }, frames.rows.size > 1 ? 60 : 0);
};
const dress = (item, k, {w, h}) => {
  const n = listed[k], row = frames.rows.get(n), name = row?.[1] ?? '', words = row && frames.kind !== 'depth' ? told(n) : '', odd = frames.odd.get(n) ?? '';
  item.style.transform = `translate(${(k % across()) * w}px, ${Math.floor(k / across()) * h}px)`;
  item.style.width = w + 'px';
  item.style.height = h + 'px';
  item.setAttribute('aria-setsize', listed.length);
  item.setAttribute('aria-posinset', k + 1);
  item.setAttribute('aria-selected', n === frames.at);
  item.classList.toggle('cursor', k === at);
  const key = [n, name, words, odd].join('\n');
  if (item.dataset.key === key) return;
  item.dataset.key = key;
  item.title = [name, words, odd].filter(Boolean).join(': ');
  item.setAttribute('aria-label', item.title || `frame ${n + 1}`);
  const image = el('img'), foot = el('div', 'foot'), share = frames.shares[n];
  image.alt = '';
  image.draggable = false;
  image.addEventListener('error', () => { if (image.src) item.classList.add('broken'); });
  foot.append(el('span', 'name', name), ...(odd ? [el('span', 'odd', '▾ odd')] : []), ...(words ? [el('span', share ? 'bad' : 'well', words)] : []));
  item.replaceChildren(image, foot);
  if (words && share !== UNKNOWN) item.appendChild(el('div', 'tally')).appendChild(el('i')).style.width = share / 2.54 + '%';
};
const move = to => {
  at = Math.min(Math.max(0, to), listed.length - 1);
  const {h} = size(), y = Math.floor(at / across()) * h;
  // As high as it is now it can be scrolled so far.
  draw();
  if (y < shots.scrollTop || y + h > shots.scrollTop + shots.clientHeight) shots.scrollTop = y - (shots.clientHeight - h) / 2;
  draw();
  shots.setAttribute('aria-activedescendant', `grid-${at}`);
};
const open = n => { locals.closeFrames(); send('frame:' + n); };
shots.id = 'grid-list';
shots.tabIndex = 0;
shots.setAttribute('role', 'listbox');
shots.setAttribute('aria-label', 'Frames');
shots.addEventListener('scroll', draw, {passive: true});
// The plan comes later, and takes some of the width: the chosen picture stays in sight.
new ResizeObserver(() => (listed.length ? move(at) : draw())).observe(shots);
shots.addEventListener('click', e => { const item = e.target.closest('.shot'); if (item) open(listed[item.id.slice(5)]); });
shots.addEventListener('keydown', e => {
  const n = across(), page = n * Math.max(1, Math.floor(shots.clientHeight / size().h));
  const step = {ArrowRight: 1, ArrowLeft: -1, ArrowDown: n, ArrowUp: -n, PageDown: page, PageUp: -page, Home: -listed.length, End: listed.length}[e.key];
  if (step !== undefined) move(at + step);
  else if ((e.key === 'Enter' || e.key === ' ') && listed.length) open(listed[at]);
  else return;
  e.preventDefault();
  e.stopPropagation();
});

// ---- the window over the page

const titled = () => {
  const count = (listed.length === frames.count ? '' : listed.length.toLocaleString('en') + ' of ') + frames.count.toLocaleString('en') + ' frames';
  const group = el('div', 'seg'), close = el('button', 'try', 'Close'), held = top.contains(document.activeElement) && document.activeElement.dataset.local;
  for (const kind of ['all', ...KINDS[frames.kind] ?? []]) {
    const one = group.appendChild(el('button', '', kind));
    one.dataset.local = 'framesOf:' + kind;
    one.setAttribute('role', 'radio');
    one.setAttribute('aria-checked', kind === which);
  }
  group.setAttribute('role', 'radiogroup');
  group.setAttribute('aria-label', 'which frames');
  close.dataset.local = 'closeFrames';
  close.title = 'back (Escape)';
  for (const one of [close, ...group.children]) one.type = 'button';
  top.replaceChildren(el('h2', '', `${frames.name}: ${count}`), ...(group.children.length > 1 ? [group] : []), el('span', 'grow'), close);
  if (held) top.querySelector(`[data-local="${held}"]`)?.focus();
};
const filled = () => {
  choose();
  titled();
  draw();
  move(at);
  drawPlan();
};
watch(() => {
  if (grid.hidden) return;
  grid.dataset.kind = frames.kind;
  draw();
  drawPlan();
});
locals.framesOf = (_, kind) => { which = kind; filled(); };
locals.frames = () => {
  if (frames.count < 2) return;
  if (!grid.firstChild) { const body = el('div', 'grid-body'); body.append(shots, host); grid.append(top, body); }
  back = document.activeElement;
  plan = null;
  grid.hidden = false;
  grid.dataset.kind = frames.kind;
  byId('work').inert = byId('timeline').inert = true;
  send('frame-plan');
  filled();
  shots.focus();
};
locals.closeFrames = () => {
  if (grid.hidden) return;
  grid.hidden = true;
  byId('work').inert = byId('timeline').inert = false;
  back?.focus?.();
};
calls.frameGrid = () => locals.frames();
window.addEventListener('keydown', e => {
  if (grid.hidden || byId('dialog-window')) return;
  if (e.key === 'Escape' || (e.shiftKey && e.key === 'W')) { locals.closeFrames(); e.preventDefault(); e.stopPropagation(); }
  // What is below is not acted on meanwhile.
  else if (!['Tab', 'Enter', ' '].includes(e.key) && !grid.contains(e.target)) { e.preventDefault(); e.stopPropagation(); }
}, true);

// ---- the cameras of the scene from above

const SVG = 'http://www.w3.org/2000/svg';
const svg = (name, attributes) => {
  const e = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) e.setAttribute(key, value);
  return e;
};
calls.plan = data => { plan = data; drawPlan(); };

const drawPlan = () => {
  host.hidden = !plan;
  if (!plan || grid.hidden) return;
  const side = Math.round(Math.min(340, Math.max(220, innerWidth * .24))), air = 22;
  const xs = plan.positions.map(p => p[0]), ys = plan.positions.map(p => p[1]);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((side - 2 * air) / Math.max(x1 - x0, .3), (side - 2 * air) / Math.max(y1 - y0, .3));
  const spots = plan.positions.map(([x, y]) => [side / 2 + (x - (x0 + x1) / 2) * scale, side / 2 - (y - (y0 + y1) / 2) * scale]);
  const odd = plan.frames.map(n => frames.odd.get(n)), here = plan.frames.indexOf(frames.at), count = odd.filter(Boolean).length;
  const drawn = svg('svg', {viewBox: `0 0 ${side} ${side}`, width: side, height: side, role: 'img',
    'aria-label': `${plan.frames.length} cameras of ${plan.scene} from above, ${count} odd; a click opens the nearest`});
  // What must be seen is drawn last.
  const weight = k => (k === here ? 2 : odd[k] ? 1 : 0), order = spots.map((_, k) => k).sort((a, b) => weight(a) - weight(b));
  for (const k of order) {
    const [x, y] = spots[k], [a, b] = plan.headings[k], r = k === here ? 17.6 : 12.8;
    const one = svg('g', {class: 'camera' + (k === here ? ' here' : '') + (odd[k] ? ' odd' : '')});
    const name = one.appendChild(svg('title', {}));
    name.textContent = [plan.ids[k], odd[k]].filter(Boolean).join(': ');
    if (a || b) one.append(svg('path', {d: `M${x} ${y}L${x + r * (a + b * .5)} ${y - r * (b - a * .5)}L${x + r * (a - b * .5)} ${y - r * (b + a * .5)}Z`}));
    one.append(svg('circle', {cx: x, cy: y, r: k === here ? 5.6 : 4}));
    if (odd[k]) one.append(svg('path', {class: 'mark', d: `M${x - 5} ${y - 16}h10l-5 9z`}));
    drawn.append(one);
  }
  const metres = [5, 2, 1, .5, .2, .1, .05, .02, .01].find(m => m * scale <= side / 3) || .01;
  drawn.append(svg('path', {class: 'metre', d: `M6 ${side - 5}v-3v3h${metres * scale}v-3`}));
  const label = drawn.appendChild(svg('text', {x: 10 + metres * scale, y: side - 4}));
  label.textContent = metres < .1 ? `${metres * 100} cm` : `${metres} m`;
  drawn.addEventListener('click', e => {
    const b = drawn.getBoundingClientRect(), to = [(e.clientX - b.left) * side / b.width, (e.clientY - b.top) * side / b.height];
    const far = spots.map(([x, y]) => Math.hypot(x - to[0], y - to[1])), near = far.indexOf(Math.min(...far));
    if (far[near] < 28) open(plan.frames[near]);
  });
  const heads = [el('h3', '', `Cameras of ${plan.scene} from above`), ...(count ? [el('p', 'odd', `▾ ${count} odd`)] : [])];
  host.replaceChildren(...heads, drawn);
};
