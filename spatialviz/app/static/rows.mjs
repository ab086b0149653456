/* The expressions of a run that a search has found: of many thousands only those in sight are elements.

The server says by `calls.found` how many there are; what comes into sight is asked for by `rows:FIRST,STOP` and comes
by `calls.rows`, pictures by `calls.pictures`, what is selected by `calls.chosen`. Elements are put to their places, and
one that leaves the sight is removed. The list has the focus as one; `aria-activedescendant` is the row that keys act on. */

import {byId, calls, fields, locals, make, send, typing} from './core.mjs';

const KEPT = 800, GAP = 12, CARD = 216, TEXT = 104, LINE = 52, HEAD = 32;
const list = byId('rows'), space = list.appendChild(document.createElement('div'));
space.className = 'space';

let version = -1, total = 0, view = 'grid', at = -1, from = -1, top = 0, moved = false;
let kept = new Map(), chosen = [], pictures = new Map();
const isChosen = k => chosen.some(([first, stop]) => k >= first && k < stop);
const shown = new Map();

/* ---- where a row is */

let width = 0, height = 0;
const table = () => view === 'table';
const columns = () => (table() ? 1 : Math.max(1, Math.floor((width - GAP) / (CARD + GAP))));
const card = () => (width - GAP) / columns() - GAP;
const line = () => (table() ? LINE : Math.round(card() * 3 / 4) + TEXT + GAP);
const head = () => (table() ? HEAD : GAP);
const inSight = (spare = 0) => {
  const y = list.scrollTop - head(), first = Math.floor((y - spare) / line()), last = Math.ceil((y + height + spare) / line());
  return [Math.max(0, first * columns()), Math.min(total, last * columns())];
};

function put(element, k) {
  const n = columns(), x = table() ? 0 : GAP + (k % n) * (card() + GAP);
  element.style.transform = `translate(${x}px,${head() + Math.floor(k / n) * line()}px)`;
  element.style.width = table() ? '' : `${card()}px`;
  element.style.height = table() ? `${LINE}px` : `${line() - GAP}px`;
}

/* ---- rows */

function dress(element, k) {
  element.setAttribute('aria-selected', String(isChosen(k)));
  element.classList.toggle('at', k === at);
  const image = element.querySelector('img'), url = pictures.get(k);
  if (image && url && image.getAttribute('src') !== url) image.src = url;
}

function draw() {
  if (!width || !height) return;
  const [first, stop] = inSight(height / 2);
  for (const [k, element] of shown) {
    if (k >= first && k < stop) continue;
    element.remove();
    shown.delete(k);
  }
  for (let k = first; k < stop; k++) {
    const known = kept.get(k), old = shown.get(k);
    if (old && (!known || !old.classList.contains('wait'))) continue;
    const element = known ? make(known) : Object.assign(document.createElement('div'), {className: 'expr wait'});
    if (!known) {
      element.setAttribute('role', table() ? 'row' : 'option');
      element.setAttribute('aria-label', 'is being read');
    }
    element.id = `row-${k}`;
    element.setAttribute(table() ? 'aria-rowindex' : 'aria-posinset', String(k + (table() ? 2 : 1)));
    if (!table()) element.setAttribute('aria-setsize', String(total));
    put(element, k);
    dress(element, k);
    if (old) old.replaceWith(element);
    else {
      // In the order of the list, for those who read it.
      let next = k + 1;
      while (next < stop && !shown.has(next)) next++;
      space.insertBefore(element, shown.get(next) ?? null);
    }
    shown.set(k, element);
  }
  if (at >= 0 && shown.has(at)) list.setAttribute('aria-activedescendant', `row-${at}`);
  else list.removeAttribute('aria-activedescendant');
}

let asked = '', asking = 0;
function ask() {
  clearTimeout(asking);
  asking = setTimeout(() => {
    const [first, stop] = inSight(height / 2), missing = [];
    for (let k = first; k < stop; k++) if (!kept.has(k) || !pictures.has(k)) missing.push(k);
    if (!missing.length) return;
    const span = `${version}:${missing[0]},${missing.at(-1) + 1}`;
    if (span === asked) return;
    asked = span;
    send(`rows:${missing[0]},${missing.at(-1) + 1}`);
  }, 40);
}

function resize() {
  const {clientWidth, clientHeight} = list;
  if (!clientWidth || !clientHeight) { [width, height] = [0, 0]; return; }
  const back = !height, before = width && line() ? (list.scrollTop - head()) / line() * columns() : 0;
  [width, height] = [clientWidth, clientHeight];
  space.style.height = `${head() + Math.ceil(total / columns()) * line() + (table() ? 0 : 1)}px`;
  for (const [k, element] of shown) put(element, k);
  // A list that was hidden comes back where it was; one that changes its width keeps its first row.
  if (back) list.scrollTop = top;
  else if (before > 0) list.scrollTop = head() + Math.floor(before / columns()) * line();
  if (back && moved) { moved = false; reveal(at); }
  draw();
  ask();
}

let frame = 0;
list.addEventListener('scroll', () => {
  if (height) top = list.scrollTop;
  cancelAnimationFrame(frame);
  frame = requestAnimationFrame(() => { draw(); ask(); });
});
new ResizeObserver(resize).observe(list);

function clear() {
  for (const element of shown.values()) element.remove();
  shown.clear();
  kept.clear();
  pictures.clear();
  asked = '';
}

calls.found = ({version: now, total: count, view: kind, head: heads, frame: letters, place, label}) => {
  const again = now !== version;
  clear();
  [version, total, view] = [now, count, kind];
  list.setAttribute('role', table() ? 'grid' : 'listbox');
  list.setAttribute('aria-multiselectable', 'true');
  list.setAttribute('aria-label', label);
  for (const name of ['aria-rowcount', 'aria-colcount']) list.removeAttribute(name);
  const marked = again ? place !== null : list.classList.contains('marked');
  list.className = kind;
  list.style.setProperty('--frame', `${Math.min(letters, 24)}ch`);
  list.classList.toggle('marked', marked);
  space.setAttribute('role', table() ? 'rowgroup' : 'presentation');
  list.querySelector('.columns')?.remove();
  if (table()) {
    list.prepend(make(heads));
    list.setAttribute('aria-rowcount', String(total + 1));
  }
  if (again) {
    chosen = [];
    [at, from, top] = [place ?? (total ? 0 : -1), -1, 0];
  }
  width = 0;
  resize();
  if (again) list.scrollTop = 0;
  if (again && place !== null) reveal(place, true);
};
calls.rows = ({version: now, first, rows}) => {
  if (now !== version) return;
  rows.forEach((html, i) => { kept.delete(first + i); kept.set(first + i, html); });
  for (const k of [...kept.keys()].slice(0, Math.max(0, kept.size - KEPT))) { kept.delete(k); pictures.delete(k); }
  for (let k = first; k < first + rows.length; k++) if (shown.get(k)?.classList.contains('wait') === false) { shown.get(k).remove(); shown.delete(k); }
  draw();
};
/* What is selected, as [first, stop] of the places of the list. */
calls.chosen = ({version: now, spans}) => {
  if (now !== version) return;
  chosen = spans;
  for (const [k, element] of shown) dress(element, k);
};
calls.pictures = ({version: now, urls}) => {
  if (now !== version) return;
  for (const [k, url] of Object.entries(urls)) {
    pictures.set(+k, url);
    if (shown.has(+k)) dress(shown.get(+k), +k);
  }
};
/* The row whose expression is asked, or null: then none is marked until keys walk. */
calls.place = k => {
  moved = k !== null && !height;
  if (k === null) list.classList.remove('marked');
  else reveal(k);
};
/* A picture that the server keeps no more is made again. */
list.addEventListener('error', e => {
  const row = e.target.closest?.('.space > .expr');
  if (!row) return;
  e.target.removeAttribute('src');
  pictures.delete(numberOf(row));
  asked = '';
  ask();
}, true);

/* ---- what keys and the mouse do */

const numberOf = element => +element.id.slice('row-'.length);

function reveal(k, inTheMiddle = false) {
  at = Math.min(total - 1, Math.max(0, k));
  from = -1;
  list.classList.add('marked');
  const y = head() + Math.floor(at / columns()) * line(), low = table() ? HEAD : 0;
  if (height) {
    if (inTheMiddle) list.scrollTop = y - height / 2;
    else if (y - low < list.scrollTop) list.scrollTop = y - low - (table() ? 0 : GAP);
    else if (y + line() > list.scrollTop + height) list.scrollTop = y + line() - height;
  }
  for (const [n, element] of shown) dress(element, n);
  draw();
}

function select(k, extend) {
  if (k < 0 || k >= total) return;
  if (extend && from >= 0) send(`choose-span:${Math.min(from, k)},${Math.max(from, k)}`);
  else {
    send(`choose:${k}`);
    from = k;
  }
  const anchor = from;
  reveal(k);
  from = anchor;
}

list.addEventListener('click', e => {
  const row = e.target.closest('.space > .expr');
  if (!row || row.classList.contains('wait')) return;
  const k = numberOf(row);
  list.focus({preventScroll: true});
  if (e.shiftKey && from < 0) from = at;
  if (e.shiftKey || e.ctrlKey || e.metaKey || e.target.closest('.tick')) select(k, e.shiftKey);
  else {
    reveal(k);
    send(`failure:${k}`);
  }
});
list.addEventListener('mousedown', e => { if (e.shiftKey) e.preventDefault(); });

const page = () => Math.max(1, Math.floor(height / line())) * columns();
const steps = {
  ArrowDown: () => columns(), ArrowUp: () => -columns(), ArrowRight: () => 1, ArrowLeft: () => -1, j: () => 1, k: () => -1,
  PageDown: page, PageUp: () => -page(), Home: () => -total, End: () => total,
};
/* Registered before the page's own keys: what is used up here is no key of the page. */
window.addEventListener('keydown', e => {
  if (document.body.dataset.mode !== 'evaluate' || typing(document.activeElement) || byId('dialog-window') || e.altKey) return;
  const own = document.activeElement === list, free = own || document.activeElement === document.body;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key, control = e.ctrlKey || e.metaKey;
  if (!control && key === '/') {
    const field = document.querySelector('#search input');
    field?.focus();
    field?.select();
  } else if (control) {
    if (key !== 'a' || !own) return;
    send('choose-all');
  } else if (key in steps && (own || key === 'j' || key === 'k')) {
    const to = Math.min(total - 1, Math.max(0, at + steps[key]()));
    list.focus({preventScroll: true});
    if (e.shiftKey && key !== 'j' && key !== 'k') {
      if (from < 0) from = at;
      select(to, true);
    } else reveal(to);
  } else if (free && (key === 'x' || (own && key === ' '))) select(at, e.shiftKey);
  else if (own && key === 'Enter') { if (at >= 0) send(`failure:${at}`); }
  else if (own && key === 'Escape') send('choose-none');
  else return;
  e.preventDefault();
});

/* A name that is typed, for a mark or for a search that is kept: Enter sends it, and the list goes on. */
fields.naming = {
  keydown(e, field) {
    if (e.key !== 'Enter' && e.key !== 'Escape') return;
    if (e.key === 'Enter' && field.value.trim()) send(`${field.dataset.enter}:${field.value}`);
    e.preventDefault();
    field.value = '';
    list.focus({preventScroll: true});
  },
};

locals.figures = button => {
  const bare = byId('evaluate').classList.toggle('bare');
  button.setAttribute('aria-pressed', String(!bare));
};
