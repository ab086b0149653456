// Frames to choose from: a strip below the scene, a grid of all, and the cameras of a scene from above.
// Names and marks come by range (frame-rows), pictures by their address; only what is in sight has elements.

import {byId, calls, el, locals, send} from './core.mjs';

let strip = null, plan = null, rows = new Map(), asked = new Set();
const BLOCK = 60;
const address = (n, width) => `/app/frame/${strip.source}/${n}/${width}.jpg`;

// ---- a virtual list of pictures: `across` of them beside each other, in rows that scroll down, or one row that scrolls right

class Shots {
  constructor(prefix, size, wraps) {
    Object.assign(this, {prefix, least: size, wraps, at: 0, items: new Map(), width: size.picture});
    this.box = el('div', 'shots' + (wraps ? ' wraps' : ''));
    this.box.id = prefix + '-list';
    this.box.tabIndex = 0;
    this.box.setAttribute('role', 'listbox');
    this.box.setAttribute('aria-label', 'Frames');
    if (!wraps) this.box.setAttribute('aria-orientation', 'horizontal');
    this.room = this.box.appendChild(el('div', 'room'));
    this.box.addEventListener('scroll', () => this.draw(), {passive: true});
    this.box.addEventListener('keydown', e => this.pressed(e));
    new ResizeObserver(() => this.draw()).observe(this.box);
  }

  get across() { return this.wraps ? Math.max(1, Math.floor(this.room.clientWidth / this.least.w)) : 1; }

  /* Of one picture; those of a grid share the whole width. */
  get size() {
    const {w, h} = this.least, wide = this.wraps && this.room.clientWidth ? Math.floor(this.room.clientWidth / this.across) : w;
    return {w: wide, h: Math.round(h * wide / w)};
  }

  place(k) {
    const {w, h} = this.size, n = this.across;
    return this.wraps ? [(k % n) * w, Math.floor(k / n) * h] : [k * w, 0];
  }

  draw() {
    if (!strip || !this.box.isConnected || !this.box.clientWidth) return;
    const {w, h} = this.size, n = this.across, {scrollLeft, scrollTop, clientWidth, clientHeight} = this.box;
    this.room.style.width = this.wraps ? '100%' : strip.count * w + 'px';
    this.room.style.height = this.wraps ? Math.ceil(strip.count / n) * h + 'px' : '100%';
    this.box.dataset.empty = strip.count ? '' : `no frame is “${strip.kinds[strip.which]}”`;
    const from = this.wraps ? Math.floor(scrollTop / h) * n : Math.floor(scrollLeft / w);
    const to = Math.min(strip.count, this.wraps ? Math.ceil((scrollTop + clientHeight) / h) * n : Math.ceil((scrollLeft + clientWidth) / w) + 1);
    for (const [k, item] of this.items) if (k < from || k >= to) { item.remove(); this.items.delete(k); }
    for (let k = Math.max(0, from); k < to; k++) {
      let item = this.items.get(k);
      if (!item) {
        item = this.room.appendChild(el('div', 'shot'));
        item.id = `${this.prefix}-${k}`;
        item.setAttribute('role', 'option');
        this.items.set(k, item);
      }
      this.dress(item, k);
    }
    // Not while a hand is still scrolling.
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => { want(from, to); for (const [k, item] of this.items) this.load(item, k); }, rows.size ? 60 : 0);
  }

  dress(item, k) {
    const [x, y] = this.place(k), row = rows.get(k);
    item.style.transform = `translate(${x}px, ${y}px)`;
    const {w, h} = this.size;
    item.style.width = w + 'px';
    item.style.height = h + 'px';
    item.setAttribute('aria-setsize', strip.count);
    item.setAttribute('aria-posinset', k + 1);
    item.setAttribute('aria-selected', k === strip.at);
    item.classList.toggle('cursor', k === this.at);
    const key = row ? row.join() : '';
    if (item.dataset.key === key) return;
    item.dataset.key = key;
    const [n, name, well, bad] = row || [0, '', 0, 0], all = well + bad;
    const said = all ? `${well} ${strip.words[0]}, ${bad} ${strip.words[1]}` : '';
    item.title = [name, said].filter(Boolean).join(': ');
    item.setAttribute('aria-label', item.title || `frame ${k + 1}`);
    const image = el('img'), foot = el('div', 'foot');
    image.alt = '';
    image.draggable = false;
    image.addEventListener('error', () => { if (image.src) item.classList.add('broken'); });
    foot.append(el('span', 'name', name));
    if (all) foot.append(el('span', bad ? 'bad' : 'well', bad ? `${bad} ${strip.words[1]}` : `✓ ${well}`));
    item.replaceChildren(image, foot);
    if (all) {
      const tally = item.appendChild(el('div', 'tally')), part = tally.appendChild(el('i'));
      part.style.width = 100 * bad / all + '%';
    }
  }

  load(item, k) {
    const row = rows.get(k), image = item.querySelector('img');
    if (row && image && !image.getAttribute('src')) image.src = address(row[0], this.width);
  }

  see(k) {
    if (k < 0) return;
    const [x, y] = this.place(k), {w, h} = this.size, b = this.box;
    if (this.wraps) { if (y < b.scrollTop || y + h > b.scrollTop + b.clientHeight) b.scrollTop = y - (b.clientHeight - h) / 2; }
    else if (x < b.scrollLeft || x + w > b.scrollLeft + b.clientWidth) b.scrollLeft = x - (b.clientWidth - w) / 2;
  }

  move(k) {
    this.at = Math.min(Math.max(0, k), strip.count - 1);
    this.see(this.at);
    this.draw();
    this.box.setAttribute('aria-activedescendant', `${this.prefix}-${this.at}`);
  }

  open(k) { const row = rows.get(k); if (row) { locals.closeFrames(); send('frame:' + row[0]); } }

  pressed(e) {
    const n = this.wraps ? this.across : 1, page = n * Math.max(1, Math.floor(this.box.clientHeight / this.size.h));
    const step = {ArrowRight: 1, ArrowLeft: -1, ArrowDown: this.wraps ? n : 1, ArrowUp: this.wraps ? -n : -1,
      PageDown: this.wraps ? page : 10, PageUp: this.wraps ? -page : -10, Home: -strip.count, End: strip.count}[e.key];
    if (step !== undefined) this.move(this.at + step);
    else if (e.key === 'Enter' || e.key === ' ') this.open(this.at);
    else return;
    e.preventDefault();
    e.stopPropagation();
  }

  under(e) {
    const b = this.room.getBoundingClientRect(), {w, h} = this.size;
    const k = this.wraps ? Math.floor((e.clientY - b.top) / h) * this.across + Math.floor((e.clientX - b.left) / w) : Math.floor((e.clientX - b.left) / w);
    return k >= 0 && k < strip.count ? k : -1;
  }
}

const want = (from, to) => {
  for (let block = Math.floor(from / BLOCK); block * BLOCK < to; block++) {
    if (asked.has(block)) continue;
    asked.add(block);
    send(`frame-rows:${block * BLOCK},${(block + 1) * BLOCK}`);
  }
};

// ---- the strip

const low = new Shots('shot', {w: 104, h: 76, picture: 160}, false);
const high = new Shots('grid', {w: 264, h: 218, picture: 480}, true);
const preview = el('figure', 'passing');
preview.hidden = true;
preview.append(el('img'), el('figcaption'));
preview.firstChild.alt = '';

const passing = k => {
  const row = rows.get(k);
  preview.hidden = !row;
  if (!row) return;
  const wanted = address(row[0], 960), [image, text] = preview.children;
  if (image.getAttribute('src') !== wanted) image.src = wanted;
  text.textContent = `${row[1]} · ${k + 1} of ${strip.count}`;
};

// While the button is down frames pass by as pictures; the one where it is let go is opened.
low.box.addEventListener('pointerdown', e => {
  if (e.button || e.pointerType === 'touch') return;
  const start = e.clientX;
  let passes = false, at = e, edge = 0;
  low.box.setPointerCapture(e.pointerId);
  const tick = () => {
    const b = low.box.getBoundingClientRect(), past = Math.min(0, at.clientX - b.left - 40) + Math.max(0, at.clientX - b.right + 40);
    if (past && passes) { low.box.scrollLeft += past / 3; passing(low.under(at)); }
    edge = requestAnimationFrame(tick);
  };
  const move = now => {
    at = now;
    passes ||= Math.abs(now.clientX - start) > 6;
    if (passes) passing(low.under(now));
  };
  const end = now => {
    cancelAnimationFrame(edge);
    low.box.removeEventListener('pointermove', move);
    preview.hidden = true;
    const k = low.under(now);
    if (now.type === 'pointerup' && k >= 0) { low.at = k; low.open(k); }
  };
  tick();
  low.box.addEventListener('pointermove', move);
  for (const kind of ['pointerup', 'pointercancel']) low.box.addEventListener(kind, end, {once: true});
});
low.box.addEventListener('wheel', e => {
  if (Math.abs(e.deltaY) > Math.abs(e.deltaX)) { low.box.scrollLeft += e.deltaY; e.preventDefault(); }
}, {passive: false});
high.box.addEventListener('click', e => { const k = high.under(e); if (k >= 0) high.open(k); });

const chooser = () => {
  const kinds = Object.entries(strip.kinds);
  if (kinds.length < 2) return null;
  const group = el('div', 'seg');
  group.setAttribute('role', 'radiogroup');
  group.setAttribute('aria-label', 'which frames');
  for (const [kind, words] of kinds) {
    const one = group.appendChild(el('button', '', words));
    one.type = 'button';
    one.dataset.do = 'frames-of:' + kind;
    one.setAttribute('role', 'radio');
    one.setAttribute('aria-checked', kind === strip.which);
  }
  return group;
};
const pressable = (text, local, title) => {
  const b = el('button', 'try', text);
  b.type = 'button';
  b.dataset.local = local;
  b.title = title;
  return b;
};
const counted = () => (strip.count === strip.all ? '' : strip.count.toLocaleString('en') + ' of ') + strip.all.toLocaleString('en') + ' frames';

const head = el('div', 'strip-head'), lowPlan = el('div', 'plan');
const stripped = () => {
  const bar = byId('strip'), closed = kept() === 'closed';
  bar.hidden = strip.all < 2;
  bar.classList.toggle('closed', closed);
  for (const one of [bar, byId('frame-grid')]) one.classList.toggle('reviews', strip.words[1] === 'open');
  if (!bar.firstChild) bar.append(head, low.box, lowPlan, preview);
  const shut = pressable(closed ? '▴' : '▾', 'strip', closed ? 'show the strip of frames' : 'hide the strip of frames');
  shut.setAttribute('aria-label', shut.title);
  shut.setAttribute('aria-expanded', !closed);
  const all = pressable('All frames', 'frames', 'all frames as large pictures (Shift+W)');
  const held = head.contains(document.activeElement) ? document.activeElement.dataset.local || document.activeElement.dataset.do : null;
  head.replaceChildren(el('span', 'dim', counted()), all, shut, ...[chooser()].filter(Boolean));
  if (held) head.querySelector(`[data-local="${held}"],[data-do="${held}"]`)?.focus();
};
const kept = value => {
  try { if (value === undefined) return localStorage.getItem('strip') || ''; localStorage.setItem('strip', value); } catch { /* kept for this page only */ }
  return '';
};
locals.strip = () => {
  kept(byId('strip').classList.contains('closed') ? 'open' : 'closed');
  stripped();
  low.draw();
};

calls.strip = data => {
  const before = strip;
  strip = data;
  if (!before || ['source', 'which', 'version', 'count'].some(key => before[key] !== data[key])) { rows = new Map(); asked = new Set(); }
  stripped();
  const other = !before || before.at !== data.at || before.source !== data.source || before.count !== data.count;
  if (other && data.at >= 0) for (const list of [low, high]) { list.at = data.at; list.see(data.at); }
  for (const list of [low, high]) list.draw();
  if (!byId('frame-grid').hidden) titled();
  drawPlans();
};
calls.frameRows = ({from, rows: found}) => {
  found.forEach((row, k) => rows.set(from + k, row));
  for (const list of [low, high]) list.draw();
};

// ---- the grid of all

const top = el('div', 'grid-head'), highPlan = el('div', 'plan');
let back = null;
const titled = () => {
  const close = pressable('Close', 'closeFrames', 'back (Escape)');
  top.replaceChildren(el('h2', '', `${strip.name}: ${counted()}`), ...[chooser()].filter(Boolean), el('span', 'grow'), close);
};
locals.frames = () => {
  const grid = byId('frame-grid');
  if (!strip || strip.all < 2) return;
  if (!grid.firstChild) { const body = el('div', 'grid-body'); body.append(high.box, highPlan); grid.append(top, body); }
  back = document.activeElement;
  grid.hidden = false;
  byId('work').inert = true;
  titled();
  drawPlans();
  high.draw();
  high.move(Math.max(0, strip.at));
  high.box.focus();
};
locals.closeFrames = () => {
  if (byId('frame-grid').hidden) return;
  byId('frame-grid').hidden = true;
  byId('work').inert = false;
  back?.focus?.();
};
calls.frameGrid = () => locals.frames();
window.addEventListener('keydown', e => {
  const grid = byId('frame-grid');
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
calls.plan = data => { plan = data; drawPlans(); };

const drawPlan = (host, width, height) => {
  host.hidden = !plan;
  if (!plan) { host.replaceChildren(); return; }
  const xs = plan.positions.map(p => p[0]), ys = plan.positions.map(p => p[1]), large = width > 200 ? 1.6 : 1, air = 14 * large;
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((width - 2 * air) / Math.max(x1 - x0, .3), (height - 2 * air) / Math.max(y1 - y0, .3));
  const spots = plan.positions.map(([x, y]) => [width / 2 + (x - (x0 + x1) / 2) * scale, height / 2 - (y - (y0 + y1) / 2) * scale]);
  const drawn = svg('svg', {viewBox: `0 0 ${width} ${height}`, width, height, role: 'img',
    'aria-label': `${plan.frames.length} cameras of ${plan.scene} from above; a click opens the nearest`});
  const here = plan.frames.indexOf(plan.at);
  const order = spots.map((_, k) => k).sort((a, b) => (a === here) - (b === here));
  for (const k of order) {
    const [x, y] = spots[k], [a, b] = plan.headings[k], r = (k === here ? 11 : 8) * large;
    const one = svg('g', {class: k === here ? 'camera here' : 'camera'});
    const name = one.appendChild(svg('title', {}));
    name.textContent = plan.frames[k];
    if (a || b) one.append(svg('path', {d: `M${x} ${y}L${x + r * (a + b * .5)} ${y - r * (b - a * .5)}L${x + r * (a - b * .5)} ${y - r * (b + a * .5)}Z`}));
    one.append(svg('circle', {cx: x, cy: y, r: (k === here ? 3.5 : 2.5) * large}));
    drawn.append(one);
  }
  const metres = [5, 2, 1, .5, .2, .1, .05, .02, .01].find(m => m * scale <= width / 3) || .01;
  drawn.append(svg('path', {class: 'metre', d: `M6 ${height - 5}v-3v3h${metres * scale}v-3`}));
  const label = drawn.appendChild(svg('text', {x: 10 + metres * scale, y: height - 4}));
  label.textContent = metres < .1 ? `${metres * 100} cm` : `${metres} m`;
  drawn.addEventListener('click', e => {
    const b = drawn.getBoundingClientRect(), at = [(e.clientX - b.left) * width / b.width, (e.clientY - b.top) * height / b.height];
    const far = spots.map(([x, y]) => Math.hypot(x - at[0], y - at[1])), near = far.indexOf(Math.min(...far));
    if (far[near] < 28) { locals.closeFrames(); send('open:' + plan.frames[near]); }
  });
  host.replaceChildren(...(large > 1 ? [el('h3', '', `Cameras of ${plan.scene} from above`)] : []), drawn);
};
const drawPlans = () => {
  drawPlan(lowPlan, 150, 76);
  const wide = Math.round(Math.min(340, Math.max(220, innerWidth * .24)));
  if (!byId('frame-grid').hidden) drawPlan(highPlan, wide, wide);
};
