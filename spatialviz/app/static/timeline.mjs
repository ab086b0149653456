/* All frames of the dataset as one bar: the share of each that is wrong, open or without depth, and where one is. Hover
shows a frame, a drag passes frames by and opens the last. The shares come once (`timeline`); ids and counts of single
frames come by their numbers (`frame-rows`), pictures by their address. */

import {byId, calls, el, fields, send} from './core.mjs';

const UNKNOWN = 255, ALL = 254, ROOM = 12, NAME = 96, REST_MS = 350, PICTURE_MS = 80;
const NAMES = {
  wrong: {bad: 'wrong', none: 'no answer of the run'},
  open: {bad: 'open', none: 'nothing to review'},
  depth: {bad: 'of the depth missing', none: 'depth not looked at'},
};

export const frames = {name: '', source: 0, kind: 'depth', read: false, at: 0, count: 0, shares: new Uint8Array(), scenes: [], odd: new Map(), rows: new Map()};
export const address = n => `app/frame/${frames.source}/${n}/480.jpg`;

let asked = new Set();
export const want = numbers => {
  const more = numbers.filter(n => !frames.rows.has(n) && !asked.has(n));
  for (const n of more) asked.add(n);
  if (more.length) send('frame-rows', more);
};
const forget = () => { frames.rows = new Map(); asked = new Set(); };

/* What is wrong, open or missing of a frame, in words. */
export const told = n => {
  const share = frames.shares[n], [,, well = 0, bad = 0] = frames.rows.get(n) || [], {bad: word, none} = NAMES[frames.kind];
  if (share === UNKNOWN) return frames.read ? none : 'depth is being looked at';
  return frames.kind === 'depth' ? `${Math.round(100 * share / ALL)} % ${word}` : `${bad} of ${well + bad} ${word}`;
};

// ---- the bar

const bar = el('div'), canvas = bar.appendChild(el('canvas')), here = bar.appendChild(el('div', 'here')), scenes = el('div', 'scenes'), legend = el('div', 'legend');
const preview = el('figure', 'passing'), picture = preview.appendChild(el('img')), caption = preview.appendChild(el('figcaption'));
bar.id = 'frame-bar';
bar.tabIndex = 0;
bar.setAttribute('role', 'slider');
bar.setAttribute('aria-label', 'Frames');
bar.setAttribute('aria-valuemin', 1);
picture.alt = '';
preview.hidden = true;
let cursor = -1, timer = 0, picturing = 0;

const columns = () => Math.max(1, Math.min(frames.count, Math.floor(bar.clientWidth)));
const span = k => [Math.floor(k * frames.count / columns()), Math.floor((k + 1) * frames.count / columns())];
const columnOf = n => Math.floor((n + .5) * columns() / frames.count);
/* The frame of the highest known share in a column: it is the one that the column shows. */
const highest = k => {
  const [from, to] = span(k);
  let best = from, most = -1;
  for (let n = from; n < to; n++) if (frames.shares[n] !== UNKNOWN && frames.shares[n] > most) { most = frames.shares[n]; best = n; }
  return [best, most];
};
const under = e => {
  const b = bar.getBoundingClientRect(), near = n => Math.abs((columnOf(n) + .5) / columns() * b.width - e.clientX + b.left);
  // Marks are wider than a column.
  const marks = b.width / columns() < 8 ? [...frames.odd.keys()].filter(n => near(n) < 4).sort((m, n) => near(m) - near(n)) : [];
  return marks[0] ?? highest(Math.min(columns() - 1, Math.max(0, Math.floor((e.clientX - b.left) / b.width * columns()))))[0];
};

/* Share of the full height: what is 2 % everywhere is seen, too. */
const SCALES = [.05, .1, .25, .5, 1];
let scaleTop = 1;
const scaled = () => {
  const most = frames.shares.reduce((m, s) => (s === UNKNOWN || s < m ? m : s), 0) / ALL;
  scaleTop = SCALES.find(s => most <= s + .004);
};
const draw = () => {
  const wide = bar.clientWidth, high = bar.clientHeight, scale = devicePixelRatio;
  if (!wide || !frames.count) return;
  canvas.width = Math.round(wide * scale);
  canvas.height = Math.round(high * scale);
  const paint = canvas.getContext('2d'), look = getComputedStyle(bar), color = name => look.getPropertyValue('--' + name).trim();
  const all = columns(), each = canvas.width / all, gap = each >= 6 * scale ? scale : 0, top = ROOM * scale, room = canvas.height - top;
  const [none, rest, bad, odd] = ['none', 'rest', 'part', 'odd'].map(color);
  let last = -1;
  for (let k = 0; k < all; k++) {
    const x = Math.round(k * each), w = Math.max(1, Math.round((k + 1) * each) - x - gap), [, found] = highest(k);
    // Of many frames the depth of some is looked at: what is between is taken for the same.
    const most = found < 0 && frames.kind === 'depth' ? last : last = found, part = most < 0 ? 0 : Math.max(most ? 2 * scale : 0, Math.min(room, Math.round(room * most / ALL / scaleTop)));
    paint.fillStyle = most < 0 ? none : rest;
    paint.fillRect(x, top, w, room - part);
    paint.fillStyle = bad;
    paint.fillRect(x, top + room - part, w, part);
  }
  paint.fillStyle = color('panel');
  if (frames.scenes.length * 6 < wide) for (const [n] of frames.scenes.slice(1)) paint.fillRect(Math.round(columnOf(n) * each) - scale, top, 2 * scale, room);
  paint.fillStyle = odd;
  for (const n of frames.odd.keys()) {
    const x = (columnOf(n) + .5) * each;
    paint.beginPath();
    for (const [a, b] of [[-4, 1], [4, 1], [0, 9]]) paint.lineTo(x + a * scale, b * scale);
    paint.fill();
  }
  named();
  marked();
};

/* Scenes by their ids, as far as there is room; what the colours mean. */
const named = () => {
  const wide = bar.clientWidth, ends = [...frames.scenes.slice(1).map(([n]) => n), frames.count], {bad} = NAMES[frames.kind];
  const keys = frames.kind === 'depth' && !frames.read ? ['looking at the depth of all frames …'] : [el('i'), `full bar: ${100 * scaleTop} % ${bad}`];
  legend.replaceChildren(...(frames.odd.size ? [`▾ ${frames.odd.size} odd`] : []), ...keys);
  const room = wide - legend.offsetWidth - 16;
  let free = 0;
  scenes.replaceChildren(...frames.scenes.flatMap(([n, scene], k) => {
    const x = n / frames.count * wide, own = ends[k] / frames.count * wide - x, most = Math.min(Math.max(own, NAME) - 8, room - x);
    if (x < free || most < NAME / 2) return [];
    const one = el('span', '', scene);
    one.title = scene;
    one.style.left = x + 'px';
    one.style.maxWidth = most + 'px';
    free = x + NAME;
    return [one];
  }));
};

/* Where one is, or is about to go. */
const marked = () => {
  const n = cursor < 0 ? frames.at : cursor, all = columns(), k = columnOf(n), row = frames.rows.get(n);
  here.style.left = 100 * k / all + '%';
  here.style.width = 100 / all + '%';
  here.classList.toggle('narrow', bar.clientWidth / all < 8);
  bar.setAttribute('aria-valuemax', frames.count);
  bar.setAttribute('aria-valuenow', n + 1);
  bar.setAttribute('aria-valuetext', [`frame ${n + 1} of ${frames.count}`, row && `${row[1]}: ${told(n)}`, frames.odd.get(n)].filter(Boolean).join(', '));
  want([n]);
};

// ---- a frame in passing

const show = n => {
  const [from, to] = span(columnOf(n)), row = frames.rows.get(n), odd = frames.odd.get(n), b = bar.getBoundingClientRect();
  want([n]);
  preview.dataset.frame = n;
  const lines = [el('b', '', row ? row[1] : `frame ${n + 1}`), el('span', '', row ? told(n) : '…')];
  if (odd) lines.push(el('span', 'odd', `▾ ${odd}`));
  lines.push(el('span', 'dim', `frame ${(n + 1).toLocaleString('en')} of ${frames.count.toLocaleString('en')}` + (to - from > 1 ? `, the highest of ${to - from} here` : '')));
  caption.replaceChildren(...lines);
  preview.hidden = false;
  const wide = preview.offsetWidth, x = b.left + (columnOf(n) + .5) * b.width / columns();
  preview.style.left = Math.min(Math.max(8, x - wide / 2), innerWidth - wide - 8) + 'px';
  picturing ||= setTimeout(() => {
    picturing = 0;
    const wanted = address(preview.dataset.frame);
    if (picture.getAttribute('src') !== wanted) { preview.classList.remove('broken'); picture.src = wanted; }
  }, PICTURE_MS);
};
const hide = (to = -1) => {
  clearTimeout(timer);
  preview.hidden = true;
  cursor = to;
  marked();
};
const leave = () => { if (!preview.hidden) hide(); };
/* The mark stays where one is going until the server is there. */
const open = n => {
  const other = n !== frames.at;
  hide(other ? n : -1);
  if (other) send('frame:' + n);
};
picture.addEventListener('error', () => preview.classList.add('broken'));

let held = false;
bar.addEventListener('pointermove', e => {
  const n = under(e);
  if (held) { cursor = n; marked(); }
  if (e.pointerType !== 'touch' || held) show(n);
});
bar.addEventListener('pointerdown', e => {
  if (e.button) return;
  held = true;
  bar.setPointerCapture(e.pointerId);
  cursor = under(e);
  show(cursor);
  marked();
});
bar.addEventListener('pointerup', e => { if (held) { held = false; open(under(e)); } });
for (const kind of ['pointercancel', 'pointerleave']) bar.addEventListener(kind, () => { if (kind === 'pointercancel') held = false; if (!held) leave(); });

// A key goes on, and what it rests on is opened.
bar.addEventListener('keydown', e => {
  const page = Math.max(10, Math.round(frames.count / 20)), at = cursor < 0 ? frames.at : cursor;
  const to = {ArrowRight: at + 1, ArrowUp: at + 1, ArrowLeft: at - 1, ArrowDown: at - 1, PageUp: at + page, PageDown: at - page, Home: 0, End: frames.count - 1}[e.key];
  if (e.ctrlKey || e.altKey || e.metaKey) return;
  if (to !== undefined) {
    cursor = Math.min(Math.max(0, to), frames.count - 1);
    show(cursor);
    marked();
    clearTimeout(timer);
    timer = setTimeout(() => open(cursor), REST_MS);
  } else if (e.key === 'Enter' || e.key === ' ') { if (cursor >= 0) open(cursor); }
  else if (e.key === 'Escape' && cursor >= 0) hide();
  else return;
  e.preventDefault();
  e.stopPropagation();
});
bar.addEventListener('blur', leave);

// ---- what the server says

const watching = [];
/* Calls a function after every change of the frames. */
export const watch = follow => watching.push(follow);
const changed = () => {
  const foot = byId('timeline');
  foot.hidden = frames.count < 2;
  foot.dataset.kind = frames.kind;
  scaled();
  draw();
  for (const follow of watching) follow();
};
calls.timeline = data => {
  const other = data.name !== frames.name;
  forget();
  Object.assign(frames, data, {shares: Uint8Array.from(atob(data.shares), c => c.charCodeAt(0))}, other ? {odd: new Map()} : {});
  frames.count = frames.shares.length;
  cursor = -1;
  changed();
};
calls.frameShares = some => {
  for (const [n, share] of some) frames.shares[n] = share;
  forget();
  changed();
};
calls.oddFrames = ({name, frames: found}) => {
  if (name === frames.name) { frames.odd = new Map(found); changed(); }
};
calls.frameRows = rows => {
  for (const row of rows) frames.rows.set(row[0], row);
  marked();
  const n = +preview.dataset.frame;
  if (!preview.hidden && rows.some(([k]) => k === n)) show(n);
  for (const follow of watching) follow();
};
calls.frameAt = at => {
  frames.at = at;
  if (preview.hidden) cursor = -1;
  marked();
  for (const follow of watching) follow();
};

/* The id of the frame, typed. */
const offer = (_, field) => send('frame-typed:' + (field.value === field.defaultValue ? '' : field.value));
fields.frame = {input: offer, focus: (_, field) => { field.select(); offer(_, field); }};
calls.frameIds = ids => byId('frame-ids').replaceChildren(...ids.map(id => Object.assign(el('option'), {value: id})));

const low = el('div', 'bar-foot');
low.append(scenes, legend);
byId('frames').append(bar, low);
byId('timeline').append(preview);
new ResizeObserver(draw).observe(bar);
new MutationObserver(draw).observe(document.documentElement, {attributeFilter: ['data-theme']});
